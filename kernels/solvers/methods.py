"""From moments to planes: the five methods' solves, for a block of tiles at a time.

A block is up to `strips.TILES` tiles: moments (10, TILES), reference points (3, TILES) and scratch memory (WORK,
TILES), of which ``count`` columns are filled. The loops run over the tiles and vectorise. A status says why a tile has
no plane; its numbers are then NaN.
"""

import math

import numpy as np

from .._jit.kernel import kernel
from ..common.arrays import copy_columns
from ..moments.strips import TILES
from . import eigen3, eigen4, secular

# Whether a tile has a plane, or why not.
OK, TOO_FEW, DEGENERATE, ROUGH = 0, 1, 2, 3

# Points count as collinear where the smaller eigenvalue of their scatter is below this share of the larger.
# One pixel beside a row of 64 is at 1e-5; rounding is at 1e-15.
COLLINEAR = 1e-9
# A plane counts as passing through the camera centre below this distance, as a share of the depth.
CENTRE = 1e-6
# Metres. Beyond these, the fourth power of the distance and variances have no digits left: no camera sees such planes.
NEAREST, FARTHEST = 1e-30, 1e30
# Second moments may be off by this share of what they were summed from: anything smaller is not scatter. Moments about
# a tile's centre reach COLLINEAR long before: their kernels omit this test.
MOMENT_ROUNDING = 128 * 2.0**-53

# The methods in (X, Y, Z) by number.
STANDARD_EXPLICIT, STANDARD_IMPLICIT, STANDARD_PCA = range(3)

# Rows of scratch memory that a block's solve needs: for itself, and for eigenvectors of 4x4 matrices, which need most.
SOLVE_WORK = 17
WORK = SOLVE_WORK + eigen4.WORK


@kernel(inline=True)
def explicit(moments, reference, total, count, solution, residual, lost):
    """Least squares of w on (u, v, 1): the paper's eq. 7 and eq. 15.

    Of the normal equations MᵀMα = Mᵀb (eq. 8), centred on the valid pixels' mean, a 2x2 system is left.

    Parameters
    ----------
    total : float or None
        For moments that are differences of sums over the frame, Σuu + Σvv of the frame; 0 for other moments about a
        point that may be far away. With None Numba compiles none of this.
    solution : (3, N) float64, written
        a, b, c of w = a·u + b·v + c.
    residual : (N,) float64, written
        Sum of squared residuals; NaN where the pixels are collinear.
    lost : (N,) float64, written
        Rounding errors as a share of the smaller eigenvalue of the scatter.
    """
    for i in range(count):
        per_pixel = 1.0 / moments[0, i]
        mean_u = moments[1, i] * per_pixel
        mean_v = moments[2, i] * per_pixel
        mean_w = moments[3, i] * per_pixel
        c_uu = moments[4, i] - moments[1, i] * mean_u
        c_uv = moments[5, i] - moments[1, i] * mean_v
        c_uw = moments[6, i] - moments[1, i] * mean_w
        c_vv = moments[7, i] - moments[2, i] * mean_v
        c_vw = moments[8, i] - moments[2, i] * mean_w
        c_ww = moments[9, i] - moments[3, i] * mean_w
        determinant = c_uu * c_vv - c_uv * c_uv
        trace = c_uu + c_vv
        inverse = 1.0 / determinant
        a = (c_vv * c_uw - c_uv * c_vw) * inverse
        b = (c_uu * c_vw - c_uv * c_uw) * inverse
        solution[0, i] = a
        solution[1, i] = b
        solution[2, i] = (reference[2, i] + mean_w) - a * (reference[0, i] + mean_u) - b * (reference[1, i] + mean_v)
        left = c_ww - a * c_uw - b * c_vw
        left = left if left > 0.0 else 0.0
        rounding = 0.0
        if total is not None:  # a scatter that is nothing but rounding may even be negative
            rounding = MOMENT_ROUNDING * (total + moments[4, i] + moments[7, i])
            rounding *= max(trace, rounding)
        residual[i] = left if determinant > COLLINEAR * trace * trace + rounding else math.nan
        lost[i] = 0.0 if total is None else rounding * inverse


