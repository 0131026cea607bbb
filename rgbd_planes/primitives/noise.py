"""The noise of a frame's pixels, for fits that take no plane for granted."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from rgbd_planes._core.arrays import Floats
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import DepthFrame, step_of
from rgbd_planes.kernels.segmentation.blocks.pyramid import read_frame
from rgbd_planes.kernels.segmentation.noise.estimate import nearest_surface
from rgbd_planes.kernels.statistics.noise_variances import LATERAL_X, LATERAL_Y, SCALE, VARIANCES
from rgbd_planes.noise.model import NoiseModel
from rgbd_planes.segmentation.frame_noise import noise_of
from rgbd_planes.segmentation.segment import check_settings
from rgbd_planes.segmentation.workspace import rays_of, workspaces
from rgbd_planes.uncertainty.statistics import settings_of

_FLOOR = 8.0
"""Correlation length in pixels of errors that bend whole surfaces: that of `NoiseModel.floor_length`."""
_SPREAD = 0.6
"""`NoiseModel.spread` where the noise is a frame's: to a factor of two its deviation is not known."""


class PixelNoise(NamedTuple):
    """Variances of pixels' inverse depths, and how neighbours share them.

    Attributes
    ----------
    settings : (8 or more,) float64
        As `kernels.statistics.noise_variances` takes it.
    components : (C, 2) float64
        Shares of the variance along the ray, and their correlation lengths in pixels.
    spread : float
        `NoiseModel.spread`.
    """

    settings: Floats
    components: Floats
    spread: float


def noise_of_pixels(frame: DepthFrame, camera: Camera, noise: Any) -> PixelNoise:
    """A noise model's, or what `segment` takes for the frame's noise.

    A frame shows how many pixels have one error between them. Errors of the correlation exp(-r²/(2·length²)) are so
    shared by 2π·length² pixels. By how much more its squares of 32 pixels err than small ones are errors that reach
    farther. A sensor whose pixels share errors has others, too, that one frame does not show: its variance counts as
    one that differs from place to place.
    """
    noise = camera.noise if noise is None else noise
    if isinstance(noise, NoiseModel):
        return PixelNoise(settings_of(camera.with_noise(noise)), np.array(noise._components), noise.spread)
    given, _ = check_settings(camera, noise, 3)
    rays = rays_of(camera._lens)
    with workspaces.lent(camera) as work:
        nearest = nearest_surface(work.pyramid, read_frame(*frame.values, rays, work.inverse_depth, work.pyramid))
        found, about = noise_of(frame, step_of(frame), rays, work.pyramid, nearest, given)
    variances = np.append(found.sigma[1:], found.sigma[-1]) ** 2  # constant beyond the nearest surface
    settings = np.zeros(VARIANCES + 2 * len(variances))
    settings[[LATERAL_X, LATERAL_Y, SCALE]] = found.lateral_variance_x, found.lateral_variance_y, 1.0 / found.sigma[0]
    settings[VARIANCES : VARIANCES + len(variances)] = variances
    shares_errors = about.together > 1.0
    length = math.sqrt(about.together / (2.0 * math.pi)) if shares_errors else 0.0
    floor = max(float(found.growth.max()) ** 2 - 1.0, 0.0)
    return PixelNoise(settings, np.array([[1.0, length], [floor, _FLOOR]]), _SPREAD if shares_errors else 0.0)
