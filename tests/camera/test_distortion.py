"""Lens distortion against its definition, finite differences, OpenCV, and itself backwards."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rgbd_planes.camera.lenses import fisheye
from rgbd_planes.camera.lenses.brown_conrady import (
    TOLERANCE,
    distort,
    distortion_jacobian,
    fold_radius,
    undistort,
    unfolded,
)

KINECT = (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
AZURE = (0.5479397, -0.0209714, 2.0557e-05, -7.2104e-05, -0.0026522, 0.889679, 0.0861302, -0.0139104)
BARREL = (-0.28, 0.07, 0.0002, 0.00002)
LENSES = [(), BARREL, KINECT, AZURE]

small = st.floats(-0.1, 0.1)
lenses = st.one_of(
    st.tuples(small, small, st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), small),
    st.tuples(small, small, st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), small, small, small, small),
)


def grid(reach=0.6, n=41):
    return tuple(np.meshgrid(np.linspace(-reach, reach, n), np.linspace(-reach, reach, n)))


def test_distort_by_hand():
    # r² = 0.25; f = (1 + 0.2 * 0.25) / (1 + 0.1 * 0.25)
    f = 1.05 / 1.025
    x, y = distort(np.array([0.3]), np.array([0.4]), (0.2, 0, 0.01, 0.02, 0, 0.1, 0, 0))
    assert x[0] == pytest.approx(0.3 * f + 2 * 0.01 * 0.12 + 0.02 * (0.25 + 2 * 0.09), abs=1e-15)
    assert y[0] == pytest.approx(0.4 * f + 0.01 * (0.25 + 2 * 0.16) + 2 * 0.02 * 0.12, abs=1e-15)


@pytest.mark.parametrize("lens", LENSES)
def test_jacobian_is_the_derivative(lens):
    x, y = grid()
    h = 1e-6
    along_x = [(p - m) / (2 * h) for p, m in zip(distort(x + h, y, lens), distort(x - h, y, lens), strict=True)]
    along_y = [(p - m) / (2 * h) for p, m in zip(distort(x, y + h, lens), distort(x, y - h, lens), strict=True)]
    expected = along_x[0], along_y[0], along_x[1], along_y[1]
    np.testing.assert_allclose(distortion_jacobian(x, y, lens), expected, atol=1e-8)


@given(lens=lenses)
@settings(max_examples=50)
def test_undistort_inverts_distort(lens):
    x, y = grid()
    assert unfolded(x, y, lens).all()  # coefficients this small cannot fold here
    back_x, back_y, found = undistort(*distort(x, y, lens), lens)
    assert found.all()
    assert np.hypot(back_x - x, back_y - y).max() < TOLERANCE


@given(lens=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-1, 1)))
@example(lens=(-0.792, 3.7834, -0.4998, -0.6386, -0.9645))  # plain Newton steps miss 1 in 30 of these
@example(lens=(0.0208, -0.2956, 0.104, 0.1561, 0.1873, -0.4778, 0.4272, -0.2928))
@example(lens=(-0.4435, -0.9285, 0.0697, 0.0944, 0.9825))  # 2 points, and 35, are not found from the radial part
@example(lens=(-0.0403, 0.7833, -0.0511, 0.0794, 0.082, 0.1912, 0.9152, 0.4468))
@settings(max_examples=30)
def test_strong_lenses_as_far_as_they_do_not_fold(lens):
    x, y = grid(1.5, 51)
    a, b, c, d = distortion_jacobian(x, y, lens)
    clear = unfolded(1.02 * x, 1.02 * y, lens) & (a * d - b * c > 0.01)
    x, y = x[clear], y[clear]
    back_x, back_y, found = undistort(*distort(x, y, lens), lens)
    assert found.all()
    assert np.hypot(back_x - x, back_y - y).max(initial=0.0) < TOLERANCE


@pytest.mark.parametrize("lens", LENSES)
def test_real_lenses_to_the_tolerance(lens):
    x, y = grid(0.5)
    back_x, back_y, found = undistort(*distort(x, y, lens), lens)
    assert found.all()
    assert np.hypot(back_x - x, back_y - y).max() < TOLERANCE


@pytest.mark.parametrize("lens", LENSES)
def test_against_opencv(lens):
    cv2 = pytest.importorskip("cv2")
    x, y = grid(0.5)
    points = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    zero = np.zeros(3)
    coefficients = np.array(lens if lens else [0.0] * 4)
    expected = cv2.projectPoints(points, zero, zero, np.eye(3), coefficients)[0].reshape(*x.shape, 2)
    np.testing.assert_allclose(np.stack(distort(x, y, lens), -1), expected, atol=1e-14)
    options = {"cameraMatrix": np.eye(3), "distCoeffs": coefficients, "R": np.eye(3), "P": np.eye(3)}
    options["criteria"] = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, 1e-14)
    undistort_points = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 4 and 5
    ideal = undistort_points(expected.reshape(-1, 1, 2), **options).reshape(*x.shape, 2)
    back_x, back_y, _ = undistort(expected[..., 0], expected[..., 1], lens)
    np.testing.assert_allclose(np.stack([back_x, back_y], -1), ideal, atol=1e-9)


def test_fold_radius_of_a_cubic():
    # r - 0.3 r³ stops growing where 1 = 0.9 r²
    assert fold_radius((-0.3, 0, 0, 0)) == pytest.approx(1 / np.sqrt(0.9), rel=1e-12)
    assert fold_radius(()) == np.inf
    assert fold_radius((0.3, 0, 0, 0)) == np.inf
    # A pole of the rational factor counts: 1 - r² = 0
    assert fold_radius((0, 0, 0, 0, 0, -1.0, 0, 0)) == pytest.approx(1.0, rel=1e-12)


def test_beyond_the_fold_there_is_no_ray():
    lens = (-0.3, 0, 0, 0)
    top = 1 / np.sqrt(0.9)
    highest = top - 0.3 * top**3
    x = np.array([0.0, 0.5 * highest, 0.999 * highest, 1.001 * highest, 2 * highest])
    back, _, found = undistort(x, np.zeros_like(x), lens)
    assert found.tolist() == [True, True, True, False, False]
    assert np.isnan(back[3:]).all()
    assert (back[:3] < top).all()  # the near one of the radii that share a place
    np.testing.assert_allclose(back[:3] - 0.3 * back[:3] ** 3, x[:3], atol=TOLERANCE)


def test_unfolded_looks_at_the_way_not_only_at_the_end():
    # r f = r - 2 r³ + 1.2 r⁵ falls between r = 0.47 and 0.89 and grows again after
    lens = (-2.0, 1.2, 0, 0)
    x = np.array([0.2, 0.6, 1.5])
    a, b, c, d = distortion_jacobian(x, np.zeros(3), lens)
    assert (a * d - b * c > 0).tolist()[2]
    assert unfolded(x, np.zeros(3), lens).tolist() == [True, False, False]


@pytest.mark.parametrize("powers", [(-4.0, 0, 0), (0, -16.0, 0), (0, 0, -64.0)])
def test_beyond_a_pole_is_beyond_a_fold_whichever_way_one_goes(powers):
    """That of 1 / (1 - 4 r²), of 1 / (1 - 16 r⁴), or of 1 / (1 - 64 r⁶), all at r = 0.5.

    Also where the numerator has the same zero, as it nearly has with many calibrations.
    """
    k1, k2, k3 = powers
    for turn in np.linspace(0.0, 2.0 * np.pi, 16):
        r = np.array([0.45, 0.6])
        for numerator in ((0, 0, 0, 0, 0), (k1, k2, 0, 0, k3)):
            found = unfolded(r * np.cos(turn), r * np.sin(turn), (*numerator, *powers))
            assert found.tolist() == [True, False]


def test_nothing_in_nothing_out():
    x, y, found = undistort(np.empty((0, 3)), np.empty((0, 3)), KINECT)
    assert x.shape == y.shape == found.shape == (0, 3)


FISHEYES = [
    (0.0, 0.0, 0.0, 0.0),
    (-0.0023, 0.0372, -0.0365, 0.0069),  # no fold
    (0.1, -0.2, 0.05, -0.01),  # folds at 66 degrees
]
fisheyes = st.tuples(*[st.floats(-0.2, 0.2)] * 4)


def angles_and_directions(lens, count=501):
    """As far as the image grows by a hundredth of the angle."""
    angle = np.linspace(0.0, fisheye.widest_angle(lens), count)[:-1]
    a, b, c, d = lens
    s = angle**2
    angle = angle[1 + s * (3 * a + s * (5 * b + s * (7 * c + s * 9 * d))) > 0.01]
    direction = 0.1 * np.arange(len(angle))
    return angle, np.cos(direction), np.sin(direction)


def test_fisheye_by_hand():
    # A ray at 45 degrees, at 3:4 in the image: θ = π / 4, and r' = θ + k1 θ³
    lens = (0.1, 0.0, 0.0, 0.0)
    x, y = fisheye.distort(np.array([0.6, 0.0]), np.array([0.8, 0.0]), lens)
    radius = np.pi / 4 + 0.1 * (np.pi / 4) ** 3
    np.testing.assert_allclose((x, y), ([0.6 * radius, 0.0], [0.8 * radius, 0.0]), atol=1e-15)


@given(lens=fisheyes)
@example(lens=FISHEYES[0])
@example(lens=FISHEYES[1])
@settings(max_examples=100)
def test_fisheye_undistort_inverts_distort(lens):
    angle, east, south = angles_and_directions(lens)
    x, y = np.tan(angle) * east, np.tan(angle) * south
    back_x, back_y, found = fisheye.undistort(*fisheye.distort(x, y, lens), lens)
    assert found.all()
    np.testing.assert_allclose(np.arctan(np.hypot(back_x, back_y)), angle, atol=1e-12)
    assert (np.abs(back_x * south - back_y * east) <= 1e-12 * (1.0 + np.tan(angle))).all()


@pytest.mark.parametrize("lens", FISHEYES)
def test_fisheye_against_opencv(lens):
    cv2 = pytest.importorskip("cv2")
    angle, east, south = angles_and_directions(lens)
    rays = np.stack([np.tan(angle) * east, np.tan(angle) * south], -1)
    expected = cv2.fisheye.distortPoints(rays[None], np.eye(3), np.array(lens))[0]
    np.testing.assert_allclose(np.stack(fisheye.distort(*rays.T, lens), -1), expected, atol=1e-14)


def test_beyond_what_a_fisheye_sees_there_is_no_ray():
    # θ - θ³ / 3 grows up to an angle of 1; of the equidistant lens 85 degrees count.
    limit = np.radians(85)
    for lens, widest, farthest in (((-1 / 3, 0, 0, 0), 1.0, 2 / 3), ((0,) * 4, limit, limit)):
        assert fisheye.widest_angle(lens) == pytest.approx(widest, rel=1e-12)
        _, _, found = fisheye.undistort(farthest * np.array([0.0, 0.999, 1.001, 9.0]), np.zeros(4), lens)
        assert found.tolist() == [True, True, False, False]
    x, _ = fisheye.distort(np.tan([0.0, 0.99, 1.01]), np.zeros(3), (-1 / 3, 0, 0, 0))
    assert np.isfinite(x).tolist() == [True, True, False]
    x, y, found = fisheye.undistort(np.empty((0, 3)), np.empty((0, 3)), FISHEYES[0])
    assert x.shape == y.shape == found.shape == (0, 3)
