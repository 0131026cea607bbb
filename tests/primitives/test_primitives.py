"""Planes, spheres and cylinders of labels against maximum likelihood in SciPy, and what the noise says of them."""

import numpy as np
import pytest
from curved_frames import rays_of
from frames import DISTORTIONS, as_dtype
from primitive_frames import (
    CAMERA,
    SHAPES,
    SIGMA,
    cone,
    frame_of,
    interior_of,
    inverse_depth_of,
    most_likely,
    rays_and_q,
    shared_errors,
)

import rgbd_planes as rp

KINDS = {"sphere": rp.Primitive.SPHERE, "cylinder": rp.Primitive.CYLINDER}


def assert_is(fits, k, name, atol):
    kind, parameters, near = SHAPES[name]
    centre, radius = np.array(parameters[:3]), parameters[-1]
    assert fits.kind[k] == KINDS[kind]
    assert fits.status[k] == rp.TileStatus.OK
    assert fits.convex[k] == near
    assert abs(fits.radius[k] - radius) < atol
    off = fits.centre[k] - centre
    if kind == "cylinder":
        axis = np.array(parameters[3:6]) / np.linalg.norm(parameters[3:6])
        assert np.linalg.norm(np.cross(fits.axis[k], axis)) < 10.0 * atol
        assert fits.axis[k, 0] >= 0.0
        off = off - (off @ axis) * axis
    else:
        assert np.isnan(fits.axis[k]).all()
    assert np.linalg.norm(off) < 10.0 * atol


@pytest.mark.parametrize("name", SHAPES)
def test_without_noise_shapes_are_exact_from_outside_and_from_within(name):
    _, q = rays_and_q(name)
    depth = frame_of(q)
    fits = rp.fit_primitives(depth, CAMERA, depth > 0.0)
    assert_is(fits, 0, name, 2e-7)
    np.testing.assert_allclose(fits.surface_depth()[depth > 0.0], depth[depth > 0.0], rtol=1e-6)
    assert fits.p_value[0] == pytest.approx(1.0)


@pytest.mark.parametrize("name", SHAPES)
def test_with_noise_they_are_the_most_likely_with_the_covariance_of_the_normal_equations(name):
    kind, parameters, near = SHAPES[name]
    rays, q = rays_and_q(name)
    depth = frame_of(q, SIGMA)
    depth[5:9, 40:50] = 0.0
    mask = depth > 0.0
    mask[:, :55] = False
    fits = rp.fit_primitives(depth, CAMERA, mask)
    used = interior_of(mask, depth > 0.0)
    assert fits.valid_count[0] == used.sum()
    best, covariance, total = most_likely(rays[used], 1.0 / depth[used], SIGMA, kind, parameters, near)
    assert fits.kind[0] == KINDS[kind]
    deviation = np.sqrt(covariance[-1, -1])
    assert abs(fits.radius[0] - best[-1]) < 3e-3 * deviation
    assert fits.radius_std[0] == pytest.approx(deviation, rel=2e-3)
    assert fits.rmse[0] == pytest.approx(SIGMA * np.sqrt(total / used.sum()), rel=1e-6)
    if kind == "sphere":
        np.testing.assert_allclose(fits.centre[0], best[:3], atol=3e-3 * np.sqrt(covariance[0, 0]) + 1e-9)
        with_radius = fits.covariance[0][np.ix_([0, 1, 2, 6], [0, 1, 2, 6])]
        np.testing.assert_allclose(with_radius, covariance, rtol=5e-3, atol=5e-3 * covariance.max())
        assert not fits.covariance[0, 3:6].any()
    else:
        along = fits.covariance[0, :3, :3] @ fits.axis[0]
        assert np.abs(along).max() < 1e-9 * np.abs(fits.covariance[0, :3, :3]).max() + 1e-18


