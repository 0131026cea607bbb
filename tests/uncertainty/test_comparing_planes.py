"""Tests of two planes, unions of them, and what follows from covariances, against draws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

import rgbd_planes as rp

UNIT = np.array([0.0, 0.6, -0.8, 2.0])


def test_same_plane_is_uniform_on_one_plane_and_small_on_two(rng):
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, noise=rp.noise.kinect_v1())
    depth = rp.scenes.plane((0.3, 0.2, -1.0), 2.0).render(camera).measure(quantise=False, seed=rng)
    tiles = rp.fit_tiles(depth, camera, 16)
    a, c = tiles.alpha, tiles.alpha_covariance
    p = rp.uncertainty.same_plane(a[:, :-1:2], c[:, :-1:2], a[:, 1::2], c[:, 1::2])
    assert stats.kstest(p.ravel(), "uniform").pvalue > 1e-4
    delta = a[0, 0] - a[5, 7]
    statistic = delta @ np.linalg.solve(c[0, 0] + c[5, 7], delta)
    one = rp.uncertainty.same_plane(a[0, 0], c[0, 0], a[5, 7], c[5, 7])
    np.testing.assert_allclose(one, stats.chi2.sf(statistic, 3), rtol=1e-10)
    # Two parallel planes 6 cm apart, of 64x64 pixels each.
    labels = np.zeros(tiles.shape, int)
    labels[:4, :4], labels[8:12, 8:12] = 1, 2
    merged = rp.merge(tiles, labels)
    other = rp.merge(rp.fit_tiles(depth * 1.03, camera, 16), labels)
    assert (
        rp.uncertainty.same_plane(
            merged.alpha[0], merged.alpha_covariance[0], merged.alpha[1], merged.alpha_covariance[1]
        )
        > 1e-4
    )
    assert (
        rp.uncertainty.same_plane(
            merged.alpha[0], merged.alpha_covariance[0], other.alpha[1], other.alpha_covariance[1]
        )
        < 1e-6
    )
    assert np.isnan(rp.uncertainty.same_plane(np.full(3, np.nan), c[0, 0], a[0, 0], c[0, 0]))
    # In the frame of the plane itself, where d is 0 and α infinite, it is the same test.
    x, y = np.linalg.svd(tiles.planes[0, 0, :3][None])[2][1:]
    motion = np.eye(4)
    motion[:3, :3] = np.stack([x, y, np.cross(x, y)])
    motion[:3, 3] = motion[:3, :3] @ (tiles.planes[0, 0, 3] * tiles.planes[0, 0, :3])
    planes, covariance = rp.uncertainty.transform_planes(tiles.planes, tiles.plane_covariance, motion)
    left, right = np.s_[:, :-1:2], np.s_[:, 1::2]
    moved = rp.uncertainty.same_plane(planes[left], covariance[left], planes[right], covariance[right])
    assert abs(planes[0, 0, 3]) < 1e-12
    np.testing.assert_allclose(moved, p, atol=0.03)
    assert stats.kstest(moved.ravel(), "uniform").pvalue > 1e-4
    assert rp.uncertainty.same_plane(planes[0, 0], covariance[0, 0], -planes[0, 0], covariance[0, 0]) == 0.0
    assert rp.uncertainty.same_plane(planes[0, 0], covariance[0, 0], planes[0, 0], covariance[0, 0]) == 1.0
    missing = np.full(4, np.nan)
    assert np.isnan(rp.uncertainty.same_plane(missing, covariance[0, 0], planes[0, 0], covariance[0, 0]))
    with pytest.raises(ValueError, match=r"covariance of shape \(..., 3, 3\)"):
        rp.uncertainty.same_plane(a, c[..., 0], a, c)


@pytest.fixture
def two_planes(rng):
    """Planes with covariances, and draws of both from them."""
    planes, covariances, draws = [], [], []
    for normal, d in (((0.2, 0.1, -1.0), 1.5), ((0.8, -0.4, -0.7), 2.0)):
        unit = np.array(normal) / np.linalg.norm(normal)
        root = 1e-3 * rng.standard_normal((3, 3))
        alpha = -unit / d + rng.standard_normal((200_000, 3)) @ root.T
        projection = np.eye(3) - np.outer(unit, unit)
        slope = np.vstack([-d * projection, d * d * unit])
        planes.append(np.append(unit, d))
        covariances.append(slope @ root @ root.T @ slope.T)
        length = np.linalg.norm(alpha, axis=1, keepdims=True)
        draws.append(np.hstack([-alpha / length, 1.0 / length]))
    return planes, covariances, draws


def test_propagation_against_draws(two_planes, rng):
    (plane, other), (covariance, other_covariance), (draws, other_draws) = two_planes
    np.testing.assert_allclose(np.cov(draws.T), covariance, rtol=0.03, atol=2e-8)

    point, point_covariance = np.array([0.3, -0.2, 1.7]), np.diag([1e-6, 4e-6, 2e-6])
    distance, std = rp.uncertainty.point_distance(point, plane, covariance)
    alike = rp.uncertainty.point_distance(point, plane, np.stack([covariance, 4.0 * covariance]))
    np.testing.assert_allclose(alike, [[distance, distance], [std, 2.0 * std]])
    assert distance == pytest.approx(plane[:3] @ point + plane[3])
    assert std == pytest.approx((draws[:, :3] @ point + draws[:, 3]).std(), rel=0.01)
    points = point + rng.standard_normal((200_000, 3)) * np.sqrt(np.diag(point_covariance))
    _, std = rp.uncertainty.point_distance(point, plane, covariance, point_covariance)
    assert std == pytest.approx((np.sum(draws[:, :3] * points, axis=1) + draws[:, 3]).std(), rel=0.01)

    angle, std = rp.uncertainty.angle_between(plane, covariance, other, other_covariance)
    angles = np.degrees(np.arccos(np.sum(draws[:, :3] * other_draws[:, :3], axis=1)))
    assert angle == pytest.approx(angles.mean(), rel=1e-3)
    assert std == pytest.approx(angles.std(), rel=0.01)
    angle, std = rp.uncertainty.angle_between(plane, covariance, plane, covariance)
    assert angle == pytest.approx(0.0, abs=1e-6)
    assert 0.0 < std < 10.0

    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, [0.5, -1.0, 2.0]
    moved, moved_covariance = rp.uncertainty.transform_planes(plane, covariance, motion)
    foot = -plane[3] * plane[:3]
    assert moved[:3] @ (rotation @ foot + motion[:3, 3]) + moved[3] == pytest.approx(0.0, abs=1e-12)
    pose_covariance = np.diag([1e-6, 2e-6, 3e-6, 4e-6, 1e-6, 2e-6])
    moved, moved_covariance = rp.uncertainty.transform_planes(plane, covariance, motion, pose_covariance)
    pose = rng.standard_normal((200_000, 6)) * np.sqrt(np.diag(pose_covariance))
    normals = draws[:, :3] @ rotation.T
    normals = normals + np.cross(pose[:, :3], normals)
    offsets = draws[:, 3] - np.sum(normals * (motion[:3, 3] + pose[:, 3:]), axis=1)
    np.testing.assert_allclose(np.cov(np.column_stack([normals, offsets]).T), moved_covariance, rtol=0.03, atol=1e-7)
    endless = motion.copy()
    endless[0, 3] = np.inf
    for no_motion in (2.0 * motion, np.diag([1.0, 1.0, -1.0, 1.0]), np.nan * motion, endless):
        with pytest.raises(ValueError, match=r"rigid motion .*\]$"):
            rp.uncertainty.transform_planes(plane, covariance, no_motion)


def test_shapes_are_those_that_all_arguments_broadcast_to():
    """So that planes and their covariances are as many, whatever is one for all; and what comes is the caller's own."""
    planes, covariances = np.tile(UNIT, (5, 1)), np.tile(1e-6 * np.eye(4), (5, 1, 1))
    poses = np.tile(1e-6 * np.eye(6), (5, 1, 1))
    for arguments in (
        (planes, None, np.eye(4)),
        (UNIT, covariances, np.eye(4)),
        (UNIT, covariances[0], np.tile(np.eye(4), (5, 1, 1))),
        (UNIT, covariances[0], np.eye(4), poses),
        (planes[:, None], covariances[:1], np.eye(4)),
    ):
        moved, covariance = rp.uncertainty.transform_planes(*arguments)
        shape = (5, 1) if len(moved.shape) == 3 else (5,)
        assert (moved.shape, covariance.shape) == ((*shape, 4), (*shape, 4, 4))
        moved[0], covariance[0] = 7.0, 7.0
        assert (moved.reshape(-1, 4)[1] == UNIT).all()
    for arguments in ((UNIT, covariances, UNIT, None), (UNIT, None, planes, None), (planes, covariances, UNIT, None)):
        angle, std = rp.uncertainty.angle_between(*arguments)
        assert angle.shape == std.shape == (5,)
    angle, std = rp.uncertainty.angle_between(UNIT, covariances[0], UNIT, covariances[0])
    assert angle.shape == std.shape == ()


