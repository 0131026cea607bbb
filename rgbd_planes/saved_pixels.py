"""What fits that keep their pixels have in a file, beside `saved_fits`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera import Camera
from rgbd_planes.error_sums import KeepsPixels, Pixels
from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns
from rgbd_planes.kernels.statistics.tiles.block import COLUMNS
from rgbd_planes.saved import Arrays, check_alike

_RUNS = {name: f"run_{name}" for name in PixelRuns._fields}


def content_of_pixels(fits: KeepsPixels) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
    """The part of a fit's content that is its pixels."""
    pixels = fits._pixels
    several = {
        "footprint": pixels.footprint,
        "error_sums": fits._error_sums,
        "shared": fits._shared,
        **({} if pixels.runs is None else {_RUNS[name]: of for name, of in pixels.runs._asdict().items()}),
    }
    about = {"pixels_have_noise": pixels.noise == fits.camera.noise}
    return about, {name: array for name, array in several.items() if array is not None}


def pixels_in(about: Mapping[str, Any], arrays: Arrays, camera: Camera, count: int) -> Pixels:
    """The pixels of ``count`` parts in a file: `content_of_pixels`."""
    expected = {
        "footprint": np.empty((count, 5), np.int64),
        "error_sums": np.empty((count, 8)),
        "shared": np.empty((count, COLUMNS)),
    }
    needed = ("footprint", "error_sums") if "shared" in arrays else ("footprint",)
    own = {name: arrays[name] for name in expected if name in needed or name in arrays}
    check_alike(own, {name: expected[name] for name in own})
    noise = camera.noise if about["pixels_have_noise"] else None
    return Pixels(own["footprint"], noise, own.get("error_sums"), own.get("shared"), _runs_in(arrays, camera, count))


def _runs_in(arrays: Arrays, camera: Camera, count: int) -> PixelRuns | None:
    """Runs that lie in the image: kernels do not ask."""
    if _RUNS["first"] not in arrays:
        return None
    runs = PixelRuns(*(arrays[name] for name in _RUNS.values()))
    number, dtypes = len(runs.row), (np.int32, np.int32, np.int32, np.float64)
    check_alike(runs._asdict(), {"first": np.empty(count + 1, np.int64)})
    check_alike(runs._asdict(), {name: np.empty(number, of) for name, of in zip(runs._fields[1:], dtypes, strict=True)})
    in_order = runs.first[0] == 0 and runs.first[-1] == number and (np.diff(runs.first) >= 0).all()
    inside = (runs.row >= 0) & (runs.row < camera.height) & (runs.start >= 0) & (runs.stop <= camera.width)
    if not (in_order and (inside & (runs.start < runs.stop)).all()):
        raise ValueError("pixels that are not in the image")
    return runs
