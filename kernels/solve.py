"""From moments to planes: the five methods' solves, for a strip of tiles at a time.

A strip is up to `moments.TILES` tiles: moments (10, TILES), reference points (3, TILES) and room (WORK, TILES), of
which ``count`` columns are filled. The loops run over the tiles and vectorise. Planes are written from entry
``first`` of flat output arrays. A status says why a tile has no plane; its numbers are then NaN.
"""

import math

import numpy as np

from . import eigen4, secular
from ._jit import kernel
from .eigen3 import smallest_eigenpair
from .moments import TILES

# Values of rgbd_planes.TileStatus.
OK, TOO_FEW, DEGENERATE, ROUGH = 0, 1, 2, 3

# Points count as collinear where the smaller eigenvalue of their scatter is below this share of the larger.
# One pixel beside a row of 64 is at 1e-5; rounding is at 1e-15.
COLLINEAR = 1e-9
# A plane counts as passing through the camera centre below this distance, as a share of the depth.
CENTRE = 1e-6

# The methods by number, in the order of rgbd_planes' own list.
RANGE_EXPLICIT, RANGE_IMPLICIT, STANDARD_EXPLICIT, STANDARD_IMPLICIT, STANDARD_PCA = range(5)

# Rows of room that a strip's solve needs.
WORK = 16


@kernel(inline=True)
def explicit(moments, reference, count, solution, residual):
    """Least squares of w on (u, v, 1): the paper's eq. explicit_fit_std and eq. RGBD_explicit_fit.

    Centred on the valid pixels' mean, MᵀM leaves a 2x2 system.

    Parameters
    ----------
    solution : (3, N) float64, written
        a, b, c of w = a·u + b·v + c.
    residual : (N,) float64, written
        Sum of squared residuals; NaN where the pixels are collinear.
    """
    for i in range(count):
        mean = 1.0 / moments[0, i]
        mean_u = moments[1, i] * mean
        mean_v = moments[2, i] * mean
        mean_w = moments[3, i] * mean
        c_uu = moments[4, i] - moments[1, i] * mean_u
        c_uv = moments[5, i] - moments[1, i] * mean_v
        c_uw = moments[6, i] - moments[1, i] * mean_w
        c_vv = moments[7, i] - moments[2, i] * mean_v
        c_vw = moments[8, i] - moments[2, i] * mean_w
        c_ww = moments[9, i] - moments[3, i] * mean_w
        determinant = c_uu * c_vv - c_uv * c_uv
        trace = c_uu + c_vv
        a = (c_vv * c_uw - c_uv * c_vw) / determinant
        b = (c_uu * c_vw - c_uv * c_uw) / determinant
        solution[0, i] = a
        solution[1, i] = b
        solution[2, i] = (
            (reference[2, i] + mean_w) - a * (reference[0, i] + mean_u) - b * (reference[1, i] + mean_v)
        )
        left = c_ww - a * c_uw - b * c_vw
        left = left if left > 0.0 else 0.0
        residual[i] = left if determinant > COLLINEAR * trace * trace else math.nan


