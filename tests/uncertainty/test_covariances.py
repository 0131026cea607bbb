"""Every covariance is one: no direction has a negative variance, wherever the pixels lie and whatever the noise is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import rgbd_planes as rp
from rgbd_planes import uncertainty
from rgbd_planes.fitting.methods import METHODS

# Of noise that is large for its depth, and of depths of kilometres.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

HEIGHT, WIDTH, TILE = 40, 56, 8
ROUNDING = 1e-14  # times what a covariance is made from
NOISES = (
    rp.noise.kinect_v1(),
    rp.noise.time_of_flight(0.002, 0.001),
    rp.noise.NoiseModel((1e-3,), lateral=0.5, spread=0.2, falloff=2.0),
    rp.noise.NoiseModel((1e-4,), step=1e-3),
    rp.noise.NoiseModel((1e-3,), correlation=((0.4, 2.0), (0.2, 6.0)), floor=0.5),
)
LENSES = (), (0.05, 0.0, 1e-3, -1e-3, 0.0)
SEEDS = st.integers(0, 2**32 - 1)


def shapes():
    """Pixels that are measured: all, a thin strip, a few, or most."""
    row, column = np.indices((HEIGHT, WIDTH))
    slopes, widths, shares = st.floats(-2.0, 2.0), st.sampled_from([0.6, 1.5, 4.0]), st.sampled_from([0.01, 0.1, 0.9])
    strips = st.builds(lambda slope, width: np.abs(row - 20 - slope * (column - 28)) < width, slopes, widths)
    some = st.builds(lambda seed, share: np.random.default_rng(seed).random(row.shape) < share, SEEDS, shares)
    return st.one_of(st.just(row >= 0), strips, some)


@st.composite
def frames(draw):
    """Depth of a plane, or of two that meet, from 0.3 m to 10 km, and its camera, which may look aside."""
    noise, lens, aside = (draw(st.sampled_from(of)) for of in (NOISES, LENSES, (0.0, 100.0)))
    camera = rp.Camera(WIDTH, HEIGHT, 60.0, 55.0, 27.5 + aside, 19.5, lens, noise=noise)
    nearest = 10.0 ** -draw(st.floats(-0.5, 4.0))  # 1/m
    slope_x, slope_y, other = (draw(st.floats(-1.0, 1.0)) for _ in range(3))
    q = 1.0 + slope_x * camera.tan_x + slope_y * camera.tan_y
    if draw(st.booleans()):
        q = np.maximum(q, 0.9 + other * camera.tan_x)
    error = draw(st.sampled_from([0.0, 1e-3, 0.1]))
    q = nearest * (q + error * np.random.default_rng(draw(SEEDS)).standard_normal(q.shape))
    seen = draw(shapes()) & (q > 0.0)
    return np.where(seen, 1.0 / np.where(seen, q, 1.0), 0.0), camera


def check_planes(covariance, length, total):
    """Covariances of (n, d), with d in units of a length, against the trace of what they are made from."""
    assert np.isfinite(covariance).all()
    assert (np.diagonal(covariance, axis1=1, axis2=2) >= 0.0).all()
    scale = np.ones((len(length), 4))
    scale[:, 3] = 1.0 / length
    smallest = np.linalg.eigvalsh(covariance * scale[:, :, None] * scale[:, None, :])[:, 0]
    assert (smallest >= -ROUNDING * total).all()


def check(found, known):
    """Those of α and of (n, d), and what is made of them; NaN where there is no plane."""
    for of in (found.alpha_covariance, found.plane_covariance, found.angle_std, found.offset_std):
        assert np.isnan(of[~known]).all()
    planes, of_alpha, covariance = (of[known] for of in (found.planes, found.alpha_covariance, found.plane_covariance))
    assert np.isfinite(of_alpha).all()
    total = np.trace(of_alpha, axis1=1, axis2=2)
    assert (np.diagonal(of_alpha, axis1=1, axis2=2) >= 0.0).all()
    assert (np.linalg.eigvalsh(of_alpha)[:, 0] >= -ROUNDING * total).all()
    check_planes(covariance, planes[:, 3], planes[:, 3] ** 2 * total)
    for std in (found.angle_std, found.offset_std):
        assert (std[known] >= 0.0).all()
    return planes, covariance, planes[:, 3] ** 2 * total


def check_what_follows(planes, covariance, total, seed):
    """In another frame; distances of points, and angles."""
    rng = np.random.default_rng(seed)
    motion, motion_covariance = np.eye(4), np.diag(rng.uniform(0.0, 1e-4, 6))
    motion[:3, :3], motion[:3, 3] = Rotation.random(random_state=seed).as_matrix(), rng.normal(0.0, 100.0, 3)
    for pose in (None, motion_covariance):
        moved, of_moved = uncertainty.transform_planes(planes, covariance, motion, pose)
        length = planes[:, 3] + np.linalg.norm(motion[:3, 3])
        check_planes(of_moved, length, total + (0.0 if pose is None else np.trace(pose)))
    for plane, of_plane, trace in zip(planes[:4], covariance[:4], total[:4], strict=True):
        of_normal = np.linalg.eigvalsh(of_plane[:3, :3])
        if of_normal[1] < 1e-6 * of_normal[2]:  # of pixels in a line that a lens hardly bends: nearly of rank 2
            continue
        fused, of_fused = uncertainty.fuse_planes([plane, plane], [of_plane, 3.0 * of_plane])
        check_planes(of_fused[None], fused[3:], trace)
    on_them = -planes[:, 3:] * planes[:, :3]
    distance, of_distance = uncertainty.point_distance(on_them, planes, covariance, 1e-4 * np.eye(3))
    angle, of_angle = uncertainty.angle_between(planes, covariance, moved, of_moved)
    alone, of_alone = uncertainty.angle_between(planes, covariance, planes, covariance)
    for made in (distance, angle, alone):
        assert np.isfinite(made).all()
    for std in (of_distance, of_angle, of_alone):
        assert (std >= 0.0).all()


@settings(max_examples=100)
@given(frames(), st.sampled_from(METHODS), SEEDS)
def test_those_of_fits(frame, method, seed):
    depth, camera = frame
    columns = np.indices(depth.shape)[1]
    windows = [(0, 0, 40, 56), (3, 5, 3, 40), (18, 26, 2, 3), (10, 10, 20, 2)]
    tiles = rp.fit_tiles(depth, camera, TILE, method, max_missing=1.0)
    for found in (
        tiles,
        rp.fit_windows(depth, camera, windows, method, max_missing=1.0),
        rp.fit_labels(depth, camera, 1 + (columns > 20), method, max_missing=1.0),
        rp.merge(tiles, 1 + np.indices(tiles.shape)[1] // 3),
    ):
        check_what_follows(*check(found, found.fitted), seed)


@settings(max_examples=60)
@given(frames(), st.booleans(), SEEDS)
def test_those_of_segments(frame, is_modelled, seed):
    depth, camera = frame
    found = rp.segment(depth, camera, noise=camera.noise if is_modelled else None, min_size=9)
    check_what_follows(*check(found, np.ones(len(found), bool)), seed)


def test_that_of_a_line_that_a_lens_hardly_bends(rng):
    """Rounding left α a direction of negative variance, 5e-9 of the largest."""
    camera = rp.Camera(WIDTH, HEIGHT, 60.0, 55.0, 27.5, 19.5, LENSES[1], noise=rp.noise.time_of_flight(0.002, 0.001))
    row, column = np.indices(camera.shape)
    for _ in range(10):
        depth = np.where((row + column == 48) & (column <= 20), 1.0 / (1.0 + 0.1 * rng.standard_normal(row.shape)), 0.0)
        found = rp.fit_labels(depth, camera, depth > 0.0)
        check(found, found.fitted)
        assert found.fitted.all()


@pytest.mark.parametrize("method", METHODS)
def test_that_of_depths_a_thousandfold_apart(method):
    """The noise's mean over a tile, as a power of q to second order, was below 0: all variances were."""
    camera = rp.Camera(WIDTH, HEIGHT, 60.0, 55.0, 27.5, 19.5, noise=rp.noise.time_of_flight(0.002, 0.001))
    q = np.abs(np.random.default_rng(1).standard_normal(camera.shape))
    found = rp.fit_tiles(1.0 / np.maximum(0.05 * q, 1e-5), camera, TILE, method)
    check(found, found.fitted)


