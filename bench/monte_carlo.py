"""Many noisy measurements of one tile's plane, with the noise that a model says."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

import rgbd_planes as rp
from rgbd_planes._core.arrays import Floats

# Of errors that neighbours share over two lengths, and a bias.
CORRELATED = rp.noise.NoiseModel(correlation=((0.3, 1.5), (0.2, 5.0)), floor=0.5, floor_length=20.0)


def tile_camera(
    tile: int | tuple[int, int], noise: rp.noise.NoiseModel | None, *, left: int = 0, top: int = 0, focal: float = 525.0
) -> rp.Camera:
    """A camera that sees one tile, its first pixel at column ``left``, row ``top`` of 640x480 ones."""
    height, width = np.broadcast_to(tile, 2).tolist()
    return rp.Camera(640, 480, focal, focal, 319.5, 239.5, noise=noise).cropped(left, top, width, height)


def repeat(camera: rp.Camera, times: int) -> rp.Camera:
    """A camera that sees what ``camera`` sees ``times`` x ``times`` times side by side.

    No lens does that: it lets one frame hold many measurements of the same pixels.
    """
    width, height = times * camera.width, times * camera.height
    no_bend = (1e-300, 0.0, 0.0, 0.0)  # distorted, as far as the library knows, so that it uses the tables
    many = rp.Camera(width, height, width, height, 0.5 * width, 0.5 * height, no_bend, noise=camera.noise)
    tan_x, tan_y = (np.tile(table, (times, times)) for table in (camera.tan_x, camera.tan_y))
    many.__dict__["_tables"] = tan_x, tan_y, None  # every pixel has a ray
    return many


def plane_through_middle(camera: rp.Camera, depth: float, incidence: float, direction: float = 0.6) -> Floats:
    """α of the plane that the ray through the middle of the image meets at this depth and angle (degrees)."""
    ray = np.array([camera.tan_x.mean(), camera.tan_y.mean(), 1.0])
    unit = ray / np.linalg.norm(ray)
    across = np.cross(unit, [np.cos(direction), np.sin(direction), 0.1])
    across /= np.linalg.norm(across)
    normal = -np.cos(np.radians(incidence)) * unit + np.sin(np.radians(incidence)) * across
    return np.asarray(normal / (normal @ ray * depth))


def plane_of(alpha: Floats) -> Floats:
    """(nx, ny, nz, d) of α."""
    d = 1.0 / float(np.linalg.norm(alpha))
    return np.append(-d * alpha, d)


def measure(
    camera: rp.Camera,
    alpha: Floats,
    runs: int,
    rng: np.random.Generator,
    *,
    holes: float = 0.0,
    error: Floats | None = None,
) -> Floats:
    """(runs, H, W) depth in metres, NaN where missing.

    Errors are independent and normal with the standard deviation of ``camera.noise``, or as ``error`` gives.
    """
    q = alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2]
    if error is None:
        assert camera.noise is not None
        error = rng.standard_normal((runs, *q.shape)) * camera.noise.sigma(q)
    depth: Floats = 1.0 / (q + error)
    if holes:
        # The same holes in every run: then one covariance holds for all.
        depth[:, rng.random(q.shape) < holes] = np.nan
    return depth


def fit(camera: rp.Camera, frames: NDArray[Any], method: str = "range_explicit") -> rp.TilePlanes:
    """The planes of all runs: arrays of shape (runs, ...)."""
    fitter = rp.TileFitter(camera, camera.shape, method, max_missing=1.0, significance=0.0, num_threads=1)
    return fitter.fit_batch(frames)


def normalised_error(stack: rp.TilePlanes, alpha: Floats) -> Floats:
    """δᵀΣ⁻¹δ of every run's α: chi-square with 3 degrees of freedom, if the covariance is right."""
    error = stack.alpha.reshape(-1, 3) - alpha
    covariance = stack.alpha_covariance.reshape(-1, 3, 3)
    return np.asarray(np.einsum("ki,ki->k", error, np.linalg.solve(covariance, error[..., None])[..., 0]))


def correlations(noise: rp.noise.NoiseModel, mask: NDArray[np.bool_]) -> Floats:
    """(N, N): covariance of the errors of the N pixels of a mask in units of their variance."""
    places = np.argwhere(mask)
    square = ((places[:, None] - places) ** 2).sum(axis=-1)
    made = (1.0 - sum(share for share, _ in noise.correlation)) * np.eye(len(places))
    for variance, length in (*noise.correlation, (noise.floor**2, noise.floor_length)):
        made += variance * np.exp(-0.5 * square / length**2)
    return np.asarray(made)


def correlated_errors(
    noise: rp.noise.NoiseModel, mask: NDArray[np.bool_], runs: int, rng: np.random.Generator
) -> Floats:
    """(runs, H, W): errors of 1/Z at 1 m of the pixels of a mask, as the model has them; NaN elsewhere."""
    root = np.linalg.cholesky(correlations(noise, mask) + 1e-9 * np.eye(int(mask.sum())))
    error = np.full((runs, *mask.shape), np.nan)
    error[:, mask] = rng.standard_normal((runs, len(root))) @ root.T * noise.sigma(1.0)
    return error


def exact_covariance(camera: rp.Camera, mask: NDArray[np.bool_], alpha: Floats) -> Floats:
    """(3, 3): A⁻¹MᵀCMA⁻¹ for the pixels of a mask on the plane α, with the covariance C of all pairs of them."""
    noise = camera.noise
    assert noise is not None
    rays = np.dstack([*np.broadcast_arrays(camera.tan_x, camera.tan_y), np.ones(camera.shape)])[mask]
    along = noise._along(rays @ alpha) * noise._growth(*rays.T[:2]) ** 0.5
    alone = noise._rounding(rays @ alpha)
    alone = alone + noise.lateral**2 * ((alpha[0] / camera.fx) ** 2 + (alpha[1] / camera.fy) ** 2)
    solve = np.linalg.inv(rays.T @ rays) @ rays.T
    shared, of_alone = solve * along, solve * alone**0.5
    exact = shared @ (shared.T if noise.is_independent else correlations(noise, mask) @ shared.T)
    return np.asarray(exact + of_alone @ of_alone.T)