@kernel(inline=True)
def range_planes(
    implicit, moments, reference, needed, max_error, count, work, first,
    planes, alpha, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Planes of q = α·m (eq. RGBD_space_plane_eq): d = 1/‖α‖ and n = -α/‖α‖, facing the camera.

    Parameters
    ----------
    implicit : bool
        Turn the explicit solutions into the implicit ones (eq. tan_theta_scattermatrix).
    needed : (T,) float64
        Fewer valid pixels give TOO_FEW.
    max_error : float
        Tiles with a larger ``rmse_metric`` get ROUGH.
    planes, alpha, rmse, rmse_metric, valid_count, status : (T, 4), (T, 3), (T,)..., written from ``first``
    """
    solution, residual, own, metric, distance, reason = work[:3], work[3], work[4], work[5], work[6], work[7]
    explicit(moments, reference, count, solution, residual)
    if implicit:
        for i in range(count):
            own[i] = residual[i] if moments[0, i] >= needed[first + i] else math.nan
        secular.smallest_eigenvectors(moments, reference, count, work[8:], solution, own)
        for i in range(count):
            a, b, c = solution[0, i], solution[1, i], solution[2, i]
            residual[i] = own[i] * (1.0 + a * a + b * b + c * c)
    else:
        for i in range(count):
            own[i] = residual[i]
    for i in range(count):
        n = moments[0, i]
        mean = 1.0 / n
        a, b, c = solution[0, i], solution[1, i], solution[2, i]
        d = 1.0 / math.sqrt(a * a + b * b + c * c)
        mean_q = reference[2, i] + moments[3, i] * mean
        # n·X + d = d·Z·(q - α·m): to first order, with one depth for the tile. NaN without a plane.
        error = d / mean_q * math.sqrt(residual[i] * mean)
        enough = n >= needed[first + i]
        fitted = enough & (d < math.inf) & (error == error)
        nothing = 0.0 if fitted else math.nan
        solution[0, i] = a + nothing
        solution[1, i] = b + nothing
        solution[2, i] = c + nothing
        distance[i] = d + nothing
        own[i] = math.sqrt(own[i] * mean) + nothing
        metric[i] = error + nothing
        rough = ROUGH if error > max_error else OK
        reason[i] = (rough if fitted else DEGENERATE) if enough else TOO_FEW
    for i in range(count):
        d = distance[i]
        planes[first + i, 0] = -solution[0, i] * d
        planes[first + i, 1] = -solution[1, i] * d
        planes[first + i, 2] = -solution[2, i] * d
        planes[first + i, 3] = d
    for i in range(count):
        alpha[first + i, 0] = solution[0, i]
        alpha[first + i, 1] = solution[1, i]
        alpha[first + i, 2] = solution[2, i]
    for i in range(count):
        rmse[first + i] = own[i]
    for i in range(count):
        rmse_metric[first + i] = metric[i]
    for i in range(count):
        valid_count[first + i] = np.int32(moments[0, i])
    for i in range(count):
        status[first + i] = np.uint8(np.int32(reason[i]))


@kernel(inline=True)
def write_plane(x, y, z, d, near, i, planes, alpha):
    """Write the plane x·X + y·Y + z·Z + d = 0 of any sign and norm; return its norm, or 0 if degenerate."""
    norm = math.sqrt(x * x + y * y + z * z)
    if norm == 0.0 or not abs(d) > CENTRE * near * norm:
        return 0.0
    sign = math.copysign(1.0 / norm, d)
    planes[i, 0] = x * sign
    planes[i, 1] = y * sign
    planes[i, 2] = z * sign
    planes[i, 3] = d * sign
    alpha[i, 0] = -x / d
    alpha[i, 1] = -y / d
    alpha[i, 2] = -z / d
    return norm


@kernel(inline=True)
def standard_planes(
    method, moments, reference, needed, max_error, count, work, first,
    planes, alpha, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Planes from the moments of (X, Y, Z); see `range_planes` for the arrays.

    ``method`` 0 is explicit, 1 implicit (eq. implicit_plane_fitting_error: smallest eigenvector of
    eq. XYZ_scattermatrix, all four coefficients of norm 1) and 2 PCA (smallest eigenvector of the centred 3x3
    scatter matrix).
    """
    solution, residual = work[:3], work[3]
    if method == 0:
        explicit(moments, reference, count, solution, residual)
    for i in range(count):
        n = moments[0, i]
        t = first + i
        valid_count[t] = np.int32(n)
        planes[t, :] = math.nan
        alpha[t, :] = math.nan
        rmse[t] = math.nan
        rmse_metric[t] = math.nan
        if n < needed[t]:
            status[t] = TOO_FEW
            continue
        status[t] = DEGENERATE
        mean_x = reference[0, i] + moments[1, i] / n
        mean_y = reference[1, i] + moments[2, i] / n
        mean_z = reference[2, i] + moments[3, i] / n
        if method == 0:
            if math.isnan(residual[i]):
                continue
            a = solution[0, i]
            b = solution[1, i]
            norm = write_plane(a, b, -1.0, solution[2, i], mean_z, t, planes, alpha)
            own = error = math.sqrt(residual[i] / n)
            error /= math.sqrt(1.0 + a * a + b * b)
        else:
            c_xx = moments[4, i] - moments[1, i] * (moments[1, i] / n)
            c_xy = moments[5, i] - moments[1, i] * (moments[2, i] / n)
            c_xz = moments[6, i] - moments[1, i] * (moments[3, i] / n)
            c_yy = moments[7, i] - moments[2, i] * (moments[2, i] / n)
            c_yz = moments[8, i] - moments[2, i] * (moments[3, i] / n)
            c_zz = moments[9, i] - moments[3, i] * (moments[3, i] / n)
            # λ₂λ₃ and λ₂ + λ₃ or more, so this bounds λ₂ against λ₃.
            minors = (c_yy * c_zz - c_yz * c_yz) + (c_xx * c_zz - c_xz * c_xz) + (c_xx * c_yy - c_xy * c_xy)
            trace = c_xx + c_yy + c_zz
            if not minors > COLLINEAR * trace * trace:
                continue
            if method == 1:
                value, x, y, z = eigen4.smallest_eigenvector(
                    n, mean_x, mean_y, mean_z, c_xx, c_xy, c_xz, c_yy, c_yz, c_zz
                )
                norm = write_plane(x, y, z, -1.0, mean_z, t, planes, alpha)
                own = math.sqrt(value / n)
                error = own * math.sqrt(1.0 + 1.0 / (x * x + y * y + z * z))
            else:
                value, x, y, z = smallest_eigenpair(c_xx, c_xy, c_xz, c_yy, c_yz, c_zz)
                d = -(x * mean_x + y * mean_y + z * mean_z)
                norm = write_plane(x, y, z, d, mean_z, t, planes, alpha)
                own = error = math.sqrt(value / n)
        if norm == 0.0:
            continue
        rmse[t] = own
        rmse_metric[t] = error
        status[t] = ROUGH if error > max_error else OK


@kernel()
def fit_moments(
    method, moments, reference, needed, max_error, start, stop,
    planes, alpha, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Planes from moments that are there: entries ``start`` to ``stop`` of (10, T), in range space or in (X, Y, Z).

    ``method`` is a number, see `RANGE_EXPLICIT`.
    """
    room = np.empty((13 + WORK, TILES))
    block_moments, block_reference, work = room[:10], room[10:13], room[13:]
    for first in range(start, stop, TILES):
        count = min(TILES, stop - first)
        for entry in range(10):
            for i in range(count):
                block_moments[entry, i] = moments[entry, first + i]
        for axis in range(3):
            for i in range(count):
                block_reference[axis, i] = reference[axis, first + i]
        if method <= RANGE_IMPLICIT:
            range_planes(
                method == RANGE_IMPLICIT, block_moments, block_reference, needed, max_error, count, work, first,
                planes, alpha, rmse, rmse_metric, valid_count, status,
            )  # fmt: skip
        else:
            standard_planes(
                method - STANDARD_EXPLICIT, block_moments, block_reference, needed, max_error, count, work, first,
                planes, alpha, rmse, rmse_metric, valid_count, status,
            )  # fmt: skip
