"""A plane, a sphere and a cylinder for each label, by maximum likelihood in inverse depth."""

import math

import numpy as np

from ..._jit.kernel import kernel
from .minimise import minimise
from .quadric import CYLINDER, KAPPA, PLANE, Q0, SPHERE, SURFACE, A, B, weigh
from .start import TERMS, central_ray, fit_quadratic, write_start

# Pixels that are enough to find the surface by: then few steps are left for all of them.
SAMPLE = 1500
# Steps with the sample, and with all pixels.
ROUNDS, LAST_ROUNDS = 40, 8
# A kind whose sum of squares in the sample is so many times the least, and by so much more, is out of the question.
TIMES, MORE = 1.3, 50.0


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
        total = minimise(pixels, weights, kind, 1e-3, ROUNDS, candidate)
        if total < best:
            best = total
            surface[:] = candidate
    return best


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
        See `quadric.weigh`: of the kind that fits a sample of the pixels best.
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
    found, curvatures = np.empty((3, SURFACE)), (0.0, 0.0)
    first = np.full(3, math.inf)
    first[PLANE] = minimise(sample, of_sample, PLANE, 0.0, ROUNDS, flat)
    found[PLANE] = flat
    curved = flat.copy()
    if fit_quadratic(sample, of_sample, curved, scale, 6, beta) and beta[0] > 0.0:
        curvatures = write_start(beta, curved)
        for kind in (SPHERE, CYLINDER):
            first[kind] = best_start(sample, of_sample, curved, kind, curvatures, found[kind])
    best = np.argmin(first)
    if not first[best] < math.inf:
        return
    weigh(us, vs, found[best], 0.0 if best == CYLINDER else 1.0, noise, weights, shares)
    for kind in range(3):
        if not first[kind] <= TIMES * first[best] + MORE:
            continue
        total = minimise(pixels, weights, kind, 0.0, LAST_ROUNDS, found[kind])
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