def test_a_turn_about_a_point_of_the_plane_leaves_its_distance_certain():
    """A pose's rotation and translation may err together."""
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix(), [0.5, -1.0, 2.0]
    x, y, z = lever = motion[:3, :3] @ [0.3, 0.4, 2.8]
    errors = np.vstack([np.eye(3), [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]])  # ω, and τ = -ω × lever
    moved = rp.uncertainty.transform_planes(UNIT, np.zeros((4, 4)), motion, 1e-4 * errors @ errors.T)
    distance, std = rp.uncertainty.point_distance(lever + motion[:3, 3], *moved)
    assert distance == pytest.approx(0.0, abs=1e-12)
    assert std == pytest.approx(0.0, abs=1e-8)


def test_a_pose_of_a_few_digits_is_its_nearest_rotation():
    """As poses of data sets are: with R as it stands the normals would lose their length."""
    rotation = Rotation.from_rotvec([0.3, -0.2, 0.1])
    motion = np.eye(4)
    plane, covariance = np.array([0.0, 0.6, -0.8, 2.0]), np.zeros((4, 4))
    for digits in (3, 4):
        motion[:3, :3] = rotation.as_matrix().round(digits)
        moved, _ = rp.uncertainty.transform_planes(plane, covariance, np.stack([motion, np.eye(4)]))
        nearest = Rotation.from_matrix(motion[:3, :3])
        np.testing.assert_allclose(moved[0, :3], nearest.apply(plane[:3]), atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(moved[:, :3], axis=1), 1.0, atol=1e-12)
        np.testing.assert_array_equal(moved[1], plane)
    motion[:3, :3] = rotation.as_matrix().round(2)
    with pytest.raises(ValueError, match=r"rigid motion .*: R·Rᵀ is off by 0.0"):
        rp.uncertainty.transform_planes(plane, covariance, motion)


