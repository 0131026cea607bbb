"""Least squares of the motion, and what errors of planes would feign: the sums of the kernels, in plain NumPy."""

import numpy as np
import pytest

from rgbd_planes.kernels.motion.match_tiles import COLUMNS
from rgbd_planes.kernels.motion.normal_equations import (
    SUMS,
    feigned_systems,
    normal_equations,
    spread_of_right,
    sum_crosses,
)

PLANES, GROUPS, TILES, MATCHES = 3, 9, 60, 200
SCALE, ROBUST, COMMON, WIDTH = 0.02, 2.5, 0.03, 0.05
UNSEEN = [1, 7]  # groups without a match: a plane and another


class Frame:
    """Matches of tiles at random, and the same by names."""

    def __init__(self, rng):
        groups = rng.choice(np.delete(np.arange(GROUPS), UNSEEN), TILES)
        tiles = np.column_stack([rng.uniform(-0.5, 0.5, (TILES, 2)), rng.normal(size=(TILES, 4))])
        tile = np.sort(rng.integers(0, TILES, MATCHES))
        self.derivatives, self.r = rng.normal(size=(MATCHES, 6)), rng.normal(size=MATCHES) * 3.0 * SCALE
        self.matches = np.column_stack([self.derivatives, self.r, tile])
        counts = np.bincount(groups, minlength=GROUPS)
        self.arrays = tiles, groups, counts, PLANES
        self.m = np.column_stack([tiles[tile, :2], np.ones(MATCHES)])
        self.group = groups[tile]
        off = 1.0 + (self.r / (ROBUST * SCALE)) ** 2
        self.w = off**-2 / (1.0 + COMMON * counts[self.group])

    def sums(self):
        """(G, SUMS), by the kernel that sums crosses."""
        sums, crosses = np.empty((GROUPS, SUMS)), np.empty((GROUPS, 6, 3))
        sum_crosses(self.matches, self.arrays, self.w, sums, crosses)
        return sums, crosses

    def by_group(self):
        """Of each group that has matches: its number, weights, rays, derivatives, and the mean of m·mᵀ."""
        for g in np.unique(self.group):
            here = self.group == g
            w, m = self.w[here], self.m[here]
            within = np.diag([1.0, 1.0, 0.0]) * WIDTH**2 / 12.0
            yield g, w, m, self.derivatives[here], (m.T * w) @ m / w.sum() + within


@pytest.fixture
def frame(rng):
    assert COLUMNS == 8
    return Frame(rng)


def test_sums_of_all_matches(frame):
    weights, sums = np.empty(MATCHES), np.empty((GROUPS, SUMS))
    systems, right = np.empty((2, 6, 6)), np.empty(6)
    normal_equations(frame.matches, frame.arrays, SCALE, (ROBUST, COMMON), weights, sums, systems, right)
    np.testing.assert_allclose(weights, frame.w)
    is_on_plane = frame.group < PLANES
    for system, some in zip(systems, (is_on_plane, ~is_on_plane), strict=True):
        np.testing.assert_allclose(system, (frame.derivatives[some].T * frame.w[some]) @ frame.derivatives[some])
    np.testing.assert_allclose(right, frame.derivatives.T @ (frame.w * frame.r))
    np.testing.assert_allclose(sums, frame.sums()[0])


def test_a_residual_of_the_limit_has_a_quarter_of_the_weight(frame):
    weights, sums = np.empty(2), np.empty((GROUPS, SUMS))
    matches = frame.matches[[0, 0]]
    matches[:, 6] = 0.0, ROBUST * SCALE
    normal_equations(matches, frame.arrays, SCALE, (ROBUST, 0.0), weights, sums, np.empty((2, 6, 6)), np.empty(6))
    np.testing.assert_allclose(weights, [1.0, 0.25])


def test_sums_of_groups(frame):
    sums, crosses = frame.sums()
    for g, w, m, derivatives, _ in frame.by_group():
        squares = (m.T * w) @ m
        np.testing.assert_allclose(sums[g], [w.sum(), w @ w, *squares[np.triu_indices(3)][:5]])
        np.testing.assert_allclose(crosses[g], (derivatives.T * w) @ m, atol=1e-14)
    assert not sums[UNSEEN].any()
    assert not crosses[UNSEEN].any()


def test_what_errors_of_planes_feign(frame):
    fitted, common, turned = 3e-4, 5e-5, 2e-5
    expected = np.zeros((2, 6, 6))
    for g, w, m, _, mean_square in frame.by_group():
        x, y, z = w @ m / w.sum()
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        # An error ε of α adds m × ε to the derivative by turns, and ε to that by steps.
        variance = fitted * (w @ w) / w.sum() ** 2 + common
        covariance = variance * np.linalg.inv(mean_square) + turned * np.eye(3)
        jacobian = np.vstack([cross, np.eye(3)])
        expected[int(g >= PLANES)] += w.sum() * jacobian @ covariance @ jacobian.T
    systems = np.empty((2, 6, 6))
    feigned_systems(frame.sums()[0], PLANES, (fitted, common, turned), WIDTH, systems)
    np.testing.assert_allclose(systems, expected, rtol=1e-9)


def test_covariance_of_the_right_hand_side(frame):
    single, shared = 4e-4, 3e-5
    expected = np.zeros((6, 6))
    for _, w, m, derivatives, mean_square in frame.by_group():
        # All of a group have one error ε·m, or each its own: then Σw²JJᵀ, of the slopes of derivatives along m.
        slopes = (derivatives.T * w) @ m / w.sum() @ np.linalg.inv(mean_square)
        expected += (single * (w @ w) + shared * w.sum() ** 2) * slopes @ mean_square @ slopes.T
    spread = np.empty((6, 6))
    spread_of_right(*frame.sums(), single, shared, WIDTH, spread)
    np.testing.assert_allclose(spread, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