def test_planes_are_called_curved_as_rarely_as_the_level_says():
    rays = rays_of(CAMERA)[20:50, 30:60]
    plane = rays @ np.array([0.2, -0.1, 0.7])
    camera = CAMERA.cropped(20, 30, 30, 30)
    rng = np.random.default_rng(5)
    labels = np.ones((30, 30), np.int32)
    kinds = []  # one frame each: all labels of a frame would be one frame's noise
    for _ in range(400):
        depth = 1.0 / (plane + SIGMA * rng.standard_normal(plane.shape))
        kinds.append(rp.fit_primitives(depth, camera, labels).kind[0])
    curved = np.isin(kinds, [rp.Primitive.SPHERE, rp.Primitive.CYLINDER])
    assert curved.sum() <= 10  # of 400 four are to be expected at most: ten come once in a hundred
    assert (np.array(kinds) == rp.Primitive.NONE).sum() <= 12


def corner(rays):
    """q of two walls that meet at a right angle, an edge towards the camera."""
    return np.minimum(rays @ np.array([0.6, 0.0, 0.8]), rays @ np.array([-0.6, 0.0, 0.8]))


def saddle(rays):
    x, y = rays[..., 0], rays[..., 1]
    return 0.9 - 0.8 * x * x + 0.8 * y * y


@pytest.mark.parametrize("name", ["cone", "corner", "saddle", "wave"])
def test_other_surfaces_are_none_of_the_three(name):
    rays = rays_of(CAMERA)
    q = {"cone": cone, "corner": corner, "saddle": saddle, "wave": lambda m: 1.0 + 0.02 * np.sin(20.0 * m[..., 0])}
    depth = frame_of(q[name](rays), SIGMA)
    fits = rp.fit_primitives(depth, CAMERA, depth > 0.0)
    assert fits.kind[0] == rp.Primitive.NONE
    assert fits.status[0] == rp.TileStatus.ROUGH
    assert fits.p_value[0] < 0.01
    for values in (fits.radius[0], fits.centre[0], fits.axis[0], fits.covariance[0]):
        assert np.isnan(values).all()
    assert fits.rmse[0] > SIGMA
    of_best = rp.fit_primitives(depth, CAMERA, depth > 0.0, significance=0.0)
    assert of_best.kind[0] != rp.Primitive.NONE
    assert of_best.rmse[0] == pytest.approx(fits.rmse[0], rel=1e-3)


def test_a_plane_has_its_point_its_normal_and_their_covariance():
    rays = rays_of(CAMERA)
    alpha = np.array([0.2, -0.1, 0.7])
    depth = frame_of(rays @ alpha, SIGMA)
    fits = rp.fit_primitives(depth, CAMERA, np.ones(depth.shape, bool))
    of_plane = rp.fit_labels(depth, CAMERA, np.ones(depth.shape, bool))
    assert fits.kind[0] == rp.Primitive.PLANE
    np.testing.assert_allclose(fits.planes[0], of_plane.planes[0], atol=1e-7)
    assert np.isnan([fits.radius[0], fits.radius_std[0]]).all()
    assert not fits.convex[0]
    assert fits.p_value[0] == pytest.approx(of_plane.p_value[0], abs=1e-3)
    np.testing.assert_allclose(
        fits.covariance[0, 3:6, 3:6], of_plane.plane_covariance[0, :3, :3], rtol=1e-3, atol=1e-16
    )
    assert fits.axis_std[0] == pytest.approx(of_plane.angle_std[0], rel=1e-4)
    assert np.linalg.matrix_rank(fits.covariance[0], tol=1e-14) <= 3


@pytest.mark.parametrize("distortion", DISTORTIONS)
@pytest.mark.parametrize("dtype", ["uint16", "float32", "float64"])
def test_units_dtypes_lenses_and_several_labels(dtype, distortion):
    camera = rp.Camera(
        120, 90, 130.0, -130.0, 59.5, 44.5, DISTORTIONS[distortion], depth_scale=1000.0,
        noise=rp.noise.quantised(rp.noise.kinect_v1(), 0.001),
    )  # fmt: skip
    rays = rays_of(camera)
    q = np.where(rays[..., 0] < 0.0, rays @ [0.1, 0.0, 0.6], 0.0)
    labels = np.where(rays[..., 0] < 0.0, 2, 0)
    ball = inverse_depth_of(rays, "sphere", (0.25, 0.0, 1.0, 0.2), True)
    q, labels = np.where(np.isnan(ball), q, ball), np.where(np.isnan(ball), labels, 4)
    depth = as_dtype(frame_of(q, SIGMA), dtype)
    depth[::7, ::5] = 0
    fits = rp.fit_primitives(depth, camera, labels)
    names = [rp.Primitive.NONE, rp.Primitive.PLANE, rp.Primitive.NONE, rp.Primitive.SPHERE]
    assert list(fits.kind) == names
    assert fits.status[0] == fits.status[2] == rp.TileStatus.TOO_FEW
    assert abs(fits.radius[3] - 0.2) < 4.0 * fits.radius_std[3] < 0.01
    assert repr(fits) == "<PrimitiveFits: 4 labels: 1 plane, 1 sphere, 2 none of these>"
    table = fits.to_table()
    assert list(table["kind"]) == ["NONE", "PLANE", "NONE", "SPHERE"]
    assert {len(column) for column in table.values()} == {4}


