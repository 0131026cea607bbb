"""A plane, a sphere and a cylinder for each label, by maximum likelihood in inverse depth."""

import math

import numpy as np

from .._jit.kernel import kernel
from ..common.quantiles import quantile
from .minimise import minimise
from .quadric import BLOCK, CYLINDER, KAPPA, PARAMETERS, PLANE, Q0, RESIDUAL, SPHERE, SURFACE, A, B, evaluate, weigh
from .start import TERMS, central_ray, fit_quadratic, write_start

# Pixels that are enough to find the surface by: then few steps are left for all of them.
SAMPLE = 1500
# Share of its sum of squares to which the sample's is the least.
ROUGHLY = 1e-4
# A kind whose sum of squares in the sample is so many times the least, and by so much more, is out of the question.
# Before outliers are left out, that is not yet plain.
TIMES, MORE, DOUBTFUL = 1.3, 50.0, 3.0
# Residuals of outliers, in standard deviations, or in those that the median shows if they are larger. At most so large
# a share are left out, in so many turns with the sample.
FAR, MOST_OUTLIERS, TRIMS = 4.0, 0.15, 3
NORMAL_MEDIAN = 0.6745  # of the size of a normal deviate


@kernel()
def best_start(pixels, weights, flat, kind, curvatures, surface):
    """Write the best surface of a kind from several starts with a sample of the pixels; returns its sum of squares."""
    best = math.inf
    larger, least = curvatures
    candidate = np.empty(SURFACE)
    for start in range(2):
        candidate[:] = flat
        if kind == SPHERE:
            candidate[KAPPA] = 0.5 * (larger + least) if start == 0 else 0.3 * (larger + least)
        else:
            candidate[KAPPA] = larger if start == 0 else least
            if start == 1:  # across the direction of least curvature
                for k in range(3):
                    candidate[A + k], candidate[B + k] = flat[B + k], -flat[A + k]
        total = minimise(pixels, weights, kind, 1e-3, ROUGHLY, candidate)
        if total < best:
            best = total
            surface[:] = candidate
    return best


@kernel()
def write_residuals(pixels, weights, surface, kind, residuals):
    """Write the residuals of pixels over their standard deviations."""
    us, vs, qs = pixels
    work = np.empty((PARAMETERS + 1, BLOCK))
    for begin in range(0, len(us), BLOCK):
        end = min(begin + BLOCK, len(us))
        evaluate(us, vs, qs, weights, begin, end, surface, 0.0 if kind == CYLINDER else 1.0, work)
        for i in range(begin, end):
            residuals[i] = work[RESIDUAL, i - begin]


@kernel()
def trim(pixels, full, surface, kind, weights):
    """Write the weights of pixels, 0 for outliers, unless these are too many; returns the sum of squares up to FAR.

    ``full`` (M,) are the weights of all. Pixels at a rim may see both sides, or something beside the surface. Where
    more than few lie off, it is the surface that does not fit.
    """
    residuals, sizes = np.empty(len(full)), np.empty(len(full))
    write_residuals(pixels, full, surface, kind, residuals)
    for i in range(len(full)):
        sizes[i] = abs(residuals[i])
    limit = FAR * max(quantile(sizes, 0.5) / NORMAL_MEDIAN, 1.0)
    total, outliers = 0.0, 0
    for i in range(len(full)):
        size = abs(residuals[i])
        is_off = not size <= limit
        outliers += is_off
        weights[i] = 0.0 if is_off else full[i]
        total += min(size * size, FAR * FAR)
    if outliers > MOST_OUTLIERS * len(full):
        weights[:] = full
    return total


