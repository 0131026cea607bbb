"""From moments to quadratics in inverse depth, for a block of tiles at a time.

The normal equations A·β = b have a matrix of the 15 sums of uⁱvʲ, i + j <= 4. Its rows and columns are divided by the
roots of its diagonal, and LLᵀ of what is left is worked out (Cholesky). A pivot is then the share of a term's square
that the terms before it do not explain: it vanishes where the pixels lie on a conic.
"""

import math

import numpy as np

from .._jit.kernel import kernel
from ..moments.surface_tiles import (
    QQ,
    QU,
    QUU,
    QUV,
    QV,
    QVV,
    UU,
    UUU,
    UUUU,
    UUUV,
    UUV,
    UUVV,
    UV,
    UVV,
    UVVV,
    VV,
    VVV,
    VVVV,
    N,
    Q,
    U,
    V,
)
from .methods import CENTRE, DEGENERATE, OK, ROUGH, TOO_FEW

# Pixels count as lying on a conic where a pivot is below this.
CONIC = 1e-9

# Rows of work: β, the residual in 1/m and in metres, whether there is a surface, and the reason; then the matrix.
RESIDUAL, METRIC, REASON, FACTOR = 6, 7, 8, 9
QUADRATIC_WORK = 9 + 6 + 15 + 6


@kernel(inline=True)
def solve_quadratics(moments, reference, count, work):
    """Least squares of q on (1, u, v, u², uv, v²).

    Parameters
    ----------
    moments : (SURFACE_SUMS, TILES) float64
        Of q relative to ``reference``.
    reference : (TILES,) float64
    count : int
        Tiles of the block.
    work : (QUADRATIC_WORK, TILES) float64
        On return its first rows are β, and RESIDUAL the sum of squared residuals, NaN where pixels lie on a conic.
    """
    # The roots' inverses, L below its diagonal row by row, and the right-hand side; each in a loop that is short
    # enough for the compiler to keep all that it works on in registers.
    r, low, y = work[FACTOR : FACTOR + 6], work[FACTOR + 6 : FACTOR + 21], work[FACTOR + 21 : FACTOR + 27]
    for i in range(count):
        r[0, i] = 1.0 / math.sqrt(moments[N, i])
        r[1, i] = 1.0 / math.sqrt(moments[UU, i])
        r[2, i] = 1.0 / math.sqrt(moments[VV, i])
        r[3, i] = 1.0 / math.sqrt(moments[UUUU, i])
        r[4, i] = 1.0 / math.sqrt(moments[UUVV, i])
        r[5, i] = 1.0 / math.sqrt(moments[VVVV, i])
    for i in range(count):
        r0, r1, r2 = r[0, i], r[1, i], r[2, i]
        l10 = moments[U, i] * r0 * r1
        l20 = moments[V, i] * r0 * r2
        p1 = 1.0 - l10 * l10
        d1 = 1.0 / math.sqrt(p1)
        l21 = (moments[UV, i] * r1 * r2 - l20 * l10) * d1
        p2 = 1.0 - l20 * l20 - l21 * l21
        d2 = 1.0 / math.sqrt(p2)
        y0 = moments[Q, i] * r0
        y1 = (moments[QU, i] * r1 - l10 * y0) * d1
        y2 = (moments[QV, i] * r2 - l20 * y0 - l21 * y1) * d2
        nothing = 0.0 if (p1 > CONIC) & (p2 > CONIC) else math.nan
        low[0, i], low[1, i], low[2, i] = l10, l20, l21
        y[0, i], y[1, i], y[2, i] = y0, y1, y2
        work[0, i], work[1, i], work[2, i] = nothing, d1, d2
    for i in range(count):
        l10, l20, l21, d1, d2 = low[0, i], low[1, i], low[2, i], work[1, i], work[2, i]
        r0, r1, r2, r3 = r[0, i], r[1, i], r[2, i], r[3, i]
        l30 = moments[UU, i] * r0 * r3
        l31 = (moments[UUU, i] * r1 * r3 - l30 * l10) * d1
        l32 = (moments[UUV, i] * r2 * r3 - l30 * l20 - l31 * l21) * d2
        p3 = 1.0 - l30 * l30 - l31 * l31 - l32 * l32
        d3 = 1.0 / math.sqrt(p3)
        low[3, i], low[4, i], low[5, i] = l30, l31, l32
        y[3, i] = (moments[QUU, i] * r3 - l30 * y[0, i] - l31 * y[1, i] - l32 * y[2, i]) * d3
        work[0, i] += 0.0 if p3 > CONIC else math.nan
        work[3, i] = d3
    for i in range(count):
        l10, l20, l21, d1, d2, d3 = low[0, i], low[1, i], low[2, i], work[1, i], work[2, i], work[3, i]
        r0, r1, r2, r3, r4 = r[0, i], r[1, i], r[2, i], r[3, i], r[4, i]
        l40 = moments[UV, i] * r0 * r4
        l41 = (moments[UUV, i] * r1 * r4 - l40 * l10) * d1
        l42 = (moments[UVV, i] * r2 * r4 - l40 * l20 - l41 * l21) * d2
        l43 = (moments[UUUV, i] * r3 * r4 - l40 * low[3, i] - l41 * low[4, i] - l42 * low[5, i]) * d3
        p4 = 1.0 - l40 * l40 - l41 * l41 - l42 * l42 - l43 * l43
        d4 = 1.0 / math.sqrt(p4)
        low[6, i], low[7, i], low[8, i], low[9, i] = l40, l41, l42, l43
        y[4, i] = (moments[QUV, i] * r4 - l40 * y[0, i] - l41 * y[1, i] - l42 * y[2, i] - l43 * y[3, i]) * d4
        work[0, i] += 0.0 if p4 > CONIC else math.nan
        work[4, i] = d4
    for i in range(count):
        l10, l20, l21, d1, d2, d3, d4 = low[0, i], low[1, i], low[2, i], work[1, i], work[2, i], work[3, i], work[4, i]
        r0, r1, r2, r3, r4, r5 = r[0, i], r[1, i], r[2, i], r[3, i], r[4, i], r[5, i]
        l50 = moments[VV, i] * r0 * r5
        l51 = (moments[UVV, i] * r1 * r5 - l50 * l10) * d1
        l52 = (moments[VVV, i] * r2 * r5 - l50 * l20 - l51 * l21) * d2
        l53 = (moments[UUVV, i] * r3 * r5 - l50 * low[3, i] - l51 * low[4, i] - l52 * low[5, i]) * d3
        l54 = moments[UVVV, i] * r4 * r5 - l50 * low[6, i] - l51 * low[7, i] - l52 * low[8, i] - l53 * low[9, i]
        l54 *= d4
        p5 = 1.0 - l50 * l50 - l51 * l51 - l52 * l52 - l53 * l53 - l54 * l54
        d5 = 1.0 / math.sqrt(p5)
        y5 = moments[QVV, i] * r5 - l50 * y[0, i] - l51 * y[1, i] - l52 * y[2, i] - l53 * y[3, i] - l54 * y[4, i]
        low[10, i], low[11, i], low[12, i], low[13, i], low[14, i] = l50, l51, l52, l53, l54
        y[5, i] = y5 * d5
        work[0, i] += 0.0 if p5 > CONIC else math.nan
        work[5, i] = d5
    for i in range(count):
        y0, y1, y2, y3, y4, y5 = y[0, i], y[1, i], y[2, i], y[3, i], y[4, i], y[5, i]
        left = moments[QQ, i] - y0 * y0 - y1 * y1 - y2 * y2 - y3 * y3 - y4 * y4 - y5 * y5
        nothing = work[0, i]
        work[RESIDUAL, i] = max(left, 0.0) + nothing
        b5 = y5 * work[5, i]
        b4 = (y4 - low[14, i] * b5) * work[4, i]
        b3 = (y3 - low[9, i] * b4 - low[13, i] * b5) * work[3, i]
        b2 = (y2 - low[5, i] * b3 - low[8, i] * b4 - low[12, i] * b5) * work[2, i]
        b1 = (y1 - low[2, i] * b2 - low[4, i] * b3 - low[7, i] * b4 - low[11, i] * b5) * work[1, i]
        b0 = y0 - low[0, i] * b1 - low[1, i] * b2 - low[3, i] * b3 - low[6, i] * b4 - low[10, i] * b5
        work[0, i] = b0 * r[0, i] + reference[i] + nothing
        work[1, i] = b1 * r[1, i]
        work[2, i] = b2 * r[2, i]
        work[3, i] = b3 * r[3, i]
        work[4, i] = b4 * r[4, i]
        work[5, i] = b5 * r[5, i]