def test_without_a_noise_model_the_frame_tells_its_noise():
    _, q = rays_and_q("ball")
    wall = np.where(np.isnan(q), 0.5, q)
    camera = CAMERA.with_noise(None)
    depth, mask = frame_of(wall, SIGMA), np.isfinite(q)
    alone, given = rp.fit_primitives(depth, camera, mask), rp.fit_primitives(depth, CAMERA, mask)
    assert alone.kind[0] == given.kind[0] == rp.Primitive.SPHERE
    assert abs(alone.radius[0] - 0.2) < 5.0 * given.radius_std[0]
    # A frame of few squares shows errors that are across the ray, and reach far.
    assert 0.8 < alone.radius_std[0] / given.radius_std[0] < 10.0
    number = rp.fit_primitives(depth, camera, mask, noise=SIGMA)
    assert abs(number.radius[0] - 0.2) < 5.0 * given.radius_std[0]
    model = rp.fit_primitives(depth, camera, mask, noise=rp.noise.kinect_v1())
    assert model.radius[0] == given.radius[0]


@pytest.mark.parametrize("name", SHAPES)
def test_errors_across_the_ray_and_rounding_weigh_pixels_by_slope_and_depth(name):
    kind, parameters, near = SHAPES[name]
    model = rp.noise.NoiseModel((SIGMA, 1e-3), lateral=0.5, step=0.004)
    camera = CAMERA.with_noise(model)
    rays, q = rays_and_q(name)
    u, v = np.array([1e-5, 0.0, 0.0]), np.array([0.0, 1e-5, 0.0])
    slopes = [
        (inverse_depth_of(rays + d, kind, parameters, near) - inverse_depth_of(rays - d, kind, parameters, near)) / 2e-5
        for d in (u, v)
    ]
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(
            (SIGMA + 1e-3 * q) ** 2
            + (0.004 * q * q) ** 2 / 12.0
            + (0.5 / 130.0) ** 2 * (slopes[0] ** 2 + slopes[1] ** 2)
        )
    # Pixels that graze the surface have no slope within a step of the ray.
    mask = np.isfinite(sigma) & (sigma < 20.0 * SIGMA)
    depth = np.where(mask, frame_of(q + sigma * np.random.default_rng(3).standard_normal(q.shape)), 0.0)
    fits = rp.fit_primitives(depth, camera, mask)
    best, covariance, _ = most_likely(rays[mask], 1.0 / depth[mask], sigma[mask], kind, parameters, near)
    assert fits.kind[0] == KINDS[kind]
    assert fits.radius_std[0] == pytest.approx(np.sqrt(covariance[-1, -1]), rel=0.04)  # theirs are at the fit
    assert abs(fits.radius[0] - best[-1]) < 0.2 * fits.radius_std[0]
    assert fits.p_value[0] > 0.001


