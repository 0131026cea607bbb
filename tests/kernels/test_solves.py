"""The closed-form solves against LAPACK, on any matrices."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rgbd_planes.kernels.solvers import eigen3, eigen4, secular

clouds = hnp.arrays(
    np.float64, st.tuples(st.integers(4, 40), st.just(3)), elements=st.floats(-1, 1, width=32), unique=True
)


def entries(matrix):
    return matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[1, 1], matrix[1, 2], matrix[2, 2]


def smallest_eigenpair(matrix):
    """Eigenvalue and eigenvector of a matrix."""
    value, vector = np.empty(1), np.empty((3, 1))
    room = np.empty((eigen3.WORK, 1))
    eigen3.smallest_eigenpairs(np.array(entries(matrix))[:, None], 1, room, value, vector)
    return value[0], *vector[:, 0]


def smallest_eigenvector_4x4(n, mean, matrix):
    """Eigenvalue of the matrix of (u, v, w, 1) and (x, y, z) of its eigenvector (x, y, z, -1)."""
    value, vector = np.empty(1), np.empty((3, 1))
    eigen4.smallest_eigenvectors(
        np.array([float(n)]), np.array(mean)[:, None], np.array(entries(matrix))[:, None], 1,
        np.empty((eigen4.WORK, 1)), value, vector,
    )  # fmt: skip
    return value[0], *vector[:, 0]


@settings(max_examples=300)
@given(clouds, st.floats(0, 1), st.floats(-8, 8))
def test_smallest_eigenpair_3x3(points, thickness, exponent):
    """Scatter matrices of clouds from flat to round, from tiny to huge."""
    points = (points - points.mean(axis=0)) * [1.0, 1.0, thickness] @ rotation(points) * 10.0**exponent
    matrix = points.T @ points
    value, *vector = smallest_eigenpair(matrix)
    values = np.linalg.eigvalsh(matrix)
    assert abs(value - values[0]) <= 1e-13 * values[2]
    vector = np.array(vector)
    if values[1] - values[0] > 1e-6 * values[2]:
        assert abs(np.linalg.norm(vector) - 1) < 1e-12
        assert np.linalg.norm(matrix @ vector - value * vector) <= 1e-12 * values[2] / (
            (values[1] - values[0]) / values[2]
        )


@pytest.mark.parametrize("width", [1.0, 0.1, 0.01, 0.001])
@pytest.mark.parametrize("thickness", [0.0, 1e-4, 0.3])
def test_normal_of_a_strip(width, thickness, rng):
    """Long thin tiles, as steep surfaces are: no more digits lost than the shape costs."""
    for _ in range(50):
        points = rng.standard_normal((40, 3)) * [1.0, width, thickness * width]
        points = points @ np.linalg.qr(rng.standard_normal((3, 3)))[0]
        points -= points.mean(axis=0)
        wanted = np.linalg.svd(points, full_matrices=False)[2][-1]
        vector = np.array(smallest_eigenpair(points.T @ points)[1:])
        assert np.linalg.norm(vector - wanted * np.sign(vector @ wanted)) < 3e-14 / width**2


@pytest.mark.parametrize("width", [1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5])
@pytest.mark.parametrize("thickness", [0.0, 0.3, 0.9])
def test_points_near_a_line(width, thickness, rng):
    """Two eigenvalues far below the third are told from each other as well as rounding of the matrix allows."""
    for _ in range(100):
        axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        matrix = (axes * (np.array([thickness * width, width, 1.0]) * rng.uniform(1e-3, 1e3))) @ axes.T
        matrix = 0.5 * (matrix + matrix.T)
        values, vectors = np.linalg.eigh(matrix)
        value, *vector = smallest_eigenpair(matrix)
        assert abs(value - values[0]) < 2e-15 * values[2]
        sine = np.linalg.norm(np.cross(vector, vectors[:, 0]))
        assert sine < 4e-15 * values[2] / (values[1] - values[0])


@pytest.mark.parametrize("width", [1.0, 1e-4])
def test_points_on_a_plane_leave_nothing_below_zero(width, rng):
    """The root of the eigenvalue is their residual, which must be a number."""
    for _ in range(100):
        axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        points = rng.standard_normal((8, 3)) * [1.0, width, 0.0] @ axes
        assert smallest_eigenpair(points.T @ points)[0] >= 0.0


@pytest.mark.parametrize("axis", range(3))
def test_points_all_round_a_line_have_a_vector_across_it(axis):
    diagonal = np.ones(3)
    diagonal[axis] = 9e8
    value, *vector = smallest_eigenpair(np.diag(diagonal))
    assert value == pytest.approx(1.0)
    assert vector[axis] == 0.0
    assert np.linalg.norm(vector) == pytest.approx(1.0)


@settings(max_examples=300)
@given(clouds, st.floats(1e-3, 1), st.floats(0.3, 30))
def test_smallest_eigenvector_4x4(points, thickness, distance):
    """Of (X, Y, Z, 1), for clouds at some distance: the residual of the eigenvector and its eigenvalue."""
    points = (points - points.mean(axis=0)) * [1.0, 1.0, thickness] @ rotation(points) + [0.1, 0.2, distance]
    mean = points.mean(axis=0)
    centred = points - mean
    scatter = centred.T @ centred
    gaps = np.linalg.eigvalsh(scatter)
    one = np.column_stack([points, np.ones(len(points))])
    value, *vector = smallest_eigenvector_4x4(len(points), mean, scatter)
    singular, vectors = np.linalg.svd(one, full_matrices=False)[1:]
    if gaps[1] - gaps[0] < 1e-6 * gaps[2] or singular[2] ** 2 - singular[3] ** 2 < 1e-9 * singular[2] ** 2:
        return
    if abs(vectors[-1, 3]) < 1e-6:
        return  # through the origin
    np.testing.assert_allclose(value, singular[3] ** 2, rtol=1e-7, atol=1e-13 * singular[0] ** 2)
    wanted = -vectors[-1, :3] / vectors[-1, 3]
    bound = 1e-13 * (singular[0] / (singular[2] - singular[3])) ** 2 + 1e-12
    np.testing.assert_allclose(vector, wanted, atol=bound * np.linalg.norm(wanted) / abs(vectors[-1, 3]))


def smallest_eigenvectors(tiles):
    """Eigenvalue and α of several tiles solved side by side."""
    moments, reference, solution, eigenvalue = (np.array(values, float).T.copy() for values in zip(*tiles, strict=True))
    secular.smallest_eigenvectors(moments, reference, len(tiles), solution, eigenvalue)
    return np.column_stack([eigenvalue, solution.T])


@settings(max_examples=300)
@given(st.integers(0, 2**32), st.floats(-12, 0), st.integers(2, 30))
def test_secular_solve_is_the_eigenvector(seed, magnitude, side):
    """Of (tanθx, tanθy, 1, q), given the explicit solution, in any part of the image and with noise of any size."""
    rng = np.random.default_rng(seed)
    x, y = (grid.ravel() / 525.0 + rng.uniform(-0.5, 0.5) for grid in np.mgrid[:side, :side])
    alpha = rng.uniform((-1, -1, 0.5), (1, 1, 2.5))
    q = np.column_stack([x, y, np.ones_like(x)]) @ alpha + 10.0**magnitude * rng.standard_normal(len(x))
    rays = np.column_stack([x, y, np.ones_like(x)])
    a0 = np.linalg.lstsq(rays, q)[0]
    rss = np.sum((q - rays @ a0) ** 2)
    u0, v0, q0 = x.mean(), y.mean(), q[0]
    u, v, w = x - u0, y - v0, q - q0
    moments = [len(x), u.sum(), v.sum(), w.sum(), u @ u, u @ v, u @ w, v @ v, v @ w, w @ w]
    value, *solution = smallest_eigenvectors([(moments, (u0, v0, q0), a0, rss)])[0]
    _, singular, vectors = np.linalg.svd(np.column_stack([rays, q]), full_matrices=False)
    found = np.append(solution, -1.0)
    found /= np.linalg.norm(found)
    gap = singular[2] ** 2 - singular[3] ** 2
    assert abs(found @ vectors[-1]) > 0.5
    assert np.linalg.norm(found - np.sign(found @ vectors[-1]) * vectors[-1]) < 1e-14 * singular[0] ** 2 / gap + 1e-12
    np.testing.assert_allclose(value, singular[3] ** 2, rtol=1e-8, atol=1e-14 * singular[0] ** 2)


def test_secular_solve_of_what_has_no_such_eigenvector():
    """Where 1/Z tells nothing of the direction that the rays tell least of, the plane contains the camera's centre."""
    u, v, w = np.array([[1, 1, -1, -1], [0.1, -0.1, 0.1, -0.1], [0.5, -0.5, -0.5, 0.5]])
    moments = [4, 0.0, 0.0, 0.0, u @ u, u @ v, u @ w, v @ v, v @ w, w @ w]
    value, *_ = smallest_eigenvectors([(moments, (0.0, 0.0, 1.0), [0.0, 0.0, 1.0], w @ w)])[0]
    assert np.isnan(value)


def test_no_matrix_no_vector():
    assert np.isnan(smallest_eigenpair(np.zeros((3, 3)))[1:]).all()


@pytest.mark.parametrize("others", [(5.0, 9.0), (5.0, 9e8)], ids=["a cloud", "nearly a line"])
@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_eigenpair_of_a_diagonal_matrix_is_its_smallest_entry(order, others):
    diagonal = np.array([1.0, *others])[list(order)]
    value, *vector = smallest_eigenpair(np.diag(diagonal))
    assert value == pytest.approx(1.0)
    np.testing.assert_allclose(np.abs(vector), diagonal == 1.0, atol=1e-14)


def rotation(points):
    """A rotation that depends on the points, so that nothing lines up with the axes."""
    return np.linalg.qr(np.random.default_rng(int(abs(points).sum() * 1e6)).standard_normal((3, 3)))[0]