def test_nothing_depends_on_the_frame_of_axes(rng):
    """Motions one after the other are one; distances and angles stay, and how far they may be off."""
    camera = rp.Camera(80, 64, 66.0, 66.0, 39.5, 31.5, noise=rp.noise.kinect_v1())
    tiles = rp.fit_tiles(rp.scenes.room().render(camera).measure(quantise=False, seed=rng), camera, 16)
    planes, covariance = tiles.planes, tiles.plane_covariance
    motions = np.tile(np.eye(4), (2, 1, 1))
    motions[:, :3, :3] = Rotation.from_rotvec(rng.standard_normal((2, 3))).as_matrix()
    motions[:, :3, 3] = rng.standard_normal((2, 3))
    there = rp.uncertainty.transform_planes(planes, covariance, motions[0])
    for made, wanted in zip(
        (
            *rp.uncertainty.transform_planes(*there, motions[1]),
            *rp.uncertainty.transform_planes(*there, np.linalg.inv(motions[0])),
        ),
        (*rp.uncertainty.transform_planes(planes, covariance, motions[1] @ motions[0]), planes, covariance),
        strict=True,
    ):
        np.testing.assert_allclose(made, wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())
    point, spread = rng.standard_normal(3), np.diag([1e-4, 4e-4, 9e-4])
    turn, shift = motions[0, :3, :3], motions[0, :3, 3]
    np.testing.assert_allclose(
        rp.uncertainty.point_distance(turn @ point + shift, *there, turn @ spread @ turn.T),
        rp.uncertainty.point_distance(point, planes, covariance, spread),
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        rp.uncertainty.angle_between(there[0][1:], there[1][1:], there[0][:-1], there[1][:-1]),
        rp.uncertainty.angle_between(planes[:-1], covariance[:-1], planes[1:], covariance[1:]),
        rtol=1e-7,
    )


def test_leading_shapes_that_do_not_broadcast():
    eye, plane, planes = np.eye(4), UNIT, np.tile(UNIT, (2, 3, 1))
    alpha = np.ones((2, 3, 3))
    for call in (
        lambda: rp.uncertainty.same_plane(alpha, np.eye(3), alpha[:1, :2], np.eye(3)),
        lambda: rp.uncertainty.point_distance(np.ones((5, 3)), planes, eye),
        lambda: rp.uncertainty.point_distance(np.ones(3), planes, eye, np.ones((5, 3, 3))),
        lambda: rp.uncertainty.angle_between(planes, eye, planes[0, :2], eye),
        lambda: rp.uncertainty.transform_planes(planes, eye, np.stack([eye, eye])),
        lambda: rp.uncertainty.transform_planes(plane, np.stack([eye] * 2), eye, np.ones((3, 6, 6))),
    ):
        with pytest.raises(ValueError, match=r"leading shapes that broadcast, got .*\("):
            call()


