"""Where uncertainties are wrong, and by how much: ``python -m bench.limits``.

Covariances are compared with those that follow from the noise model without approximations, A⁻¹MᵀCMA⁻¹ with the
covariance C of the pixels' errors: the least and the largest ratio of variances in any direction. p-values, and the
squares of errors over those that are expected, δᵀΣ⁻¹δ / 3, are those of simulated planes.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh

import rgbd_planes as rp
from bench import monte_carlo
from rgbd_planes._core.arrays import Floats
from rgbd_planes.fitting.results import PlaneFits

Mask = NDArray[np.bool_]
Noise = rp.noise.NoiseModel

# Errors that neighbours share over one to eight pixels, and such as estimate_noise finds with two sensors.
SHARED = (
    *(Noise(correlation=((share, length),)) for share in (0.5, 0.9) for length in (1.0, 2.0, 4.0, 8.0)),
    Noise(correlation=((0.46, 2.0), (0.27, 4.0)), floor=1.4, floor_length=48.0),
    Noise(correlation=((0.11, 2.0), (0.15, 8.0)), floor=1.3, floor_length=32.0),
)
# Noise that depends on the depth.
UNEVEN = (rp.noise.time_of_flight(0.005), rp.noise.time_of_flight(0.002, 0.001), rp.noise.kinect_v1_nguyen())
STANDARD = ("standard_explicit", "standard_implicit", "standard_pca")
TAILS = Noise(correlation=((0.6, 2.0),))
FLOORS = (Noise(floor=1.0, floor_length=60.0), Noise(floor=1.0, floor_length=32.0), SHARED[-2])
APART = "two tiles of 16 x 16, 320 pixels apart"


def masks() -> dict[str, Mask]:
    """Pixels that a rectangle of the same sides does not describe."""
    y, x = np.mgrid[:36, :36]
    apart = np.zeros((16, 320), bool)
    apart[:, :16] = apart[:, -16:] = True
    return {
        "ring": abs(np.hypot(x - 17.5, y - 17.5) - 14.0) < 3.0,
        "chessboard": (x // 6 + y // 6) % 2 == 0,
        "diagonal strip": abs(x - y) < 5,
        "one pixel in twenty": np.random.default_rng(1).random(x.shape) < 0.05,
        APART: apart,
    }


def of_masks(mask: Mask) -> tuple[float, float]:
    """Least and largest ratio of a mask's variances, by any of the noises that neighbours share."""
    found = []
    for noise in SHARED:
        camera = monte_carlo.tile_camera(mask.shape, noise)
        alpha = monte_carlo.plane_through_middle(camera, 1.0, 20.0)
        fits = rp.fit_labels(1.0 / _inverse_depth(camera, alpha), camera, mask)
        found.append(_ratios(camera, mask, alpha, fits))
    return _range(found)


def of_tiles(size: int) -> tuple[float, float]:
    """Of tiles of planes at all angles, whose noise depends on the depth or on the place in the image."""
    found = []
    falling = (replace(rp.noise.kinect_v1(), falloff=4.0), replace(UNEVEN[0], falloff=2.0))
    shared: tuple[dict[str, Any], ...] = (
        {},
        {"floor": 1.0},
        {"floor": 2.0, "floor_length": 128.0},
        {"correlation": ((0.9, 4.0),)},
    )
    mask = np.ones((size, size), bool)
    for noise in (*UNEVEN, *falling):
        for errors in shared:
            camera = monte_carlo.tile_camera(size, replace(noise, **errors), left=500, top=100)
            for incidence in (0.0, 30.0, 50.0, 60.0, 70.0, 75.0):
                alpha = monte_carlo.plane_through_middle(camera, 1.5, incidence, incidence / 10.0)
                found.append(
                    _ratios(camera, mask, alpha, rp.fit_tiles(1.0 / _inverse_depth(camera, alpha), camera, size))
                )
    return _range(found)