@kernel(inline=True)
def centre(moments, reference, count):
    """Move moments to the valid pixels' mean: about a point far away, rounding hides the steps to an eigenvalue."""
    for i in range(count):
        per_pixel = 1.0 / moments[0, i]
        s_u, s_v, s_w = moments[1, i], moments[2, i], moments[3, i]
        mean_u, mean_v, mean_w = s_u * per_pixel, s_v * per_pixel, s_w * per_pixel
        moments[4, i] -= s_u * mean_u
        moments[5, i] -= s_u * mean_v
        moments[6, i] -= s_u * mean_w
        moments[7, i] -= s_v * mean_v
        moments[8, i] -= s_v * mean_w
        moments[9, i] -= s_w * mean_w
        moments[1, i] = moments[2, i] = moments[3, i] = 0.0
        reference[0, i] += mean_u
        reference[1, i] += mean_v
        reference[2, i] += mean_w


@kernel(inline=True)
def range_planes(implicit, moments, reference, total, needed, count, work):
    """Solve q = α·m (eq. 12).

    Parameters
    ----------
    implicit : True or None
        Turn the explicit solutions into the implicit ones (eq. 14). With None Numba compiles none of this.
    moments, reference : (10, N) and (3, N) float64
        Overwritten if there are an ``implicit`` and a ``total``.
    total : float or None
        Σuu + Σvv of the frame, for moments that are differences of sums over it, as `explicit` takes it.
    needed : (N,) float64
        Number of valid pixels that a tile needs.
    work : (WORK, TILES) float64
        On return rows 0 to 2 are α. Rows 3 and 4 are the residual in the method's units and in metres along the normal,
        NaN where there is no plane. Row 5 is the distance below which a plane passes through the camera centre.
    """
    solution, error, metric, nearest, residual = work[:3], work[3], work[4], work[5], work[6]
    explicit(moments, reference, total, count, solution, residual, nearest)
    if implicit is not None:
        for i in range(count):
            error[i] = residual[i] if moments[0, i] >= needed[i] else math.nan
        if total is not None:
            centre(moments, reference, count)
        secular.smallest_eigenvectors(moments, reference, count, solution, error)
        for i in range(count):
            a, b, c = solution[0, i], solution[1, i], solution[2, i]
            residual[i] = error[i] * (1.0 + a * a + b * b + c * c)
            error[i] = math.sqrt(error[i] / moments[0, i])
    for i in range(count):
        per_pixel = 1.0 / moments[0, i]
        a, b, c = solution[0, i], solution[1, i], solution[2, i]
        mean_q = reference[2, i] + moments[3, i] * per_pixel
        mean_square_root = math.sqrt(residual[i] * per_pixel)
        if implicit is None:
            error[i] = mean_square_root
        # n·X + d = d·Z·(q - α·m): to first order, with one depth for the tile.
        metric[i] = mean_square_root / (math.sqrt(a * a + b * b + c * c) * mean_q)
        nearest[i] = 0.0 if implicit is None else CENTRE / mean_q