@pytest.mark.parametrize("method", METHODS)
def test_normals_that_err_far_less_than_alpha(method, rng):
    """Their variances were differences of those of α, with hardly a digit left where a pixel sees nearly everything."""
    camera = rp.Camera(WIDTH, HEIGHT, 0.02, 0.02, 27.5, 19.5, noise=rp.noise.time_of_flight(0.002))
    found = rp.fit_tiles(rng.uniform(1.0, 3.0, camera.shape), camera, TILE, method)
    covariance = found.plane_covariance[found.fitted]
    scale = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    scale[:, :3] = np.sqrt((scale[:, :3] ** 2).sum(axis=1, keepdims=True))
    assert np.linalg.eigvalsh(covariance / scale[:, :, None] / scale[:, None, :]).min() > -ROUNDING


def test_those_of_segments_are_finite_at_the_ends_of_float32():
    """The product of two variances was infinite, of which the root is taken."""
    camera = rp.Camera(WIDTH, HEIGHT, 60.0, 55.0, 27.5, 19.5, noise=rp.noise.time_of_flight(1e9))
    found = rp.segment(np.full(camera.shape, 1e-36, np.float32), camera)
    assert len(found) == 1
    assert np.isfinite(found.alpha_covariance).all()
    assert np.isfinite(found.plane_covariance).all()