def of_holes() -> tuple[float, float]:
    """Of tiles of which half is missing in one piece, or two corners, by noises that neighbours share."""
    found = []
    for noise in (*SHARED, *FLOORS[:2]):
        for size in (8, 16, 24):
            y, x = np.mgrid[:size, :size]
            middle = abs(x - (size - 1) / 2) > 0.24 * size
            for mask in (middle, x < size // 2, x + y < size, (x < size // 2) == (y < size // 2)):
                camera = monte_carlo.tile_camera(size, noise)
                alpha = monte_carlo.plane_through_middle(camera, 1.0, 20.0)
                depth = np.where(mask, 1.0 / _inverse_depth(camera, alpha), np.nan)
                found.append(_ratios(camera, mask, alpha, rp.fit_tiles(depth, camera, size, max_missing=1.0)))
    return _range(found)


def of_windows() -> tuple[float, float]:
    """Of a window that sees a floor from 1.7 to 9 m, of which half is missing in one piece."""
    found = []
    for noise in UNEVEN:
        camera = _camera(noise)
        alpha = _floor(camera, 1.7, 9.0)
        y, x = np.mgrid[:96, :128]
        for mask in (x >= 64, y >= 48, y < 48, (y >= 68) | (x >= 90), 4 * y > 3 * x):
            depth = np.where(mask, 1.0 / _inverse_depth(camera, alpha), np.nan)
            found.append(
                _ratios(camera, mask, alpha, rp.fit_windows(depth, camera, [(0, 0, 96, 128)], max_missing=1.0))
            )
    return _range(found)


def of_fisheyes(focal_length: float) -> tuple[float, float]:
    """Of a window over the whole image of a fisheye, whose focal length says how far it sees."""
    found = []
    for noise in (*UNEVEN, *(replace(rp.noise.kinect_v1(), falloff=falloff) for falloff in (1.0, 4.0))):
        camera = replace(_camera(noise), fx=focal_length, fy=focal_length, distortion_model="fisheye")
        alpha = np.array([0.05, 0.1, 0.6])
        depth, mask = 1.0 / _inverse_depth(camera, alpha), np.ones(camera.shape, bool)
        found.append(_ratios(camera, mask, alpha, rp.fit_windows(depth, camera, [(0, 0, 96, 128)])))
    return _range(found)


def of_standard_methods(nearest: float, farthest: float) -> tuple[float, float]:
    """Of the standard methods, of a floor that spans these depths."""
    found = []
    for noise in UNEVEN:
        camera = _camera(noise)
        alpha = _floor(camera, nearest, farthest)
        depth, mask = 1.0 / _inverse_depth(camera, alpha), np.ones(camera.shape, bool)
        for method in STANDARD:
            for fits in (
                rp.fit_labels(depth, camera, mask, method),
                rp.fit_windows(depth, camera, [(0, 0, 96, 128)], method),
            ):
                found.append(_ratios(camera, mask, alpha, fits))
    return _range(found)


def p_values(noise: Noise, mask: Mask, runs: int) -> Floats:
    """(runs,) p-values of the pixels of a mask on a plane with that noise; as a label if it is no rectangle."""
    rng = np.random.default_rng(1)
    camera = monte_carlo.tile_camera(mask.shape, noise)
    alpha = monte_carlo.plane_through_middle(camera, 1.0, 20.0)
    found = []
    for start in range(0, runs, 2000):
        error = monte_carlo.correlated_errors(noise, mask, min(2000, runs - start), rng)
        frames = monte_carlo.measure(camera, alpha, len(error), rng, error=error)
        if mask.all():
            found.append(monte_carlo.fit(camera, frames).p_value.ravel())
        else:
            found += [rp.fit_labels(frame, camera, mask, significance=0.0).p_value for frame in frames]
    return np.concatenate(found)


def tiles_of(camera: rp.Camera, alpha: Floats, size: int, method: str = "range_explicit") -> rp.TilePlanes:
    """Fits of many tiles of a plane."""
    q = _inverse_depth(camera, alpha)
    assert camera.noise is not None
    lateral = camera.noise.lateral * np.hypot(*alpha[:2]) / camera.fx
    rng = np.random.default_rng(1)
    deviation = np.hypot(camera.noise.sigma(q), lateral)
    frames = [1.0 / np.maximum(q + deviation * rng.standard_normal(q.shape), 1e-3) for _ in range(4)]
    return rp.TileFitter(camera, size, method, significance=0.0).fit_batch(frames)


def squared_errors(tiles: rp.TilePlanes, alpha: Floats, some: Mask | None = None) -> float:
    """Mean square of errors over the expected one, of some of the tiles that have a plane."""
    chosen = tiles.fitted if some is None else tiles.fitted & some
    error, covariance = tiles.alpha[chosen] - alpha, tiles.alpha_covariance[chosen]
    return float(np.mean(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)) / 3.0)


def of_cut_tiles(size: int) -> float:
    """Squared errors of tiles that a ``depth_range`` cuts."""
    camera, alpha = replace(_frame(rp.noise.kinect_v1()), depth_range=(0.5, 2.0)), np.array([0.02, -0.5, 0.5])
    tiles = tiles_of(camera, alpha, size)
    return squared_errors(tiles, alpha, tiles.valid_count < size * size)


def of_neighbours(size: int) -> tuple[float, float]:
    """Shares of neighbours on one plane at 2 m that are told apart at the 1 % level, by α and by (n, d)."""
    tiles = tiles_of(_frame(rp.noise.kinect_v1()), np.array([0.05, -0.1, 0.5]), size)
    left, right = np.s_[:, :, :-1:2], np.s_[:, :, 1::2]
    shares = []
    for plane, covariance in ((tiles.alpha, tiles.alpha_covariance), (tiles.planes, tiles.plane_covariance)):
        p = rp.uncertainty.same_plane(plane[left], covariance[left], plane[right], covariance[right])
        shares.append(float(np.mean(p < 0.01)))
    return shares[0], shares[1]