@kernel(inline=True)
def standard_planes(method, moments, reference, total, count, work):
    """Planes from the moments of (X, Y, Z), in the rows of ``work`` that `range_planes` names.

    ``method`` is `STANDARD_EXPLICIT`, `STANDARD_IMPLICIT` (eq. 3: smallest eigenvector of eq. 6, all four coefficients
    of norm 1, by eq. 4) or `STANDARD_PCA` (smallest eigenvector of the centred 3x3 scatter matrix). ``total`` is
    ΣXX + ΣYY + ΣZZ of the frame, for moments that are differences of sums over it.
    """
    solution, error, metric, nearest, value = work[:3], work[3], work[4], work[5], work[6]
    if method == STANDARD_EXPLICIT:
        explicit(moments, reference, total, count, solution, value, nearest)
        for i in range(count):
            per_pixel = 1.0 / moments[0, i]
            a, b = solution[0, i], solution[1, i]
            # aX + bY - Z + c = 0
            inverse = 1.0 / solution[2, i]
            solution[0, i] = -a * inverse
            solution[1, i] = -b * inverse
            solution[2, i] = inverse
            error[i] = math.sqrt(value[i] * per_pixel)
            metric[i] = error[i] / math.sqrt(1.0 + a * a + b * b)
            nearest[i] = (CENTRE + nearest[i]) * (reference[2, i] + moments[3, i] * per_pixel)
        return
    mean, matrix, determined = work[7:10], work[10:16], work[16]
    for i in range(count):
        per_pixel = 1.0 / moments[0, i]
        s_x, s_y, s_z = moments[1, i], moments[2, i], moments[3, i]
        c_xx = moments[4, i] - s_x * (s_x * per_pixel)
        c_xy = moments[5, i] - s_x * (s_y * per_pixel)
        c_xz = moments[6, i] - s_x * (s_z * per_pixel)
        c_yy = moments[7, i] - s_y * (s_y * per_pixel)
        c_yz = moments[8, i] - s_y * (s_z * per_pixel)
        c_zz = moments[9, i] - s_z * (s_z * per_pixel)
        matrix[0, i], matrix[1, i], matrix[2, i] = c_xx, c_xy, c_xz
        matrix[3, i], matrix[4, i], matrix[5, i] = c_yy, c_yz, c_zz
        mean[0, i] = reference[0, i] + s_x * per_pixel
        mean[1, i] = reference[1, i] + s_y * per_pixel
        mean[2, i] = reference[2, i] + s_z * per_pixel
        # At least λ₂λ₃, and at least λ₂ + λ₃: this bounds λ₂ against λ₃.
        minors = (c_yy * c_zz - c_yz * c_yz) + (c_xx * c_zz - c_xz * c_xz) + (c_xx * c_yy - c_xy * c_xy)
        trace = c_xx + c_yy + c_zz
        rounding = 0.0
        if total is not None:
            rounding = MOMENT_ROUNDING * (total + moments[4, i] + moments[7, i] + moments[9, i])
            rounding *= max(trace, rounding)  # as in `explicit`
        determined[i] = 0.0 if minors > COLLINEAR * trace * trace + rounding else math.nan
        nearest[i] = (CENTRE + (0.0 if total is None else rounding / minors)) * mean[2, i]
    if method == STANDARD_IMPLICIT:
        eigen4.smallest_eigenvectors(moments[0], mean, matrix, count, work[SOLVE_WORK:], value, solution)
        for i in range(count):
            x, y, z = solution[0, i], solution[1, i], solution[2, i]
            error[i] = math.sqrt(value[i] / moments[0, i])
            metric[i] = error[i] * math.sqrt(1.0 + 1.0 / (x * x + y * y + z * z)) + determined[i]
    else:
        eigen3.smallest_eigenpairs(matrix, count, work[SOLVE_WORK:], value, solution)
        for i in range(count):
            x, y, z = solution[0, i], solution[1, i], solution[2, i]
            inverse = 1.0 / (x * mean[0, i] + y * mean[1, i] + z * mean[2, i])
            solution[0, i] = x * inverse
            solution[1, i] = y * inverse
            solution[2, i] = z * inverse
            error[i] = math.sqrt(value[i] / moments[0, i])
            metric[i] = error[i] + determined[i]


