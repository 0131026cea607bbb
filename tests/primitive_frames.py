"""Frames of planes, balls, pipes, bowls and cones, and maximum likelihood in plain NumPy and SciPy, for primitives."""

import numpy as np
from curved_frames import rays_of
from scipy import ndimage
from scipy.optimize import least_squares

import rgbd_planes as rp

SIGMA = 1.425e-3
CAMERA = rp.Camera(120, 90, 130.0, 130.0, 59.5, 44.5, noise=rp.noise.kinect_v1())


def inverse_depth_of(rays, kind, parameters, near):
    """q of a plane α, a sphere (C, R) or a cylinder (C, a, R) on rays (..., 3); NaN where they miss it.

    ``near`` is the nearer of two points, as on a ball; else the farther, as within a pipe.
    """
    if kind == "plane":
        return rays @ parameters
    centre, radius = np.asarray(parameters[:3], float), parameters[-1]
    if kind == "cylinder":
        axis = np.asarray(parameters[3:6], float) / np.linalg.norm(parameters[3:6])
        across = np.eye(3) - np.outer(axis, axis)
        rays, centre = rays @ across, across @ centre
    a, b, c = (rays**2).sum(axis=-1), rays @ centre, centre @ centre - radius**2
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        q = a / (b - root if near else b + root)
    return np.where(q > 0.0, q, np.nan)


def frame_of(q, sigma=0.0, seed=0):
    """Depth in metres with noise constant in inverse depth; 0 where q is NaN."""
    noisy = q + sigma * np.random.default_rng(seed).standard_normal(q.shape)
    return np.nan_to_num(1.0 / noisy, nan=0.0)


def shared_errors(model, shape, rng):
    """Errors of a model of constant σ as its correlation and floor have them, in 1/m."""
    margin = 40
    wide = np.add(shape, 2 * margin)
    parts = [*model.correlation, (model.floor**2, model.floor_length)]
    total = np.sqrt(1.0 - sum(share for share, _ in model.correlation)) * rng.standard_normal(wide)
    for share, length in parts:
        width = length / np.sqrt(2.0)
        smooth = ndimage.gaussian_filter(rng.standard_normal(wide), width, mode="wrap")
        total += np.sqrt(share) * smooth * 2.0 * width * np.sqrt(np.pi)
    return model.coefficients[0] * total[margin:-margin, margin:-margin]


def interior_of(mask, valid):
    """Pixels of a mask whose valid neighbours are in it, too: the slow way."""
    other = valid & ~mask
    near = np.zeros(np.add(mask.shape, 2), bool)
    for row in range(3):
        for column in range(3):
            near[row : row + mask.shape[0], column : column + mask.shape[1]] |= other
    return mask & valid & ~near[1:-1, 1:-1]


def most_likely(rays, q, sigma, kind, start, near):
    """The least squares of (q - model) / σ from a start; its parameters, their covariance, and the sum of squares.

    A cylinder has a redundant length of its axis and place along it, which the pseudoinverse leaves out.
    """
    scale = np.full(len(start), 0.01)

    def residuals(x):
        r = (q - inverse_depth_of(rays, kind, x, near)) / sigma
        return np.nan_to_num(r, nan=1e3)

    found = least_squares(residuals, start, x_scale=scale, xtol=1e-14, ftol=1e-14, gtol=1e-12, method="trf")
    jacobian = np.empty((len(q), len(start)))
    for k in range(len(start)):
        step = np.zeros(len(start))
        step[k] = 1e-6
        jacobian[:, k] = (residuals(found.x + step) - residuals(found.x - step)) / 2e-6
    return found.x, np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-9), 2.0 * found.cost


BALL = ("sphere", (0.05, -0.02, 1.0, 0.2), True)
DOME = ("sphere", (0.1, 0.05, 0.3, 1.2), False)  # the camera is inside
BOWL = ("sphere", (0.02, 0.04, 0.9, 0.25), False)  # seen from outside, past the half that is not there
PIPE = ("cylinder", (0.03, 0.0, 1.1, 0.2, 1.0, 0.3, 0.15), True)
TUNNEL = ("cylinder", (0.1, 0.0, 0.0, 0.1, 0.2, 1.0, 0.8), False)  # the camera is inside, and looks along it
GUTTER = ("cylinder", (0.0, 0.05, 1.0, 1.0, 0.1, 0.2, 0.2), False)
SHAPES = {"ball": BALL, "dome": DOME, "bowl": BOWL, "pipe": PIPE, "tunnel": TUNNEL, "gutter": GUTTER}


def rays_and_q(name, camera=CAMERA):
    """Rays, and the exact q of a shape, NaN where it is not seen: beyond what points away, or too far behind."""
    kind, parameters, near = SHAPES[name]
    rays = rays_of(camera)
    q = inverse_depth_of(rays, kind, parameters, near)
    if name == "tunnel":
        q = np.where(q > 0.25, q, np.nan)
    if name in ("bowl", "gutter"):
        q = np.where(1.0 / q > parameters[2] + 0.12, q, np.nan)
    return rays, q


def cone(rays, apex=(0.0, -0.35, 1.0), slope=0.35):
    """q of an upright cone, NaN beside it."""
    apex = np.asarray(apex)
    # |across|² = (slope·along)² with X = Z·m.
    form = np.diag([1.0, -(slope**2), 1.0])
    a = np.einsum("...i,ij,...j->...", rays, form, rays)
    b, c = rays @ form @ apex, apex @ form @ apex
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        z = (b - root) / a
    z = np.where(a < 0.0, (b + root) / a, z)
    y = z * rays[..., 1]
    with np.errstate(invalid="ignore"):
        return np.where((y > apex[1] + 0.1) & (y < apex[1] + 0.6) & (z > 0.0), 1.0 / z, np.nan)
