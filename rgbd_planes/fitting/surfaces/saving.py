"""Surfaces in NPZ files."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes._core.status import TileStatus
from rgbd_planes.camera.camera import Camera
from rgbd_planes.fitting.saving import Arrays, check_alike
from rgbd_planes.fitting.surfaces.results import SURFACE_ARRAYS, SurfaceFits, allocate_surfaces


def content_of_surfaces(
    fits: SurfaceFits, about: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]
) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """What `Savable` writes of a fit of surfaces, with what tells its parts."""
    whole = {"camera": fits.camera.to_dict(), **about}
    return whole, {**{name.lstrip("_"): getattr(fits, name) for name in SURFACE_ARRAYS}, **arrays}


def surfaces_in(arrays: Arrays, camera: Camera, shape: tuple[int, ...], most: npt.ArrayLike) -> dict[str, Any]:
    """The arguments that all fits are made from, of parts in this shape, which have ``most`` pixels."""
    found = {name: arrays[name.lstrip("_")] for name in SURFACE_ARRAYS}
    cells = min(len(shape), 2)
    check_alike(found, allocate_surfaces(shape[:-cells], shape[-cells:]))
    count = found["valid_count"]
    if found["status"].max(initial=0) > max(TileStatus) or ((count < 0) | (count > most)).any():
        raise ValueError("an invalid status or number of pixels")
    fitted = np.isin(found["status"], (TileStatus.OK, TileStatus.ROUGH))
    if not (np.isfinite(found["coefficients"][fitted]).all() and (found["coefficients"][fitted][..., 0] > 0.0).all()):
        raise ValueError("surfaces without coefficients, or behind the camera")
    return {"camera": camera, "_writes": [0], **found}