@pytest.mark.parametrize("metres", [0.0, 100.0, 1e5])
def test_same_plane_of_planes_far_from_the_origin(metres):
    """In a map's frame as in the camera's: it took planes 3 cm apart for one, 100 m away."""
    camera = rp.Camera(320, 240, 262.0, 262.0, 159.5, 119.5, noise=rp.noise.kinect_v1())
    near, far = (
        rp.fit_tiles(rp.scenes.plane((0.2, -0.3, -1.0), z).render(camera).measure(seed=3, quantise=False), camera, 8)
        for z in (2.0, 2.03)
    )
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    pose[:3, 3] = metres * np.array([0.8, 0.5, -0.3])
    moved, other = (rp.uncertainty.transform_planes(fits.planes, fits.plane_covariance, pose) for fits in (near, far))
    left, right = np.s_[:, :-1], np.s_[:, 1:]
    one = rp.uncertainty.same_plane(moved[0][left], moved[1][left], moved[0][right], moved[1][right])
    planes, covariance = near.planes, near.plane_covariance
    at_home = rp.uncertainty.same_plane(planes[left], covariance[left], planes[right], covariance[right])
    np.testing.assert_allclose(one, at_home, atol=1e-3)
    two = rp.uncertainty.same_plane(moved[0][left], moved[1][left], other[0][right], other[1][right])
    assert two.max() < 1e-3


def test_fused_tiles_are_the_plane_of_all_their_pixels(rng):
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, noise=rp.noise.kinect_v1())
    depth = rp.scenes.plane((0.3, 0.2, -1.0), 1.5).render(camera).measure(quantise=False, seed=rng)
    tiles = rp.fit_tiles(depth, camera, 16)
    whole = rp.merge(tiles, np.ones(tiles.shape, int))
    planes, covariance = tiles.planes.reshape(-1, 4), tiles.plane_covariance.reshape(-1, 4, 4)
    for metres in (0.0, 50.0):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
        pose[:3, 3] = metres
        plane, of_plane = rp.uncertainty.fuse_planes(*rp.uncertainty.transform_planes(planes, covariance, pose))
        wanted, of_wanted = rp.uncertainty.transform_planes(whole.planes[0], whole.plane_covariance[0], pose)
        assert np.linalg.norm(plane[:3]) == pytest.approx(1.0)
        scale = np.sqrt(np.diag(of_wanted))
        assert (np.abs(plane - wanted) < 0.3 * scale).all()
        np.testing.assert_allclose(of_plane / np.outer(scale, scale), of_wanted / np.outer(scale, scale), atol=0.03)


def test_strips_of_pixels_are_fused():
    """Of a strip 2 pixels wide the normal's variance is a hundred thousand times larger across it than along it."""
    camera = rp.Camera(640, 4, 525.0, 525.0, 319.5, 1.5, noise=rp.noise.kinect_v1())
    depth = rp.scenes.plane((0.3, 0.2, -1.0), 1.5).render(camera).measure(quantise=False, seed=1)
    strips = rp.fit_tiles(depth, camera, (2, 640))
    plane, covariance = rp.uncertainty.fuse_planes(strips.planes[:, 0], strips.plane_covariance[:, 0])
    assert np.isfinite(plane).all()
    assert (np.diag(covariance) < np.diagonal(strips.plane_covariance[:, 0], axis1=1, axis2=2)).all()


def test_fused_planes_err_as_they_say(rng):
    """Of one wall, seen from several places; stacked, with one that is missing."""
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, noise=rp.noise.kinect_v1())
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.1, 0.4, -0.2]).as_matrix()
    pose[:3, 3] = [20.0, -5.0, 3.0]
    views = [rp.scenes.plane((0.3 * i, 0.2, -1.0), 1.5 + 0.2 * i).render(camera) for i in range(3)]
    turns = [np.eye(4) for _ in views]
    first = views[0].planes[0]
    for turn, view in zip(turns, views, strict=True):  # to where the first camera sees the same wall
        n, d = view.planes[0, :3], view.planes[0, 3]
        axis = np.cross(n, first[:3])
        angle = np.arctan2(np.linalg.norm(axis), n @ first[:3])
        turn[:3, :3] = Rotation.from_rotvec(axis / max(np.linalg.norm(axis), 1e-12) * angle).as_matrix()
        turn[:3, 3] = first[:3] * (d - first[3])
    truth = rp.uncertainty.transform_planes(first, np.zeros((4, 4)), pose)[0]
    squares = []
    for _ in range(100):
        seen = []
        for view, turn in zip(views, turns, strict=True):
            fits = rp.fit_labels(view.measure(quantise=False, seed=rng), camera, np.ones(camera.shape, int))
            seen.append(rp.uncertainty.transform_planes(fits.planes[0], fits.plane_covariance[0], pose @ turn))
        planes, covariance = (np.stack(values) for values in zip(*seen, strict=True))
        planes = np.stack([np.concatenate([planes, np.full((1, 4), np.nan)]), np.full((4, 4), np.nan)])
        covariance = np.stack([np.concatenate([covariance, covariance[:1]])] * 2)
        (plane, nothing), (of_plane, _) = rp.uncertainty.fuse_planes(planes, covariance)
        assert np.isnan(nothing).all()
        squares.append((plane - truth) @ np.linalg.pinv(of_plane, rcond=1e-9) @ (plane - truth))
    assert np.mean(squares) == pytest.approx(3.0, abs=1.0)


