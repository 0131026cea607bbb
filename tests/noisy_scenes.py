"""A camera and rooms as it sees them with noise, for tests of noise."""

import functools

import numpy as np
from scipy import ndimage

import rgbd_planes as rp

CAMERA = rp.Camera(480, 384, 394.0, 394.0, 239.5, 191.5, depth_scale=10000.0)


VIEWS = [((0.35 - 0.2 * i, -1.5, -0.2 + 0.1 * i), (-0.12 + 0.3 * i, -0.8 - 0.2 * i, 2.6)) for i in range(4)]


@functools.cache
def rendering(*view):
    return rp.scenes.room(*view).render(CAMERA)


def smooth(rng, length):
    """Normal errors of variance 1 whose correlation at distance r is exp(-r²/(2·length²))."""
    width = length / np.sqrt(2.0)
    return ndimage.gaussian_filter(rng.standard_normal(CAMERA.shape), width, mode="wrap") * 2.0 * width * np.sqrt(np.pi)