@kernel(inline=True)
def write_surfaces(work, moments, reference, centre, needed, max_error, count, results):
    """From coefficients and residuals to results.

    Parameters
    ----------
    work : (QUADRATIC_WORK, TILES) float64
        Coefficients and residuals in the rows that `solve_quadratics` writes. Overwritten.
    moments, reference : (SURFACE_SUMS, N) and (N,) float64
        Sums, and the inverse depths that the sums of q are relative to.
    centre : (2, N) float64
        The central rays.
    needed : (N,) float64
        Numbers of valid pixels; fewer give TOO_FEW.
    max_error : float
        Tiles with a larger ``rmse_metric`` get ROUGH.
    results : coefficients, rmse, rmse_metric, valid_count, status; (6 * N,), (N,)..., written
    """
    centre_u, centre_v = centre[0], centre[1]
    coefficients, rmse, rmse_metric, valid_count, status = results
    for i in range(count):
        n = moments[N, i]
        per_pixel = 1.0 / n
        q, a, b = work[0, i], work[1, i], work[2, i]
        c = q - a * centre_u[i] - b * centre_v[i]
        mean_q = reference[i] + moments[Q, i] * per_pixel
        error = math.sqrt(work[RESIDUAL, i] * per_pixel)
        d = 1.0 / math.sqrt(a * a + b * b + c * c)
        enough = n >= needed[i]
        # A surface through the camera's centre, or behind it, at the central ray.
        fitted = enough & (q > 0.0) & (d * mean_q > CENTRE) & (error == error)
        nothing = 0.0 if fitted else math.nan
        metric = error * d / mean_q + nothing
        rough = ROUGH if metric > max_error else OK
        work[RESIDUAL, i] = error + nothing
        work[METRIC, i] = metric
        work[REASON, i] = (rough if fitted else DEGENERATE) if enough else TOO_FEW
        for k in range(6):
            work[k, i] += nothing
    for i in range(count):
        for k in range(6):
            coefficients[6 * i + k] = work[k, i]
    for i in range(count):
        rmse[i] = work[RESIDUAL, i]
    for i in range(count):
        rmse_metric[i] = work[METRIC, i]
    for i in range(count):
        valid_count[i] = np.int32(moments[N, i])
    for i in range(count):
        status[i] = np.uint8(np.int32(work[REASON, i]))