@kernel(inline=True)
def write_planes(work, valid, needed, max_error, count, results):
    """From α and residuals to results: d = 1/‖α‖ and n = -α/‖α‖, facing the camera.

    Parameters
    ----------
    work : (WORK, TILES) float64
        From `range_planes` or `standard_planes`: α in rows 0 to 2, residuals in 3 and 4, and in 5 the distance below
        which a plane passes through the camera centre. Overwritten.
    valid, needed : (N,) float64
        Numbers of valid pixels; fewer than ``needed`` give TOO_FEW.
    max_error : float
        Tiles with a larger ``rmse_metric`` get ROUGH.
    results : planes, alpha, rmse, rmse_metric, valid_count, status; (4 * N,), (3 * N,), (N,)..., written
    """
    planes, alpha, rmse, rmse_metric, valid_count, status = results
    solution, error, metric, nearest, distance, reason = work[:3], work[3], work[4], work[5], work[6], work[7]
    for i in range(count):
        a, b, c = solution[0, i], solution[1, i], solution[2, i]
        d = 1.0 / math.sqrt(a * a + b * b + c * c)
        enough = valid[i] >= needed[i]
        fitted = enough & (d > nearest[i]) & (d > NEAREST) & (d < FARTHEST) & (metric[i] < math.inf)
        nothing = 0.0 if fitted else math.nan
        solution[0, i] = a + nothing
        solution[1, i] = b + nothing
        solution[2, i] = c + nothing
        distance[i] = d + nothing
        error[i] += nothing
        metric[i] += nothing
        rough = ROUGH if metric[i] > max_error else OK
        reason[i] = (rough if fitted else DEGENERATE) if enough else TOO_FEW
    for i in range(count):
        d = distance[i]
        planes[4 * i] = -solution[0, i] * d
        planes[4 * i + 1] = -solution[1, i] * d
        planes[4 * i + 2] = -solution[2, i] * d
        planes[4 * i + 3] = d
    for i in range(count):
        alpha[3 * i] = solution[0, i]
        alpha[3 * i + 1] = solution[1, i]
        alpha[3 * i + 2] = solution[2, i]
    for i in range(count):
        rmse[i] = error[i]
    for i in range(count):
        rmse_metric[i] = metric[i]
    for i in range(count):
        valid_count[i] = np.int32(valid[i])
    for i in range(count):
        status[i] = np.uint8(np.int32(reason[i]))


@kernel()
def fit_moments(implicit, standard, sums, total, needed, max_error, part, results):
    """Planes from given moments.

    Parameters
    ----------
    implicit : True or None
        For moments in range space, whether the solution is implicit.
    standard : int or None
        For moments in (X, Y, Z), the number of the method: `STANDARD_EXPLICIT` and so on. None for range space.
    sums : moments and reference, (10, T) and (3, T) float64
    total : float
        For moments that are differences of sums over the frame, Σuu + Σvv of the frame, in (X, Y, Z) with Σww; 0 for
        other moments about a point that may be far away.
    needed : (T,) float64
        Number of valid pixels that a tile needs.
    max_error : float
        Tiles with a larger ``rmse_metric`` get ROUGH.
    part : (start, stop)
        The tiles to fit.
    results : planes, alpha, rmse, rmse_metric, valid_count, status; (4 * T,), (3 * T,), (T,)..., written
    """
    moments, reference = sums
    start, stop = part
    planes, alpha, rmse, rmse_metric, valid_count, status = results
    block = np.empty((13 + WORK, TILES))
    block_moments, block_reference, work = block[:10], block[10:13], block[13:]
    for first in range(start, stop, TILES):
        last = min(first + TILES, stop)
        count = last - first
        copy_columns(moments, first, last, block_moments)
        copy_columns(reference, first, last, block_reference)
        if standard is None:
            range_planes(implicit, block_moments, block_reference, total, needed[first:last], count, work)
        else:
            standard_planes(standard, block_moments, block_reference, total, count, work)
        write_planes(
            work, block_moments[0], needed[first:last], max_error, count,
            (
                planes[4 * first : 4 * last], alpha[3 * first : 3 * last], rmse[first:last], rmse_metric[first:last],
                valid_count[first:last], status[first:last],
            ),
        )  # fmt: skip