@pytest.mark.parametrize("name", ["ball", "pipe"])
def test_errors_that_neighbours_share_are_in_the_covariance_and_the_chances(name):
    model = rp.noise.NoiseModel((SIGMA,), correlation=((0.5, 2.0), (0.2, 5.0)), floor=0.5, floor_length=15.0)
    camera = CAMERA.with_noise(model)
    _, q = rays_and_q(name)
    wall = np.where(np.isnan(q), 0.5, q)
    rng = np.random.default_rng(2)
    radii, predicted, chances = [], [], []
    for _ in range(150):
        depth = 1.0 / (wall + shared_errors(model, wall.shape, rng))
        fits = rp.fit_primitives(depth, camera, np.isfinite(q), significance=1e-9)
        radii.append(fits.radius[0])
        predicted.append(fits.radius_std[0])
        chances.append(fits.p_value[0])
    assert np.isfinite(radii).all()
    # Chance alone makes 6 % of difference. Without the correlation the ratio would be a half.
    assert 0.8 < np.sqrt(np.mean(np.square(predicted))) / np.std(radii) < 1.25
    assert np.mean(np.array(chances) < 0.05) < 0.12
    assert 0.35 < np.mean(chances) < 0.65
    independent = rp.fit_primitives(depth, CAMERA, np.isfinite(q), significance=0.0)
    assert independent.radius_std[0] < 0.7 * predicted[-1]


@pytest.mark.filterwarnings("ignore::UserWarning")  # of such focal lengths and depths
def test_covariances_of_surfaces_that_pixels_hardly_determine_have_no_negative_direction():
    camera = rp.Camera(24, 24, 7e7, 7e7, 12.0, 12.0, noise=rp.noise.kinect_v1())
    found = 0
    for seed in range(15, 30):
        rng = np.random.default_rng(seed)
        depth = 10.0 ** rng.uniform(0.0, 12.0, camera.shape)
        labels = np.zeros(camera.shape, int)
        labels.ravel()[rng.choice(labels.size, 8, replace=False)] = 1
        fits = rp.fit_primitives(depth, camera, labels, significance=0.0)
        found += np.count_nonzero(fits.kind)
        for covariance in fits.covariance[fits.kind != rp.Primitive.NONE]:
            deviation = np.sqrt(np.diagonal(covariance))
            scale = np.where(deviation > 0.0, deviation, 1.0)
            assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > -1e-13
    assert found > 10


def test_outliers_at_a_rim_are_left_out_and_counted():
    _, q = rays_and_q("pipe")
    depth = frame_of(q, SIGMA)
    mask = depth > 0.0
    rows = np.flatnonzero(mask.any(axis=1))
    clean = rp.fit_primitives(depth, CAMERA, mask)
    depth[rows[:4]] = np.where(mask[rows[:4]], depth[rows[:4]] + 0.05, 0.0)
    fits = rp.fit_primitives(depth, CAMERA, mask)
    assert fits.kind[0] == rp.Primitive.CYLINDER
    assert abs(fits.radius[0] - clean.radius[0]) < 3.0 * fits.radius_std[0]
    left_out = clean.valid_count[0] - fits.valid_count[0]
    assert abs(left_out - mask[rows[:4]].sum()) < 0.2 * left_out


def test_files_hold_all_of_a_result(tmp_path):
    _, q = rays_and_q("pipe")
    depth = frame_of(q, SIGMA)
    labels = np.where(depth > 0.0, 1, 0)
    labels[:3] = 2
    fits = rp.fit_primitives(depth, CAMERA, labels)
    fits.save(tmp_path / "fits.npz")
    loaded = rp.PrimitiveFits.load(tmp_path / "fits.npz")
    for name in ("labels", "kind", "radius", "centre", "axis", "convex", "covariance", "rmse", "p_value", "status"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(fits, name))
    with pytest.raises(ValueError, match=r"rp.PrimitiveFits.load reads it"):
        rp.LabelPlanes.load(tmp_path / "fits.npz")


def test_labels_without_pixels_and_frames_without_labels():
    depth = np.ones(CAMERA.shape)
    assert len(rp.fit_primitives(depth, CAMERA, np.zeros(CAMERA.shape, int))) == 0
    few = np.zeros(CAMERA.shape, int)
    few[3, 3:8] = 2
    few[10, 3:60] = 3
    fits = rp.fit_primitives(depth, CAMERA, few)
    assert list(fits.status) == [rp.TileStatus.TOO_FEW, rp.TileStatus.TOO_FEW, rp.TileStatus.DEGENERATE]
    with pytest.raises(ValueError, match="labels must have the shape of the frame"):
        rp.fit_primitives(depth, CAMERA, few[1:])
    with pytest.raises(ValueError, match="significance must be"):
        rp.fit_primitives(depth, CAMERA, few, significance=2.0)
