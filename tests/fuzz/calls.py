"""Every public call that takes a frame, on inputs by chance, and the promises that its results must keep."""

import dataclasses
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

import rgbd_planes as rp

from . import inputs, promises
from .promises import promise


class Case(NamedTuple):
    """A frame, its camera, and the generator that chooses the rest."""

    rng: np.random.Generator
    absurd: bool
    camera: rp.Camera
    depth: np.ndarray


def case(seed):
    """The input of a number."""
    rng = np.random.default_rng(seed)
    absurd = bool(rng.integers(2))
    camera = inputs.camera(rng, absurd)
    return Case(rng, absurd, camera, inputs.frame(rng, camera.shape, absurd))


def _options(rng):
    return {"max_missing": float(rng.choice([0.0, 0.5, 1.0])), "max_error": [None, 0.01, 1e-300][rng.integers(3)]}


def tiles(case):
    rng = case.rng
    tile = int(rng.integers(3, 17)) if rng.random() < 0.7 else (int(rng.integers(1, 4)), int(rng.integers(3, 17)))
    method = str(rng.choice(inputs.METHODS))
    options = _options(rng) | {"significance": [None, 0.0, 0.3][rng.integers(3)]}
    if case.camera.noise is None:
        options.pop("significance")
    found = rp.fit_tiles(case.depth, case.camera, tile, method, **options, num_threads=1)
    promises.fits(found)
    if rng.random() < 0.1:
        again = rp.fit_tiles(case.depth, case.camera, tile, method, **options, num_threads=3)
        promises.same(found.planes, again.planes, "the same for any number of threads")
    if rng.random() < 0.02:
        with tempfile.TemporaryDirectory() as folder:
            found.save(Path(folder) / "planes.npz")
            read = rp.TilePlanes.load(Path(folder) / "planes.npz")
        promises.same(read.planes, found.planes, "saved and read again, planes are the same")
    return found


def windows(case):
    rng, (height, width) = case.rng, case.camera.shape
    top, left = rng.integers(0, height - 3, 8), rng.integers(0, width - 3, 8)
    places = np.stack([top, left, rng.integers(1, height - top), rng.integers(1, width - left)], 1)
    found = rp.fit_windows(case.depth, case.camera, places, str(rng.choice(inputs.METHODS)), **_options(rng))
    promises.fits(found)


def labels(case):
    found = rp.fit_labels(case.depth, case.camera, case.rng.integers(0, 5, case.camera.shape))
    promises.fits(found)


def primitives(case):
    parts = case.rng.integers(0, 4, (4, 4)).repeat(-(-case.camera.shape[0] // 4), 0)
    parts = parts.repeat(-(-case.camera.shape[1] // 4), 1)[: case.camera.shape[0], : case.camera.shape[1]]
    level = [None, 0.0, 1e-3][case.rng.integers(3)]
    promises.primitives(rp.fit_primitives(case.depth, case.camera, parts, significance=level))


def merge(case):
    found = rp.fit_tiles(case.depth, case.camera, 8, str(case.rng.choice(inputs.METHODS)))
    promises.fits(rp.merge(found, case.rng.integers(0, 4, found.shape)))


def segment(case):
    found = rp.segment(case.depth, case.camera, min_size=int(case.rng.choice([3, 20, 60])))
    promises.segments(found, case.camera.shape)


def normals(case):
    window, edges = int(case.rng.choice([3, 5, 7, 15])), bool(case.rng.integers(2))
    promises.normals(rp.normals(case.depth, case.camera, window, avoid_edges=edges))


def curvature(case):
    window, share = int(case.rng.choice([3, 5, 7, 15])), float(case.rng.choice([0.0, 0.5, 1.0]))
    found = rp.normals(case.depth, case.camera, window, max_missing=share)
    curved = rp.curvature(case.depth, case.camera, window, max_missing=share)
    promises.normals(found, curved if _span(case.depth) < 1e60 else None)


def quadtree(case):
    found = rp.segment_quadtree(case.depth, case.camera, 8, str(case.rng.choice(inputs.METHODS)), clusters=3)
    promises.fits(found.elements)
    known = ~np.isnan(found.planes).any(axis=1)
    promises.planes(found.planes[known])


def polygons(case):
    found = rp.segment(case.depth, case.camera, min_size=20)
    for polygon in rp.plane_polygons(found):
        promise(np.isfinite(polygon.area) and polygon.area >= 0.0, "an area")


def noise(case):
    camera = dataclasses.replace(case.camera, width=160, height=120, cx=80.0, cy=60.0)  # for enough flat windows
    frames = [inputs.frame(case.rng, camera.shape, case.absurd) for _ in range(2)]
    found = rp.estimate_noise(frames, camera)
    promise(np.isfinite(found.sigma(np.array([0.1, 1.0, 10.0]))), "a finite noise")


def uncertainty(case):
    found = rp.fit_tiles(case.depth, case.camera, 8)
    if case.camera.noise is None or np.count_nonzero(found.fitted) < 2:
        return
    a, b = (np.argwhere(found.fitted)[i] for i in (0, -1))
    planes = [found.planes[tuple(i)] for i in (a, b)]
    matrices = [found.plane_covariance[tuple(i)] for i in (a, b)]
    both = planes[0], matrices[0], planes[1], matrices[1]
    p_value = rp.uncertainty.same_plane(*both)
    promise((p_value >= 0.0) & (p_value <= 1.0), "p-values are from 0 to 1")
    point = np.array([0.0, 0.0, 1.0])
    for value, std in (rp.uncertainty.point_distance(point, *both[:2]), rp.uncertainty.angle_between(*both)):
        promise(np.isfinite(value) & np.isfinite(std) & (std >= 0.0), "a value and its standard deviation")


CALLS: dict[str, tuple[Callable[[Case], object], float]] = {
    "fit_tiles": (tiles, 0.55),
    "fit_windows": (windows, 0.08),
    "fit_labels": (labels, 0.05),
    "fit_primitives": (primitives, 0.05),
    "merge": (merge, 0.05),
    "normals": (normals, 0.06),
    "curvature": (curvature, 0.06),
    "segment": (segment, 0.06),
    "segment_quadtree": (quadtree, 0.02),
    "uncertainty": (uncertainty, 0.02),
}
"""The calls by name, with the share of the inputs that each gets."""
RARE: dict[str, tuple[Callable[[Case], object], float]] = {
    "plane_polygons": (polygons, 0.5),
    "estimate_noise": (noise, 0.5),
}


def outcome(use, seed):
    """Make one call; returns "fitted", or "refused" for an input that is refused in words.

    Raises
    ------
    BrokenPromiseError, Exception
        A promise is broken, or an error comes out that no documentation names.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of NumPy's
        warnings.simplefilter("ignore", UserWarning)  # what is doubtful may be said
        try:
            given = case(seed)
            use(given)
        except (ValueError, TypeError) as error:
            if not promises.refused(error):
                raise
            return "refused"
    return "fitted"


def _span(depth):
    """The largest depth over the smallest. Beyond 1e60 nothing but rounding of what has left a window may be in it."""
    with np.errstate(all="ignore"):
        values = np.abs(np.asarray(depth, np.float64).ravel())
        values = values[np.isfinite(values) & (values > 0.0)]
        return values.max() / values.min() if len(values) else 1.0
