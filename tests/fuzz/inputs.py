"""Cameras and frames by chance: half of them ordinary, half as absurd as the types allow."""

import numpy as np

import rgbd_planes as rp

METHODS = ("range_explicit", "range_implicit", "standard_explicit", "standard_implicit", "standard_pca")
_SIGNALLING = np.array([0x7F800001], np.uint32).view(np.float32)[0]
_SPECIAL = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 5e-324, 1e-38, 2e38, 3.4e38, 1e308, -1.0, 65535.0])
_INTEGERS, _FLOATS = (np.uint16, np.int64), (np.float32, np.float64)  # few: kernels are compiled for each
SIZES = ((24, 32), (17, 23), (30, 40))
"""Few sizes of frames, (height, width): each is precomputed for anew."""


def magnitude(rng, least, most):
    """A number between two, spread evenly over their powers of ten."""
    return float(10.0 ** rng.uniform(np.log10(least), np.log10(most)))


def noise(rng, absurd):
    """A noise model, or none."""
    kind = rng.integers(6)
    sigma = magnitude(rng, 1e-30, 1e20) if absurd else magnitude(rng, 1e-4, 1e-2)
    if kind == 0:
        return None
    if kind == 1:
        return rp.noise.kinect_v1()
    if kind == 2:
        return rp.noise.stereo(0.05, 500.0, min(100.0 * sigma, 1e6))
    if kind == 3:
        return rp.noise.NoiseModel((sigma,), lateral=float(rng.uniform(0.0, 2.0)))
    if kind == 4:
        return rp.noise.NoiseModel((sigma,), step=0.001)
    return rp.noise.time_of_flight(sigma)


def camera(rng, absurd):
    """A camera; an absurd one may have focal lengths of any length. Which it may not have it refuses: ValueError."""
    height, width = SIZES[rng.integers(len(SIZES))]
    focal = magnitude(rng, 1e-9, 1e9) if absurd and rng.random() < 0.5 else 0.9 * width
    unit = {}
    kind = rng.integers(3)
    if kind == 0:
        unit["depth_scale"] = magnitude(rng, 1e-30, 1e30) if absurd else 1000.0
    elif kind == 1:
        scale = magnitude(rng, 1e-30, 1e30) if absurd else 1e-4
        unit["disparity"] = scale, float(rng.choice([0.0, scale, -scale, 0.1]))
    else:
        unit["depth_scale"] = 5000.0
    lens = {}
    if rng.random() < 0.2:
        lens["distortion"] = tuple(rng.normal(0.0, 1e3 if absurd else 0.05, 5))
    if rng.random() < 0.1:
        unit["depth_range"] = (0.1, 10.0)
    return rp.Camera(
        width, height, focal, focal * float(rng.choice([1.0, -1.0, 1.01])), width / 2, height / 2,
        noise=noise(rng, absurd), **unit, **lens,
    )  # fmt: skip


def frame(rng, shape, absurd):
    """A frame, raw units or metres: planes with noise and holes, or numbers of any size."""
    height, width = shape
    rows, columns = np.mgrid[:height, :width]
    if absurd:
        dtype = np.dtype(rng.choice([*_INTEGERS, *_FLOATS]))
        if dtype.kind == "f":
            low, high = np.sort(rng.uniform(-1.0, 1.0, 2)) * (300.0 if rng.random() < 0.3 else 20.0)
            with np.errstate(all="ignore"):
                depth = (10.0 ** rng.uniform(low, high, shape)).astype(dtype)
                some = rng.random(shape) < rng.choice([0.0, 0.05, 0.5])
                depth[some] = rng.choice(_SPECIAL, np.count_nonzero(some)).astype(dtype)
            if dtype == np.float32 and rng.random() < 0.2:
                depth[rng.integers(height), rng.integers(width)] = _SIGNALLING
            return depth
        limits = np.iinfo(dtype)
        bits = rng.integers(1, limits.bits)
        low, high = max(int(limits.min), -(2 ** int(bits))), min(int(limits.max), 2 ** int(bits))
        return rng.integers(low, high, shape, dtype, endpoint=True)
    metres = np.full(shape, np.inf)
    for _ in range(rng.integers(1, 4)):
        a, b, c = rng.normal(0.0, 0.01), rng.normal(0.0, 0.01), rng.uniform(0.2, 1.0)
        with np.errstate(all="ignore"):
            metres = np.minimum(metres, np.abs(1.0 / (a * (columns - width / 2) + b * (rows - height / 2) + c)))
    metres += 1.4e-3 * metres**2 * rng.normal(size=shape)
    metres[rng.random(shape) < rng.choice([0.0, 0.05, 0.3])] = 0.0
    kind = rng.integers(3)
    if kind == 0:
        return np.clip(1000.0 * metres, 0, 65535).astype(np.uint16)
    return metres.astype(np.float32 if kind == 1 else np.float64)