def of_lateral_errors(size: int) -> tuple[float, float]:
    """Squared errors of the tiles of a floor by a large lateral error, and the share of p-values below 0.01."""
    alpha = np.array([0.05, -0.5, 0.6])
    tiles = tiles_of(_frame(Noise(lateral=0.9)), alpha, size)
    return squared_errors(tiles, alpha), float(np.mean(tiles.p_value < 0.01))


def _frame(noise: Noise) -> rp.Camera:
    return rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, noise=noise)


def _camera(noise: Noise) -> rp.Camera:
    return rp.Camera(128, 96, 105.0, 105.0, 63.5, 47.5, noise=noise)


def _floor(camera: rp.Camera, nearest: float, farthest: float) -> Floats:
    """α of a plane that is so far at the lower and at the upper edge of the image."""
    top, bottom = camera.tan_y_rows[[0, -1]]
    slope = (1.0 / nearest - 1.0 / farthest) / (bottom - top)
    return np.array([0.0, slope, 1.0 / farthest - slope * top])


def _inverse_depth(camera: rp.Camera, alpha: Floats) -> Floats:
    return np.asarray(alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2])


def _ratios(camera: rp.Camera, mask: Mask, alpha: Floats, fits: PlaneFits) -> Floats:
    """The ratios of the variances that a fit to the pixels of a mask, on the plane α, reports to the exact ones."""
    exact = monte_carlo.exact_covariance(camera, mask, alpha)
    return np.asarray(eigvalsh(fits.alpha_covariance.reshape(-1, 3, 3)[0], exact))


def _range(found: Sequence[Floats]) -> tuple[float, float]:
    return float(np.min(found)), float(np.max(found))


def report(runs: int) -> Iterator[str]:
    """The lines that are printed; ``runs`` planes are simulated for p-values."""

    def line(name: str, limits: tuple[float, float]) -> str:
        return f"  {name}: {limits[0]:.2f} to {limits[1]:.2g}"

    yield "Variances that are reported, over the exact ones:"
    for name, mask in masks().items():
        yield line(name, of_masks(mask))
    for side in (8, 16, 24):
        yield line(f"tiles of {side} pixels, noise that changes with depth or place", of_tiles(side))
    yield line("tiles of which half is missing in one piece, noise that neighbours share", of_holes())
    yield line("a window from 1.7 to 9 m, half of it missing in one piece", of_windows())
    for degrees, focal_length in ((43, 105.0), (65, 70.0)):
        yield line(
            f"a window over the image of a fisheye, to {degrees} degrees off the axis", of_fisheyes(focal_length)
        )
    for depths in ((1.5, 2.4), (1.0, 9.0)):
        yield line("the standard methods from {:g} to {:g} m".format(*depths), of_standard_methods(*depths))
    yield "Squares of errors, over the expected ones:"
    for metres in (1.0, 2.0):
        alpha = np.array([0.1, 0.05, 1.0]) / metres
        for method in ("range_explicit", *STANDARD):
            tiles = tiles_of(_frame(rp.noise.kinect_v1()), alpha, 16, method)
            yield f"  {method}, tiles of 16 pixels at {metres:g} m: {squared_errors(tiles, alpha):.2g}"
    for side in (8, 16, 32):
        yield f"  tiles of {side} pixels, cut by a depth_range: {of_cut_tiles(side):.2g}"
    for side in (2, 4, 8, 16):
        squares, share = of_lateral_errors(side)
        yield f"  tiles of {side} pixels, lateral error of 0.9: {squares:.2g}; {share:.1%} of p-values below 0.01"
    yield "Neighbours on one plane that are told apart at the 1 % level, by alpha and by (n, d):"
    for side in (4, 6, 8, 16):
        yield "  tiles of {} pixels: {:.1%} and {:.1%}".format(side, *of_neighbours(side))
    yield "Shares of p-values below 0.01, and below 0.001:"
    for side in (8, 16, 24):
        p = p_values(TAILS, np.ones((side, side), bool), runs)
        yield f"  tiles of {side} pixels, 60 % correlated over 2: {np.mean(p < 0.01):.1%}, {np.mean(p < 0.001):.2%}"
    for height, width in ((64, 64), (16, 128)):
        found = [p_values(noise, np.ones((height, width), bool), runs // 10) for noise in FLOORS]
        percent, permille = ([np.mean(p < level) for p in found] for level in (0.01, 0.001))
        yield (
            f"  windows of {height} x {width}, with a floor: {min(percent):.1%} to {max(percent):.1%}, "
            f"{min(permille):.2%} to {max(permille):.2%}"
        )
    for name, mask in masks().items():
        shares = [np.mean(p_values(noise, mask, runs // 100) < 0.01) for noise in SHARED]
        yield f"  {name}: {min(shares):.1%} to {max(shares):.1%} below 0.01"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(prog="python -m bench.limits", description=__doc__)
    parser.add_argument("--runs", type=int, default=100_000, help="simulated planes (100000)")
    for line in report(parser.parse_args(arguments).runs):
        print(line, flush=True)


if __name__ == "__main__":
    main()
