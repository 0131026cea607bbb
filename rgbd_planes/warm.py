"""Compile the kernels before they are needed."""

from collections.abc import Sequence

import numpy as np

from rgbd_planes.camera import Camera
from rgbd_planes.fitting import METHODS, check_choice
from rgbd_planes.tiles import TileFitter

# Coefficients that bend a ray a little, for the kernels of cameras with lens distortion.
_DISTORTION = (1e-3, 0.0, 0.0, 0.0, 0.0)


def warmup(
    camera: Camera | None = None,
    methods: str | Sequence[str] = "range_explicit",
    dtypes: str | Sequence[str] = ("uint16", "float32"),
) -> None:
    """Compile what fits tiles, or load it from the cache, so that the first frame is as fast as the next.

    A first installation takes seconds for it, once; later processes a fraction of a second.

    Parameters
    ----------
    camera : Camera, optional
        Kernels differ for cameras with and without lens distortion, and for depth and disparity images;
        without a camera it is depth without distortion.
    methods : str or sequence of str
        See `TileFitter`.
    dtypes : str or sequence of str
        Of the frames to come.
    """
    distorted = camera is not None and camera.is_distorted
    disparity = None if camera is None else camera.disparity
    small = Camera(
        8, 8, 8.0, 8.0, 3.5, 3.5, _DISTORTION if distorted else (),
        depth_scale=1000.0 if disparity is None else None, disparity=disparity,
    )  # fmt: skip
    for method in [methods] if isinstance(methods, str) else methods:
        check_choice("method", method, METHODS)
        fitter = TileFitter(small, 4, method, num_threads=1)
        for dtype in [dtypes] if isinstance(dtypes, str) else dtypes:
            fitter.fit(np.ones(small.shape, dtype))
