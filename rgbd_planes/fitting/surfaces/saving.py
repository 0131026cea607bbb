"""What surfaces in NPZ files must be."""

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.status import TileStatus
from rgbd_planes.fitting.saving import Values, check_alike, check_variances
from rgbd_planes.fitting.surfaces.results import allocate_surfaces
from rgbd_planes.kernels.moments.surface_tiles import QQ, UU, UUUU, UUVV, VV, VVVV

SQUARES = [UU, VV, UUUU, UUVV, VVVV, QQ]


def check_surfaces(values: Values, shape: tuple[int, ...], most: npt.ArrayLike) -> None:
    """Raise a ValueError unless the fields that all fits have are those of parts in this shape.

    ``most`` are the pixels that the parts have at most.
    """
    cells = min(len(shape), 2)
    check_alike(values, allocate_surfaces(shape[:-cells], shape[-cells:]))
    count, status = values["valid_count"], values["status"]
    if status.max(initial=0) > max(TileStatus) or ((count < 0) | (count > most)).any():
        raise ValueError("an invalid status or number of pixels")
    fitted = np.isin(status, (TileStatus.OK, TileStatus.ROUGH))
    check_variances(np.moveaxis(values["_moments"], len(shape[:-cells]), -1)[fitted][:, SQUARES])
    coefficients = values["coefficients"][fitted]
    if not (np.isfinite(coefficients).all() and (coefficients[..., 0] > 0.0).all()):
        raise ValueError("surfaces without coefficients, or behind the camera")
