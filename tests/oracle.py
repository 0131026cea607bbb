"""The plain NumPy answer to every fit, written from the equations for clarity.

A tile's valid pixels become points, and each method is `lstsq` or `svd` on those points: no moments, no
normal equations, no code of the library but the camera's rays.
"""

from dataclasses import dataclass

import numpy as np

OK, TOO_FEW, DEGENERATE, ROUGH = 0, 1, 2, 3


@dataclass
class Plane:
    """The oracle's answer for one tile; plane and residuals are NaN unless it has a plane."""

    status: int
    count: int
    plane: np.ndarray
    rmse: float = np.nan
    rmse_metric: float = np.nan
    well_posed: bool = True


def inverse_depth(depth, camera):
    """Inverse depth of every pixel, NaN where missing, by the depth contract."""
    values = np.asarray(depth, np.float64)
    missing = ~np.isfinite(values) | np.isin(values, camera.invalid_values)
    with np.errstate(all="ignore"):
        if camera.disparity is not None:
            q = camera.disparity[0] * values + camera.disparity[1]
        else:
            scale = camera.depth_scale if np.asarray(depth).dtype.kind in "ui" else 1.0
            missing |= values <= 0
            q = scale / values
        missing |= ~(q > 0)
        if camera.depth_range is not None:
            z = 1.0 / q
            missing |= ~((z >= camera.depth_range[0]) & (z <= camera.depth_range[1]))
    return np.where(missing, np.nan, q)


def smallest_direction(matrix):
    """Right singular vector of the smallest singular value, and the mean square it leaves."""
    # Only a fat matrix needs the vectors beyond its singular values.
    _, singular, vectors = np.linalg.svd(matrix, full_matrices=len(matrix) < matrix.shape[1])
    smallest = singular[-1] if len(singular) == matrix.shape[1] else 0.0
    return vectors[-1], smallest**2 / len(matrix)


def solve(method, x, y, q):
    """(nx, ny, nz, d) with any sign, rmse in the method's units, rmse in metres along the normal."""
    z = 1.0 / q
    points = np.column_stack([x * z, y * z, z])
    one = np.ones_like(q)
    if method == "range_explicit":
        rays = np.column_stack([x, y, one])
        alpha = np.linalg.lstsq(rays, q)[0]
        plane = np.append(-alpha, 1.0)
        own = np.sqrt(np.mean((q - rays @ alpha) ** 2))
    elif method == "range_implicit":
        v, mean_square = smallest_direction(np.column_stack([x, y, one, q]))
        plane, own = v, np.sqrt(mean_square)
    elif method == "standard_explicit":
        a, b, c = np.linalg.lstsq(np.column_stack([points[:, :2], one]), z)[0]
        plane = np.array([a, b, -1.0, c])
        own = np.sqrt(np.mean((points @ plane[:3] + c) ** 2))
    elif method == "standard_implicit":
        plane, mean_square = smallest_direction(np.column_stack([points, one]))
        own = np.sqrt(mean_square)
    elif method == "standard_pca":
        mean = points.mean(axis=0)
        normal, mean_square = smallest_direction(points - mean)
        plane, own = np.append(normal, -normal @ mean), np.sqrt(mean_square)
    plane = plane / np.linalg.norm(plane[:3])
    if method.startswith("range"):
        # d·Z·(q - α·m) along the normal, with one depth for the tile.
        rays = np.column_stack([x, y, one])
        alpha = -plane[:3] / plane[3]
        metric = abs(plane[3]) / q.mean() * np.sqrt(np.mean((q - rays @ alpha) ** 2))
    else:
        metric = np.sqrt(np.mean((points @ plane[:3] + plane[3]) ** 2))
    return plane, own, metric


def determined(method, x, y, q):
    """Whether the points are in general position for the method: not collinear, in rays or in space."""
    z = 1.0 / q
    if method.startswith("range"):
        points = np.column_stack([x, y])
    elif method == "standard_explicit":
        points = np.column_stack([x * z, y * z])
    else:
        points = np.column_stack([x * z, y * z, z])
    squares = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) ** 2
    squares = np.append(squares, np.zeros(3 - len(squares)))
    minors = squares[0] * squares[1] + squares[0] * squares[2] + squares[1] * squares[2]
    return bool(minors > 1e-9 * squares.sum() ** 2)


def orient(plane):
    """The same plane with d > 0: the normal faces the camera."""
    return plane * np.copysign(1.0, plane[3])


def angle(a, b):
    """Angle between unit normals in radians, exact for small ones."""
    return 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(np.subtract(a, b), axis=-1), 0.0, 1.0))


def fit(method, x, y, q, max_missing=0.5, max_error=np.inf, change=1e-12):
    """Fit one tile, given its rays and inverse depths, NaN where missing.

    The problem counts as well posed if relative changes of ``change`` in its data hardly move its solution,
    and the plane is not seen edge-on.
    """
    nothing = np.full(4, np.nan)
    valid = np.isfinite(q)
    count = int(valid.sum())
    if count < 3 or q.size - count > max_missing * q.size:
        return Plane(TOO_FEW, count, nothing)
    x, y, q = x[valid], y[valid], q[valid]
    if not determined(method, x, y, q):
        return Plane(DEGENERATE, count, nothing)
    plane, own, metric = solve(method, x, y, q)
    if not abs(plane[3]) > 1e-6 * np.mean(1.0 / q):  # through the camera centre
        return Plane(DEGENERATE, count, nothing)
    a, b, c = 1.0 + change * (np.arange(3 * len(q)) * 7919 % 13 / 6.0 - 1.0).reshape(3, -1)
    moved, _, _ = solve(method, x * a, y * b, q * c)
    plane, moved = orient(plane), orient(moved)
    # A plane that passes the camera at a twentieth of the depth is seen at less than three degrees.
    seen = plane[3] > 0.05 * np.mean(1.0 / q)
    steady = seen and angle(plane[:3], moved[:3]) < 1e-8 and abs(plane[3] - moved[3]) < 1e-9 * abs(plane[3])
    return Plane(ROUGH if metric > max_error else OK, count, plane, own, metric, bool(steady))


def fit_windows(depth, camera, windows, method, **options):
    """Fit every window (row, column, height, width)."""
    q = inverse_depth(depth, camera)
    planes = []
    for row, column, height, width in windows:
        part = (slice(row, row + height), slice(column, column + width))
        planes.append(fit(method, camera.tan_x[part].ravel(), camera.tan_y[part].ravel(), q[part].ravel(), **options))
    return planes


def fit_labels(depth, camera, labels, method, **options):
    """Fit the pixels of labels 1 to K, one after the other."""
    q = inverse_depth(depth, camera)
    labels = np.asarray(labels)
    return [
        fit(method, camera.tan_x[labels == i], camera.tan_y[labels == i], q[labels == i], **options)
        for i in range(1, int(labels.max()) + 1)
    ]


def tile_windows(camera, tile):
    """The windows of a grid of tiles, row by row, the last ones ragged."""
    height, width = (tile, tile) if np.ndim(tile) == 0 else tile
    return [
        (row, column, min(height, camera.height - row), min(width, camera.width - column))
        for row in range(0, camera.height, height)
        for column in range(0, camera.width, width)
    ]