@pytest.mark.parametrize("degrees", [3.0, 6.0, 12.0])
def test_planes_are_fused_to_the_same_whichever_comes_first(degrees):
    """A poor one, turned by so much, and a good one: where errors are linear is where the good one is."""
    planes, covariance = [], []
    for turn, of_turn, of_offset in ((np.radians(degrees), np.radians(degrees) / 1.5, 0.05), (0.0, 1e-3, 1e-3)):
        normal = np.array([np.sin(turn), 0.2, -np.cos(turn)]) / np.sqrt(1.04)
        planes.append([*normal, 2.0 + of_offset])
        covariance.append(np.diag([0.0, 0.0, 0.0, of_offset**2]))
        covariance[-1][:3, :3] = of_turn**2 * (np.eye(3) - np.outer(normal, normal))
    fused, of_fused = rp.uncertainty.fuse_planes(planes, covariance)
    other, of_other = rp.uncertainty.fuse_planes(planes[::-1], covariance[::-1])
    assert (np.abs(fused - other) < 1e-3 * np.sqrt(np.diag(of_other))).all()
    np.testing.assert_allclose(of_fused, of_other, atol=1e-3 * of_other.max())


def test_planes_that_are_not_one_are_fused_to_something():
    planes = np.array([[0.0, 0.0, -1.0, 3.0], [0.0, -0.99, -0.14106736, 1.2]])
    covariance = np.diag([1e-6, 1e-6, 0.0, 1e-6]), np.diag([4e-4, 4e-4, 4e-4, 1e-6])
    fused, of_fused = rp.uncertainty.fuse_planes(planes, np.stack(covariance))
    assert np.linalg.norm(fused[:3]) == pytest.approx(1.0)
    assert np.isfinite(of_fused).all()


@given(st.integers(0, 2**32), st.sampled_from([-1.0, 1.0]))
def test_a_covariance_of_no_plane_is_refused(seed, sign):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    errors = rng.normal(size=(1 if sign > 0.0 else 3, 4)) * [0.01, 0.01, 0.01, 0.03]
    errors[:, :3] -= (errors[:, :3] @ normal)[:, None] * normal
    with pytest.raises(ValueError, match="covariances of rank 3"):
        rp.uncertainty.fuse_planes([[*normal, 2.0]] * 2, [sign * errors.T @ errors] * 2)


@pytest.mark.parametrize(
    "use",
    [
        lambda plane, covariance: rp.uncertainty.point_distance(np.zeros(3), plane, covariance),
        lambda plane, covariance: rp.uncertainty.angle_between(UNIT, np.eye(4), plane, covariance),
        lambda plane, covariance: rp.uncertainty.angle_between(plane, covariance, UNIT, np.eye(4)),
        lambda plane, covariance: [rp.uncertainty.same_plane(plane, covariance, UNIT, np.eye(4))],
        lambda plane, covariance: [rp.uncertainty.same_plane(UNIT, np.eye(4), plane, covariance)],
        lambda plane, covariance: rp.uncertainty.transform_planes(plane, covariance, np.eye(4)),
        lambda plane, covariance: rp.uncertainty.fuse_planes([plane, UNIT], [covariance, np.eye(4)]),
    ],
)
def test_normals_of_another_length_are_refused(use):
    """Distances would be in other units than metres; as the message says, they are right."""
    covariance = np.diag([1e-4, 1e-4, 1e-4, 1e-4])
    for scale in (1000.0, 1.002, 0.5, -2.0, 0.0):
        expected = rf"normals of length 1, got {abs(scale):g}: .* scale\[\.\.\., None\] \*\* 2$"
        with pytest.raises(ValueError, match=expected):
            use(scale * UNIT, scale**2 * covariance)
    planes, of_planes = 3.0 * UNIT, 9.0 * covariance
    scale = np.linalg.norm(planes[..., :3], axis=-1, keepdims=True)
    for found, wanted in zip(
        use(planes / scale, of_planes / scale[..., None] ** 2), use(UNIT, covariance), strict=True
    ):
        np.testing.assert_allclose(found, wanted, atol=1e-12)
    use(np.array([0.0, 0.6, -0.8004, 2.0]), covariance)  # of a file
    use(UNIT.astype(np.float32), covariance)
    use(np.full(4, np.nan), np.full((4, 4), np.nan))


