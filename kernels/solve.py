"""From moments to planes, tile by tile: the five methods' solves.

Each kernel works on tiles ``start`` to ``stop``. Moments are (10, T) and the reference point (3, T), as
``moments`` describes. A status says why a tile has no plane; its numbers are then NaN.
"""

import math

from . import eigen4, secular
from ._jit import kernel
from .eigen3 import smallest_eigenpair

# Values of rgbd_planes.TileStatus.
OK, TOO_FEW, DEGENERATE, ROUGH = 0, 1, 2, 3

# Points count as collinear where the smaller eigenvalue of their scatter is below this share of the larger.
# One pixel beside a row of 64 is at 1e-5; rounding is at 1e-15.
COLLINEAR = 1e-9
# A plane counts as passing through the camera centre below this distance, as a share of the depth.
CENTRE = 1e-6


@kernel()
def explicit(moments, reference, valid_needed, start, stop, coefficients, residual, status):
    """Least squares of w on (u, v, 1): the paper's eq. explicit_fit_std and eq. RGBD_explicit_fit.

    Centred on the valid pixels' mean, MᵀM leaves a 2x2 system.

    Parameters
    ----------
    valid_needed : (T,) float64
        Fewer valid pixels give TOO_FEW.
    coefficients : (3, T) float64, written
        a, b, c of w = a·u + b·v + c.
    residual : (T,) float64, written
        Sum of squared residuals.
    status : (T,) uint8, written
    """
    for i in range(start, stop):
        n = moments[0, i]
        mean_u = moments[1, i] / n
        mean_v = moments[2, i] / n
        mean_w = moments[3, i] / n
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
        coefficients[0, i] = a
        coefficients[1, i] = b
        coefficients[2, i] = (
            (reference[2, i] + mean_w) - a * (reference[0, i] + mean_u) - b * (reference[1, i] + mean_v)
        )
        residual[i] = max(c_ww - a * c_uw - b * c_vw, 0.0)
        determined = determinant > COLLINEAR * trace * trace
        status[i] = TOO_FEW if n < valid_needed[i] else (OK if determined else DEGENERATE)


@kernel()
def range_implicit(moments, reference, start, stop, coefficients, residual, eigenvalue, status):
    """Turn explicit range-space solutions into the implicit ones (eq. tan_theta_scattermatrix).

    ``coefficients`` and ``residual`` hold the explicit solution on entry and α and its sum of squared
    residuals in inverse depth on return; ``eigenvalue`` is written.
    """
    for i in range(start, stop):
        if status[i] != OK:
            continue
        value, a, b, c = secular.smallest_eigenvector(
            moments[0, i], moments[1, i], moments[2, i], moments[4, i], moments[5, i], moments[7, i],
            reference[0, i], reference[1, i], reference[2, i], moments[3, i], moments[6, i], moments[8, i],
            coefficients[0, i], coefficients[1, i], coefficients[2, i], residual[i],
        )  # fmt: skip
        if not math.isfinite(value):
            status[i] = DEGENERATE
        coefficients[0, i] = a
        coefficients[1, i] = b
        coefficients[2, i] = c
        eigenvalue[i] = value
        residual[i] = value * (1.0 + a * a + b * b + c * c)


@kernel()
def range_planes(
    moments, reference, coefficients, residual, own_residual, max_error, start, stop,
    planes, alpha, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Planes of q = α·m: d = 1/‖α‖ and n = -α/‖α‖, facing the camera.

    Parameters
    ----------
    residual, own_residual : (T,) float64
        Sum of squared residuals in inverse depth, and in the method's own units.
    max_error : float
        Tiles with a larger ``rmse_metric`` get ROUGH.
    planes, alpha, rmse, rmse_metric, valid_count, status : (T, 4), (T, 3), (T,)..., written
    """
    for i in range(start, stop):
        n = moments[0, i]
        a = coefficients[0, i]
        b = coefficients[1, i]
        c = coefficients[2, i]
        d = 1.0 / math.sqrt(a * a + b * b + c * c)
        fitted = status[i] == OK and d < math.inf
        nan = 0.0 if fitted else math.nan
        planes[i, 0] = nan - a * d
        planes[i, 1] = nan - b * d
        planes[i, 2] = nan - c * d
        planes[i, 3] = nan + d
        alpha[i, 0] = nan + a
        alpha[i, 1] = nan + b
        alpha[i, 2] = nan + c
        mean_q = reference[2, i] + moments[3, i] / n
        # n·X + d = d·Z·(q - α·m): to first order, with one depth for the tile.
        error = nan + d / mean_q * math.sqrt(residual[i] / n)
        rmse[i] = nan + math.sqrt(own_residual[i] / n)
        rmse_metric[i] = error
        valid_count[i] = int(n)
        if fitted:
            status[i] = ROUGH if error > max_error else OK
        elif status[i] == OK:
            status[i] = DEGENERATE


@kernel()
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


@kernel()
def standard_planes(
    method, moments, reference, valid_needed, coefficients, residual, max_error, start, stop,
    planes, alpha, rmse, rmse_metric, valid_count, status,
):  # fmt: skip
    """Planes from the moments of (X, Y, Z).

    ``method`` 0 is explicit (from ``coefficients``, ``residual`` and ``status`` of `explicit`), 1 implicit
    (smallest eigenvector of eq. XYZ_scattermatrix, all four coefficients of norm 1) and 2 PCA (smallest
    eigenvector of the centred 3x3 scatter matrix).
    """
    for i in range(start, stop):
        n = moments[0, i]
        valid_count[i] = int(n)
        planes[i, :] = math.nan
        alpha[i, :] = math.nan
        rmse[i] = math.nan
        rmse_metric[i] = math.nan
        if n < valid_needed[i]:
            status[i] = TOO_FEW
            continue
        mean_x = reference[0, i] + moments[1, i] / n
        mean_y = reference[1, i] + moments[2, i] / n
        mean_z = reference[2, i] + moments[3, i] / n
        if method == 0:
            if status[i] == DEGENERATE:
                continue
            a = coefficients[0, i]
            b = coefficients[1, i]
            norm = write_plane(a, b, -1.0, coefficients[2, i], mean_z, i, planes, alpha)
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
                status[i] = DEGENERATE
                continue
            if method == 1:
                value, x, y, z = eigen4.smallest_eigenvector(
                    n, mean_x, mean_y, mean_z, c_xx, c_xy, c_xz, c_yy, c_yz, c_zz
                )
                norm = write_plane(x, y, z, -1.0, mean_z, i, planes, alpha)
                own = math.sqrt(value / n)
                error = own * math.sqrt(1.0 + 1.0 / (x * x + y * y + z * z))
            else:
                value, x, y, z = smallest_eigenpair(c_xx, c_xy, c_xz, c_yy, c_yz, c_zz)
                d = -(x * mean_x + y * mean_y + z * mean_z)
                norm = write_plane(x, y, z, d, mean_z, i, planes, alpha)
                own = error = math.sqrt(value / n)
        if norm == 0.0:
            status[i] = DEGENERATE
            continue
        rmse[i] = own
        rmse_metric[i] = error
        status[i] = ROUGH if error > max_error else OK