@kernel()
def fit_sample(pixels, full, start, scale, found):
    """Fit the three kinds to a sample of the pixels, without outliers; returns which is best, and their costs.

    Parameters
    ----------
    pixels, full
        Of the sample; ``full`` are the weights of all.
    start : (SURFACE,) float64
        A plane.
    scale : float
        Of the pixels' rays.
    found : (3, SURFACE) float64, written

    Returns
    -------
    best : int
    costs : (3,) float64
        Sums of squared residuals over their variances, each at most that of an outlier; infinite where there is no
        such surface.
    """
    costs, beta = np.full(3, math.inf), np.zeros(TERMS)
    weights, curved = np.empty(len(full)), start.copy()
    bends = fit_quadratic(pixels, full, curved, scale, TERMS, beta) and beta[0] > 0.0
    curvatures = write_start(beta, curved) if bends else (0.0, 0.0)
    for kind in range(3 if bends else 1):
        found[kind] = start
        if kind == PLANE:
            total = minimise(pixels, full, kind, 0.0, ROUGHLY, found[kind])
        else:
            total = best_start(pixels, full, curved, kind, curvatures, found[kind])
        if total < math.inf:
            costs[kind] = trim(pixels, full, found[kind], kind, weights)
    least = costs.min()
    for kind in range(3):
        if costs[kind] < math.inf and costs[kind] <= DOUBTFUL * least + MORE:
            for _ in range(TRIMS):
                trim(pixels, full, found[kind], kind, weights)
                minimise(pixels, weights, kind, 1e-3, ROUGHLY, found[kind])
            costs[kind] = trim(pixels, full, found[kind], kind, weights)
    return np.argmin(costs), costs


@kernel()
def fit_label(pixels, noise, surfaces, totals, weights, shares):
    """Fit the three kinds to the pixels of a label.

    Parameters
    ----------
    pixels : us, vs, qs, (M,) float64 each
    noise : (8 or more,) float64
    surfaces : (3, SURFACE) float64, written
        By kind.
    totals : (3,) float64, written
        Sums of squared residuals over their variances; NaN where there is no such surface, or a sample of the pixels
        fits another far better.
    weights, shares : (M,) float64, written
        See `quadric.weigh`: of the kind that fits a sample of the pixels best. Weights are 0 for its outliers.
    """
    us, vs, qs = pixels
    surfaces[:] = math.nan
    totals[:] = math.nan
    stride = max(len(us) // SAMPLE, 1)
    sample = us[::stride].copy(), vs[::stride].copy(), qs[::stride].copy()
    flat, beta = np.zeros(SURFACE), np.zeros(TERMS)
    scale = central_ray(us, vs, flat)
    of_sample, of_shares = np.ones(len(sample[0])), np.empty(len(sample[0]))
    if not fit_quadratic(sample, of_sample, flat, scale, 3, beta) or not beta[0] > 0.0:
        return
    write_start(beta, flat)
    weigh(sample[0], sample[1], flat, 1.0, noise, of_sample, of_shares)
    found, full = np.empty((3, SURFACE)), np.empty(len(us))
    best, costs = fit_sample(sample, of_sample, flat, scale, found)
    if not costs[best] < math.inf:
        return
    weigh(us, vs, found[best], 0.0 if best == CYLINDER else 1.0, noise, full, shares)
    trim(pixels, full, found[best], best, weights)
    for kind in range(3):
        if not costs[kind] <= TIMES * costs[best] + MORE:
            continue
        total = minimise(pixels, weights, kind, 0.0, 0.0, found[kind])
        if total == total and found[kind, Q0] > 0.0:
            totals[kind] = total
            surfaces[kind] = found[kind]


@kernel()
def fit_labels(pixels, first, noise, surfaces, totals, weights, shares):
    """`fit_label` for each of K labels, whose pixels are ``first[k]`` to ``first[k + 1]``; at least six each, or none.

    Parameters
    ----------
    pixels : (3, M) float64
        tanθx, tanθy and q.
    first : (K + 1,) int64
    noise : (8 or more,) float64
    surfaces, totals : (K, 3, SURFACE) and (K, 3) float64, written
    weights, shares : (M,) float64, written
    """
    for k in range(len(first) - 1):
        begin, end = first[k], first[k + 1]
        if end - begin < TERMS:
            surfaces[k] = math.nan
            totals[k] = math.nan
            continue
        part = pixels[0, begin:end], pixels[1, begin:end], pixels[2, begin:end]
        fit_label(part, noise, surfaces[k], totals[k], weights[begin:end], shares[begin:end])