def test_what_is_missing_has_no_angle_and_no_part_in_what_is_fused():
    """A plane, or its covariance alone, as from elsewhere."""
    normal = np.array([0.0, 0.6, -0.8])
    across = np.eye(3) - np.outer(normal, normal)
    plane, covariance = np.append(normal, 2.0), np.zeros((4, 4))
    covariance[:3, :3], covariance[3, 3] = 1e-4 * across, 1e-4
    none, unknown = np.full(4, np.nan), np.full((4, 4), np.nan)
    for missing in ((none, covariance), (plane, unknown)):
        assert np.isnan(rp.uncertainty.angle_between(*missing, plane, covariance)[1])
        both = (np.stack(pair) for pair in zip(missing, (plane, covariance), strict=True))
        fused, of_fused = rp.uncertainty.fuse_planes(*both)
        np.testing.assert_allclose(fused, plane, atol=1e-12)
        np.testing.assert_allclose(of_fused, covariance, atol=1e-12)
        assert np.isnan(np.vstack(rp.uncertainty.fuse_planes(*(part[None] for part in missing)))).all()


def test_what_cannot_be_fused_is_refused():
    plane, covariance = np.array([[0.0, 0.0, -1.0, 2.0]]), np.zeros((1, 4, 4))
    with pytest.raises(ValueError, match="covariances of rank 3"):
        rp.uncertainty.fuse_planes(plane, covariance)
    with pytest.raises(ValueError, match="point to one side"):
        rp.uncertainty.fuse_planes(np.concatenate([plane, -plane]), covariance)
    with pytest.raises(ValueError, match=r"\(..., K, 4\), K at least 1, got \(4,\)"):
        rp.uncertainty.fuse_planes(plane[0], covariance[0])


def test_same_plane_without_errors_is_refused():
    """It was NaN, as of planes that are missing; one of the two may be known exactly."""
    plane, other, none = np.array([0.0, 0.0, -1.0, 2.0]), np.array([0.0, 0.6, -0.8, 2.0]), np.zeros((4, 4))
    some = np.diag([1e-6, 1e-6, 0.0, 1e-6])
    for second in (plane, other):
        with pytest.raises(ValueError, match="covariances whose sums are of rank 3"):
            rp.uncertainty.same_plane(plane, none, second, none)
        with pytest.raises(ValueError, match="covariances whose sums are of rank 3"):
            rp.uncertainty.same_plane(-plane[:3] / 2.0, none[:3, :3], -second[:3] / 2.0, none[:3, :3])
    assert rp.uncertainty.same_plane(plane, none, plane, some) == 1.0
    missing = np.stack([plane, np.full(4, np.nan)])
    assert np.isnan(rp.uncertainty.same_plane(missing, some, plane, some)).tolist() == [False, True]
    assert np.isnan(rp.uncertainty.same_plane(plane, np.full((4, 4), np.nan), plane, none))
    assert rp.uncertainty.same_plane(missing[:0], some, plane, some).shape == (0,)


def test_same_plane_takes_every_correlation(rng):
    """Of whole tiles the two slopes have next to none."""
    factors = rng.standard_normal((2, 200, 3, 3))
    one, other = factors @ np.swapaxes(factors, -1, -2)
    alpha, other_alpha = 3.0 * rng.standard_normal((2, 200, 3))
    delta = alpha - other_alpha
    statistic = np.einsum("ki,kij,kj->k", delta, np.linalg.inv(one + other), delta)
    found = rp.uncertainty.same_plane(alpha, one, other_alpha, other)
    np.testing.assert_allclose(found, stats.chi2.sf(statistic, 3), rtol=1e-8)


def test_angle_between_planes_that_coincide_has_its_largest_deviation():
    plane = np.array([0.0, 0.0, -1.0, 2.0])
    one, other = np.diag([9e-6, 1e-6, 0.0, 1e-6]), np.diag([7e-6, 3e-6, 0.0, 1e-6])
    angle, std = rp.uncertainty.angle_between(plane, one, plane, other)
    assert angle == 0.0
    assert std == pytest.approx(np.degrees(4e-3))


