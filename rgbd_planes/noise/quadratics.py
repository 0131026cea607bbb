"""What correlated noise does to a quadratic surface: as `noise.correlation` for planes, with three terms more.

On a full rectangle of pixels the terms 1, u, v, u², uv, v², made orthonormal in this order, are products of orthonormal
polynomials p₀, p₁, p₂ along x and along y. Errors whose correlation is a Gaussian of the distance have a covariance C
that is a sum of products of matrices along x and along y. So what C is of these terms, F = ΦᵀCΦ, and the traces of
the residuals' covariance come from one-dimensional sums.
"""

import functools

import numpy as np
from numpy.typing import NDArray

from rgbd_planes._core.arrays import Floats
from rgbd_planes.noise.correlation import Components

# Exponents of u and v of the six terms, in the order of the coefficients.
_TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
_COLUMNS = 2 + 36
_PER_OCTAVE = 9  # sides of smaller rectangles, where there would be too many


@functools.lru_cache(maxsize=256)
def quadratic_statistics(components: Components, height: int, width: int) -> Floats:
    """(height·width + 1, 38) float64: a row for each number of valid pixels of a tile of this size.

    Its columns are, in units of the variance of a pixel, the expected sum of squared residuals tr(PC), half its
    variance tr((PC)²), and F, row by row. The missing pixels may be missing in one piece, which leaves a rectangle of
    the tile's proportions, or here and there: the case with larger errors counts, for residuals and for F.

    Parameters
    ----------
    components : tuple of (variance, length)
        Parts of the error; length 0 is independent.
    height, width : int
    """
    return statistics_of_counts(components, height, width, np.arange(height * width + 1))


def statistics_of_counts(components: Components, height: int, width: int, counts: NDArray[np.integer]) -> Floats:
    """(N, 38) float64: the rows of `quadratic_statistics` for some numbers of valid pixels."""
    areas, curves = _smaller_rectangles(components, height, width)
    whole = height * width
    n = np.asarray(counts, np.float64)
    in_one_piece = np.empty((len(n), _COLUMNS))
    at = np.log(np.maximum(n, 1.0))
    for k in range(_COLUMNS):
        in_one_piece[:, k] = np.interp(at, np.log(areas), curves[:, k])
    in_one_piece[:, 0] *= n
    in_one_piece[:, 1] *= n
    full = curves[-1] * np.where(np.arange(_COLUMNS) < 2, whole, 1.0)
    # The part of single pixels, the diagonal of PCP, falls with their number, that of pairs with its square.
    freedoms = max(whole - 6.0, 1.0)
    share = np.maximum(n - 6.0, 0.0) / freedoms
    alone = full[0] / freedoms
    single = min(alone * full[0], full[1])
    here_and_there = np.empty_like(in_one_piece)
    here_and_there[:, 0] = share * full[0]
    here_and_there[:, 1] = share * single + share**2 * (full[1] - single)
    identity = np.eye(6).ravel()
    pairs = (n / whole)[:, None]
    here_and_there[:, 2:] = alone * identity + pairs * (full[2:] - alone * identity)
    rougher = here_and_there[:, 0] > in_one_piece[:, 0]
    bent = here_and_there[:, 2:] @ identity > in_one_piece[:, 2:] @ identity
    made = np.concatenate(
        [
            np.where(rougher[:, None], here_and_there[:, :2], in_one_piece[:, :2]),
            np.where(bent[:, None], here_and_there[:, 2:], in_one_piece[:, 2:]),
        ],
        axis=1,
    )
    made[n <= 6.0, :2] = 0.0
    made.flags.writeable = False
    return made


@functools.lru_cache(maxsize=256)
@np.errstate(under="ignore")  # of errors far apart
def _smaller_rectangles(components: Components, height: int, width: int) -> tuple[Floats, Floats]:
    """Areas of rectangles of these proportions, up to this one, and (S, 38) their statistics per pixel."""
    short, long = min(height, width), max(height, width)
    most = max(short, 3)
    if most <= 4 * _PER_OCTAVE:
        sides = np.arange(3, most + 1)
    else:
        octaves = np.log2(most / 3.0)
        steps = np.arange(np.ceil(_PER_OCTAVE * octaves)) / _PER_OCTAVE
        sides = np.unique(np.append(np.round(3.0 * 2.0**steps), most).astype(int))
    areas, rows = [], []
    for side in sides.tolist():
        other = max(round(side * long / max(short, 1)), 3) if side < most else max(long, 3)
        m, n = (side, other) if height <= width else (other, side)
        areas.append(m * n)
        rows.append(_rectangle(components, m, n))
    return np.array(areas, np.float64), np.array(rows)


def _rectangle(components: Components, height: int, width: int) -> Floats:
    """(38,): the statistics of a full rectangle, the first two per pixel."""
    w = np.array([share for share, _ in components])
    shape_y, product_y, lags_y = _along(components, height)
    shape_x, product_x, lags_x = _along(components, width)
    first, second = np.array(_TERMS).T
    shared = np.einsum(
        "c,cjk,cjk->jk", w, shape_x[:, first[:, None], first], shape_y[:, second[:, None], second], optimize=True
    )
    pixels = height * width
    squares = w @ (lags_x * lags_y) @ w
    explained = np.einsum("a,b,abj,abj->", w, w, product_x[:, :, first], product_y[:, :, second], optimize=True)
    expected = pixels * w.sum() - np.trace(shared)
    half = squares - 2.0 * explained + (shared**2).sum()
    return np.concatenate([[expected / pixels, half / pixels], shared.ravel()])


@functools.lru_cache(maxsize=512)
def _along(components: Components, n: int) -> tuple[Floats, Floats, Floats]:
    """Of the Toeplitz matrices T of exp(-h²/(2·length²)) along a side of n pixels, one for each component.

    (C, 3, 3) pᵢᵀTpₖ; (C, C, 3) pᵢᵀT'Tpᵢ; (C, C) tr(T'T), with the orthonormal polynomials p₀, p₁, p₂.
    """
    lags = np.arange(n)
    terms = _orthonormal(n)
    by_lag = np.array(
        [np.exp(-0.5 * (lags / length) ** 2) if length else (lags == 0).astype(float) for _, length in components]
    )
    rows = [np.concatenate([rho[:0:-1], rho]) for rho in by_lag]
    applied = np.array([[np.convolve(row, p, "valid") for p in terms] for row in rows])
    often = np.where(lags == 0, n, 2 * (n - lags))
    return (
        np.einsum("cin,kn->cik", applied, terms),
        np.einsum("ain,bin->abi", applied, applied),
        (by_lag * often) @ by_lag.T,
    )


def _orthonormal(n: int) -> NDArray[np.float64]:
    """(3, n): orthonormal polynomials of degree 0, 1 and 2 over n pixels, their highest coefficients positive."""
    x = np.arange(n) - 0.5 * (n - 1)
    terms = np.stack([np.ones(n), x, x * x - (n * n - 1) / 12.0])
    return np.asarray(terms / np.linalg.norm(terms, axis=1, keepdims=True))
