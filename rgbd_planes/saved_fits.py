"""What fits of all kinds have in a file."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.checks import check_choice
from rgbd_planes.fitting import ARRAYS, METHODS
from rgbd_planes.plane_fits import PlaneFits, TileStatus, allocate
from rgbd_planes.saved import Arrays, check_alike, check_planes


def content_of_fits(
    fits: PlaneFits, about: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]
) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """What `Savable` writes of a fit, with what tells its parts."""
    whole = {"camera": fits.camera.to_dict(), "method": fits.method, **about}
    return whole, {**{name.lstrip("_"): getattr(fits, name) for name in ARRAYS}, **arrays}


def common_content(
    about: Mapping[str, Any], arrays: Arrays, camera: Camera, shape: tuple[int, ...], most: npt.ArrayLike
) -> dict[str, Any]:
    """The arguments that all fits are made from, of parts in this shape, which have ``most`` pixels."""
    check_choice("method", about["method"], METHODS)
    own = {name: arrays[name.lstrip("_")] for name in ARRAYS}
    check_alike(own, allocate(shape[:-2], shape[-2:]))
    count = own["valid_count"]
    if own["status"].max(initial=0) > max(TileStatus) or ((count < 0) | (count > most)).any():
        raise ValueError("an invalid status or number of pixels")
    fitted = np.isin(own["status"], (TileStatus.OK, TileStatus.ROUGH))
    check_planes(own["planes"][fitted], own["alpha"][fitted])
    return {"camera": camera, "method": about["method"], **own}


def labels_in(arrays: Arrays, shape: tuple[int, ...] | None, count: int) -> npt.NDArray[np.int32]:
    """The labels of a file: of this shape, if there is one, and 0 to ``count``."""
    labels: npt.NDArray[np.int32] = arrays["labels"]
    if labels.dtype != np.int32 or shape not in (None, labels.shape):
        raise ValueError("labels of another shape or dtype")
    if not 0 <= labels.min(initial=0) <= labels.max(initial=0) <= count:
        raise ValueError("labels of other planes")
    return labels