def test_what_is_not_known_of_planes_is_nan():
    """Without a noise model planes can still be taken to another frame, and compared."""
    planes = np.array([[0.0, 0.0, -1.0, 2.0], [0.6, 0.0, -0.8, 1.0]])
    motion = np.array([[0.0, 0.0, 1.0, 0.3], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.2], [0.0, 0.0, 0.0, 1.0]])
    zero = np.zeros((4, 4))
    moved, covariance = rp.uncertainty.transform_planes(planes, None, motion)
    np.testing.assert_array_equal(moved, rp.uncertainty.transform_planes(planes, zero, motion)[0])
    assert np.isnan(covariance).all()
    distance, std = rp.uncertainty.point_distance([0.1, 0.2, 1.0], planes, None)
    np.testing.assert_array_equal(distance, rp.uncertainty.point_distance([0.1, 0.2, 1.0], planes, zero)[0])
    assert np.isnan(std).all()
    angle, std = rp.uncertainty.angle_between(planes, None, planes[::-1], zero)
    np.testing.assert_allclose(angle, np.degrees(np.arccos(0.8)))
    assert np.isnan(std).all()


def drawn_planes(rng, count):
    """Planes in all directions, and covariances of their (n, d), uncorrelated about a point of each."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    planes = np.column_stack([normals, rng.uniform(0.5, 3.0, count)])
    covariance = np.zeros((count, 4, 4))
    for plane, own in zip(planes, covariance, strict=True):
        n, d = plane[:3], plane[3]
        middle = -d * n + np.cross(n, rng.normal(size=3))  # where it is most certain
        across = np.cross(n, rng.normal(size=3))
        slope = np.zeros((4, 3))
        slope[:3, 0], slope[:3, 1] = across, np.cross(n, across)
        slope[3, :2], slope[3, 2] = -middle @ slope[:3, :2], 1.0
        own[:] = slope @ np.diag(rng.uniform(0.2, 2.0, 3) * [1e-3, 1e-3, 2e-3]) ** 2 @ slope.T
    return planes, covariance


def motion_of(vector, translation):
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), translation
    return motion


def with_errors(rng, planes, covariance):
    """Planes with errors of these covariances, normals of length 1 again."""
    erring = np.array([rng.multivariate_normal(p, c, method="eigh") for p, c in zip(planes, covariance, strict=True)])
    erring[:, :3] /= np.linalg.norm(erring[:, :3], axis=1, keepdims=True)
    return erring


@pytest.mark.parametrize("count", [3, 8])
@pytest.mark.parametrize("degrees", [5.0, 170.0])
def test_a_motion_is_found_and_errs_as_it_says(rng, count, degrees):
    """One of the planes is missing in one frame."""
    squares = []
    for _ in range(150):
        planes, covariance = drawn_planes(rng, count + 1)
        while np.linalg.cond(planes[1:, :3]) > 3.0:
            planes, covariance = drawn_planes(rng, count + 1)
        truth = motion_of(np.radians(degrees) * np.array([0.6, 0.0, 0.8]), [5.0, -0.2, 0.1])
        others, of_others = rp.uncertainty.transform_planes(planes, 0.5 * covariance, truth)
        first, second = with_errors(rng, planes, covariance), with_errors(rng, others, of_others)
        second[0] = np.nan
        motion, of_motion = rp.uncertainty.align_planes(first, covariance, second, of_others)
        turn = Rotation.from_matrix(truth[:3, :3] @ motion[:3, :3].T).as_rotvec()
        error = np.concatenate([turn, truth[:3, 3] - motion[:3, 3]])
        squares.append(error @ np.linalg.solve(of_motion, error))
    assert np.mean(squares) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 150))


def test_a_camera_is_found_again_from_the_planes_of_a_room():
    """Of a tenth of a millimetre and some thousandths of a degree, without noise."""
    camera = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5)
    room, moved = rp.scenes.room(), motion_of([0.02, -0.05, 0.03], [0.1, -0.05, 0.2])
    later = rp.scenes.Scene(room.surfaces, room.camera_to_scene @ np.linalg.inv(moved))
    seen = [scene.render(camera) for scene in (room, later)]
    assert seen[0].names == seen[1].names
    noisy = camera.with_noise(rp.noise.kinect_v1())
    fits = [rp.fit_labels(rendering.depth, noisy, rendering.labels, max_missing=1.0) for rendering in seen]
    pairs = [a for fit in fits for a in (fit.planes, fit.plane_covariance)]
    motion, covariance = rp.uncertainty.align_planes(*pairs)
    np.testing.assert_allclose(motion, moved, atol=1e-4)
    moved_planes = rp.uncertainty.transform_planes(*pairs[:2], motion)
    p = rp.uncertainty.same_plane(*moved_planes, *pairs[2:])
    assert (p[np.isfinite(p)] > 0.99).all()
    assert np.sqrt(np.diag(covariance)).max() < 0.01


@pytest.mark.parametrize(("faced", "free"), [(1, 3), (2, 1), (3, 0), (0, 6)])
def test_what_planes_do_not_tell_of_a_motion(rng, faced, free):
    """Several parallel planes of each direction, with noise: what they leave open is that of the true normals."""
    normals = np.repeat(np.eye(3)[:faced], 3, axis=0)
    planes = np.column_stack([normals, rng.uniform(1.0, 3.0, len(normals))])
    spread = np.diag([1e-5, 1e-5, 1e-5, 1e-4])
    covariance = np.zeros((len(planes), 4, 4))
    for i, normal in enumerate(normals):
        across = np.eye(4)
        across[:3, :3] -= np.outer(normal, normal)
        covariance[i] = across @ spread @ across
    motion = motion_of([0.02, -0.05, 0.03], [0.1, -0.05, 0.2])
    others, _ = rp.uncertainty.transform_planes(planes, covariance, motion)

    def measured(exact):
        noisy = exact + rng.normal(size=exact.shape) * [3e-3, 3e-3, 3e-3, 1e-2]
        noisy[:, :3] /= np.linalg.norm(noisy[:, :3], axis=1, keepdims=True)
        return noisy

    found = rp.uncertainty.align_planes(measured(planes), covariance, measured(others), covariance)
    assert found.unobservable.shape == (free, 6)
    np.testing.assert_allclose(found.unobservable @ found.unobservable.T, np.eye(free), atol=1e-9)
    size = np.linalg.norm(found.information)
    assert (np.linalg.matrix_rank(found.information, 1e-9 * size) if size else 0) == 6 - free
    # Turns (ω × n = 0) and steps (n·τ = 0, about the origin) that change no true plane, after the motion.
    turned = normals @ motion[:3, :3].T
    slope = [np.vstack([np.hstack([np.cross(np.eye(3), n).T, np.zeros((3, 3))]) for n in turned])] if faced else []
    offsets = [np.append(-np.cross(n, motion[:3, 3]), -n) for n in turned]
    if free and faced:
        null = np.linalg.svd(np.vstack([*slope, offsets]))[2][6 - free :]
        cosines = np.linalg.svd(null @ found.unobservable.T, compute_uv=False)
        assert np.degrees(np.arccos(np.clip(cosines.min(), -1.0, 1.0))) < 2.0
    transform, of_transform = found
    assert np.isnan(of_transform).all() == bool(free)
    if not free:
        np.testing.assert_allclose(transform, motion, atol=0.05)
        np.testing.assert_allclose(of_transform @ found.information, np.eye(6), atol=1e-6)


def test_planes_of_another_shape_are_refused(rng):
    planes, covariance = drawn_planes(rng, 3)
    with pytest.raises(ValueError, match=r"expected \(K, 4\) planes"):
        rp.uncertainty.align_planes(planes[0], covariance[0], planes[0], covariance[0])


def test_motions_need_normals_to_the_same_side(rng):
    """Of planes whose normals point to the other side, and of others than those: no motion has an answer."""
    planes, covariance = drawn_planes(rng, 6)
    while np.linalg.cond(planes[1:, :3]) > 3.0:
        planes, covariance = drawn_planes(rng, 6)
    covariance = 1e-4 * covariance
    others, of_others = rp.uncertainty.transform_planes(
        planes, covariance, motion_of([0.1, 0.2, -0.3], [1.0, -2.0, 0.5])
    )
    planes[0] = np.nan
    with pytest.raises(ValueError, match=r"normals to the same side, got some that only a reflection brings together"):
        rp.uncertainty.align_planes(planes, covariance, -others, of_others)
    turned = others.copy()
    turned[2] *= -1.0
    with pytest.raises(ValueError, match=r"normals to the same side, got some that "):
        rp.uncertainty.align_planes(planes, covariance, turned, of_others)


def test_motions_need_covariances_of_planes(rng):
    planes, covariance = drawn_planes(rng, 4)
    for pair in ((covariance, 0.0 * covariance), (0.0 * covariance, covariance)):
        with pytest.raises(ValueError, match="covariances of rank 3"):
            rp.uncertainty.align_planes(planes, pair[0], planes, pair[1])


def test_motions_need_as_many_planes_and_covariances(rng):
    planes, covariance = drawn_planes(rng, 4)
    with pytest.raises(ValueError, match=r"of as many in both frames, got \(4, 4\), \(4, 4, 4\), \(3, 4\)"):
        rp.uncertainty.align_planes(planes, covariance, planes[:3], covariance[:3])
