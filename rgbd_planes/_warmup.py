"""Compile the kernels before they are needed."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from rgbd_planes._core.checks import check_bool, check_choice
from rgbd_planes._core.user_warnings import collected_warnings
from rgbd_planes.camera.camera import Camera, check_camera
from rgbd_planes.fitting.methods import METHODS
from rgbd_planes.fitting.tiles import TileFitter
from rgbd_planes.noise.model import NoiseModel

DType = str | type | np.dtype[Any]

# Coefficients that bend a ray a little, for the kernels of cameras with lens distortion.
_DISTORTION = (1e-3, 0.0, 0.0, 0.0, 0.0)
# Like those that are estimated from frames, for the kernels of cameras whose model is not known yet.
_NOISE = NoiseModel(correlation=((0.5, 2.0),), floor=0.5)


def warmup(
    camera: Camera | None = None,
    methods: str | Sequence[str] = "range_explicit",
    dtypes: DType | Sequence[DType] = ("uint16", "float32"),
    *,
    segment: bool = False,
) -> None:
    """Compile the kernels that fit tiles, or load them from the cache, so that the first frame is as fast as the next.

    On a new installation this takes up to half a minute, once, and with ``segment`` up to two minutes, in up to four
    processes. In later processes it takes a fraction of a second.

    Parameters
    ----------
    camera : Camera, optional
        The camera of the frames to come: kernels differ for cameras with and without lens distortion, and for depth and
        disparity images. Without a camera it is depth without distortion.
    methods : str or sequence of str
        Methods of `fit_tiles`, such as ``range_explicit``.
    dtypes : dtype or sequence of dtypes
        Of the frames to come.
    segment : bool
        Compile `rgbd_planes.segment`, too.

    Raises
    ------
    TypeError, ValueError
        ``camera`` is not a `Camera`, there is no such method, or a dtype is neither integer nor floating point.

    Notes
    -----
    Kernels that a noise model needs are compiled whether the camera has one or not. `normals`, `fit_labels`,
    `fit_windows`, `estimate_noise` and others compile what they need when they are first called, which takes some
    seconds. If nothing can be written later, call them, too, on any frame of the camera.
    """
    given = Camera(8, 8, 8.0, 8.0, 3.5, 3.5) if camera is None else camera
    check_camera(given)
    # For frames of ones.
    small = Camera(
        8, 8, 8.0, 8.0, 3.5, 3.5, _DISTORTION if given.is_distorted else (),
        depth_scale=1.0 if given.disparity is None else None, disparity=given.disparity,
    )  # fmt: skip
    cameras = small, small.with_noise(given.noise or _NOISE)
    segment = check_bool("segment", segment)
    several = dtypes if isinstance(dtypes, Iterable) and not isinstance(dtypes, (str, type)) else [dtypes]
    several = [np.dtype(dtype) for dtype in several]
    with collected_warnings([]):  # frames of ones may be doubted, by a disparity or a noise model
        for method in methods if isinstance(methods, Iterable) and not isinstance(methods, str) else [methods]:
            check_choice("method", method, METHODS)
            for camera in cameras:
                fitter = TileFitter(camera, 4, method, num_threads=1)
                for dtype in several:
                    fitter.fit(np.ones(camera.shape, dtype))
        if segment:
            _segment(cameras, several)


def _segment(cameras: Iterable[Camera], dtypes: Sequence[DType]) -> None:
    """Segment a scene that takes every code path, and frames of each dtype: only their first kernel differs."""
    from rgbd_planes.evaluation import scenes
    from rgbd_planes.segmentation.compilation import compile_everything
    from rgbd_planes.segmentation.segment import segment

    for dtype in dtypes:
        compile_everything(np.dtype(dtype).str, any(camera.disparity is not None for camera in cameras))
    room = Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=1000.0)
    segment(scenes.room().render(room).measure(holes=0.05, patches=0.05), room)
    for camera in cameras:
        for dtype in dtypes:
            segment(np.ones(camera.shape, dtype), camera)
