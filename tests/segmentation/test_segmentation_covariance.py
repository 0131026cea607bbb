"""Segmentation: the covariances that it says its planes have."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter
from segment_frames import CAMERA

from rgbd_planes import Camera, fit_labels, segment
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels
from rgbd_planes.kernels.segmentation.blocks.pyramid import read_frame
from rgbd_planes.kernels.segmentation.noise.correlation import (
    OF_ONE,
    SIZES,
    is_in_one,
    may_be_chance,
    mixture,
    shared_by_planes,
)
from rgbd_planes.kernels.segmentation.refit.weights import weigh_rays
from rgbd_planes.kernels.statistics.tiles.block import EXPECTED
from rgbd_planes.noise import NoiseModel
from rgbd_planes.segmentation.frame_noise import correlation_table
from rgbd_planes.segmentation.workspace import Workspace, rays_of


def test_covariance_is_that_of_the_fit():
    # The observed spread of α over frames is what every single frame predicts.
    camera = Camera(width=96, height=64, fx=100.0, fy=100.0, cx=47.5, cy=31.5)
    rng = np.random.default_rng(12)
    q = 0.7 + 0.05 * camera.tan_x
    frames = [segment(1.0 / (q + rng.normal(0.0, 2e-3, q.shape)), camera) for _ in range(60)]
    observed = np.cov([f.alpha[0] for f in frames], rowvar=False)
    predicted = np.mean([f.alpha_covariance[0] for f in frames], axis=0)
    assert np.diag(predicted) == pytest.approx(np.diag(observed), rel=0.6)
    planes = np.cov([f.planes[0] for f in frames], rowvar=False)
    assert np.diag(frames[0].plane_covariance[0])[:2] == pytest.approx(np.diag(planes)[:2], rel=0.6)


SMALL = replace(CAMERA, width=120, height=90, cx=59.5, cy=44.5)


@pytest.mark.parametrize(
    ("camera", "pixels"), [(CAMERA, 0.0), (CAMERA, 0.8), (CAMERA, 1.5), (CAMERA, 3.0), (SMALL, 0.0), (SMALL, 1.5)]
)
def test_covariance_of_correlated_noise_is_honest(camera, pixels):
    # The mean squared error of α in units of its covariance is 1; taking pixels as independent makes it 5, 19 and 100.
    rng = np.random.default_rng(18)
    truth = np.array([0.1, 0.0, 0.6])
    errors = []
    for _ in range(25):
        noise = gaussian_filter(rng.normal(size=camera.shape), pixels)
        q = truth[0] * camera.tan_x + truth[2] + 1e-3 * noise / noise.std()
        found = segment(1.0 / q, camera)
        error = found.alpha[0] - truth
        errors.append(error @ np.linalg.solve(found.alpha_covariance[0], error) / 3.0)
    assert 0.4 < np.mean(errors) < 1.6


@pytest.mark.parametrize(
    "parts", [((0.5, 4.0),), ((0.3, 8.0),), ((0.1, 8.0),), ((0.57, 2.0), (0.28, 4.0)), ((0.4, 2.0), (0.44, 8.0))]
)
def test_covariance_of_partly_correlated_noise_is_honest(parts):
    # As before; by what squares of 32 pixels show, as if all errors had one reach, it is 2 to 12.
    rng = np.random.default_rng(20)
    camera = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    truth = np.array([0.1, 0.05, 0.6])
    errors = []
    for _ in range(15):
        noise = np.sqrt(1.0 - sum(share for share, _ in parts)) * rng.normal(size=camera.shape)
        for share, length in parts:
            smooth = gaussian_filter(rng.normal(size=camera.shape), length / 2.0**0.5, mode="wrap")
            noise += share**0.5 * smooth / smooth.std()
        q = truth[0] * camera.tan_x + truth[1] * camera.tan_y + truth[2] + 1e-3 * noise
        found = segment(1.0 / q, camera)
        error = found.alpha[0] - truth
        errors.append(error @ np.linalg.solve(found.alpha_covariance[0], error) / 3.0)
    assert 0.35 < np.mean(errors) < 1.6


def test_correlation_table_is_that_of_whole_covariances():
    side = 16
    y, x = np.indices((side, side)).reshape(2, -1)
    square = (y[:, None] - y) ** 2 + (x[:, None] - x) ** 2
    design = np.stack([np.ones(side * side), x, y], axis=1)
    residual = np.eye(side * side) - design @ np.linalg.pinv(design)
    part = y // 4 * 4 + x // 4
    parts = (part == np.arange(16)[:, None]) / 4.0
    table = correlation_table()
    for k in (0, 5, 20):
        together = table[-1, k]
        covariance = np.exp(-np.pi * square / together)
        scatter = np.trace(parts @ residual @ covariance @ residual @ parts.T) / 13.0
        left = np.trace(residual @ covariance) / (side * side - 3)
        np.testing.assert_allclose(table[:2, k], [scatter, left])


@pytest.mark.parametrize("shares", [(0.0, 0.0), (0.4, 0.0), (0.0, 0.3), (0.5, 0.2), (1.0, 0.0)])
def test_mixture_of_errors_is_found(shares):
    table = correlation_table()
    counts = np.full(SIZES, 10_000)
    for k in (8, 15, 22):
        a, b = shares
        made = (1.0 - a - b) + a * table[:, k] + b * table[:, 0]
        together = mixture(made[0:-1:2] / made[1:-1:2], counts, table)
        assert together == pytest.approx(made[-1], rel=0.05)


def test_shares_of_a_mixture_are_no_more_than_all(rng):
    """Also where ratios are those of no mixture: against all shares in steps of a hundredth."""
    table = correlation_table()
    a, b = (shares.ravel() for shares in np.meshgrid(*[np.linspace(0.0, 1.0, 101)] * 2))
    a, b = a[a + b <= 1.0], b[a + b <= 1.0]
    for _ in range(20):
        ratios, counts = rng.uniform(1.0, 30.0, SIZES), rng.integers(20, 500, SIZES)
        best = np.inf, 1.0
        for k in range(1, table.shape[1]):
            made = 1.0 + np.outer(table[:, k] - 1.0, a) + np.outer(table[:, 0] - 1.0, b)
            off = 1.0 - made[0:-1:2] / ratios[:, None] + made[1:-1:2] - 1.0
            error = counts / OF_ONE @ off**2 + np.log(made[-1])
            best = min(best, (error.min(), made[-1, error.argmin()]))
        assert mixture(ratios, counts, table) == pytest.approx(best[1], rel=0.05)


def test_a_models_slow_waves_are_in_the_covariance():
    # Errors that reach over 40 pixels: squares of 32 show little of them, a model that knows them says so. Without it
    # the mean squared error is four times the covariance.
    rng = np.random.default_rng(19)
    truth = np.array([0.1, 0.0, 0.6])
    pixels = 20.0  # over which noise is smoothed
    model = NoiseModel((1e-3,), correlation=((1.0, pixels * 2.0**0.5),))
    errors = []
    for _ in range(25):
        noise = gaussian_filter(rng.normal(size=CAMERA.shape), pixels)
        q = truth[0] * CAMERA.tan_x + truth[2] + 1e-3 * noise / noise.std()
        found = segment(1.0 / q, CAMERA, noise=model)
        assert len(found) == 1
        error = found.alpha[0] - truth
        errors.append(error @ np.linalg.solve(found.alpha_covariance[0], error) / 3.0)
    assert 0.4 < np.mean(errors) < 2.0


CORNER = np.array([[0.1, 0.9, 0.6], [0.7, -0.05, 0.55], [-0.4, 0.1, 0.5]])  # α of a floor and two walls
VGA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)


def corner_with(noise, camera, rng):
    """Inverse depth of a corner with the errors of a noise model, without its slow ones."""
    planes = CORNER @ np.stack([*np.broadcast_arrays(camera.tan_x, camera.tan_y), np.ones(camera.shape)]).swapaxes(0, 1)
    nearest, q = planes.argmax(axis=1), planes.max(axis=1)
    error = np.sqrt(1.0 - sum(share for share, _ in noise.correlation)) * rng.standard_normal(q.shape)
    for share, length in noise.correlation:
        smooth = gaussian_filter(rng.standard_normal(q.shape), length / 2.0**0.5, mode="wrap")
        error += share**0.5 * smooth / smooth.std()
    slope = np.hypot(CORNER[:, 0] / camera.fx, CORNER[:, 1] / camera.fy)[nearest]
    return q + noise.sigma(q) * error + noise.lateral * slope * rng.standard_normal(q.shape)


@pytest.mark.parametrize(
    "noise",
    [
        NoiseModel((1.4e-3,)),
        NoiseModel((2e-4,)),
        NoiseModel((0.0, 0.0, 2e-3)),
        NoiseModel((1.4e-3,), lateral=0.5),
        NoiseModel((1.4e-3,), spread=0.1),
        NoiseModel((1.4e-3,), correlation=((0.003, 4.0),)),
    ],
    ids=["constant", "small", "by depth", "lateral", "spread", "a little shared"],
)
def test_covariance_by_a_model_is_that_of_its_labels(noise, rng):
    # By what the frame alone shows, with a floor of 0.04 % of 1/Z, it would be up to three times as large.
    camera = replace(VGA, noise=noise)
    for _ in range(2):
        depth = 1.0 / corner_with(noise, camera, rng)
        found = segment(depth, camera)
        alike = maximum_filter(found.labels, 3) == minimum_filter(found.labels, 3)
        fits = fit_labels(depth, camera, np.where(alike, found.labels, 0), max_missing=1.0)
        assert len(found) == 3
        np.testing.assert_allclose(found.alpha, fits.alpha, atol=1e-7)
        for own, wanted in zip(found.alpha_covariance, fits.alpha_covariance, strict=True):
            ratio = np.linalg.eigvals(np.linalg.solve(wanted, own)).real
            assert np.abs(ratio - 1.0).max() < 0.1


@pytest.mark.parametrize("strip", [np.s_[200:280], np.s_[:, 280:360]], ids=["lying", "upright"])
def test_covariance_of_a_strip_is_no_less_than_what_a_model_of_correlated_errors_makes(strip, rng):
    """As `fit_labels` has it: along the strip and across it errors that reach far make different slopes uncertain."""
    noise = NoiseModel((1e-3,), floor=3.0, floor_length=80.0)
    camera = Camera(640, 480, 525.0, 400.0, 319.5, 239.5, noise=noise)
    depth = np.zeros(camera.shape)
    depth[strip] = (1.0 / (0.5 + 0.05 * camera.tan_x + 1e-3 * rng.standard_normal(camera.shape)))[strip]
    found = segment(depth, camera)
    inside = np.where(minimum_filter((found.labels == 1).astype(int), 3, mode="nearest"), 1, 0)
    fits = fit_labels(depth, camera, inside)
    wanted = fits.alpha_covariance[0]
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    np.testing.assert_allclose(found.alpha_covariance[0] / scale, wanted / scale, atol=0.05)


def test_covariance_of_a_small_plane_is_as_much_more_as_its_residual(rng):
    """Than what a model of errors that neighbours share expects of it."""
    camera = replace(CAMERA, noise=NoiseModel((1e-3,), correlation=((0.3, 2.0),)))
    patch, depth = np.s_[100:110, 150:160], np.zeros(CAMERA.shape)
    depth[patch] = 1.0 / (0.5 + 3e-3 * rng.standard_normal((10, 10)))
    found = segment(depth, camera)
    fits = fit_labels(depth, camera, found.labels)
    assert found.sizes.tolist() == [100]
    more = 100.0 * found.rmse[0] ** 2 / fits._pixels.shared[0, EXPECTED]
    assert more > 4.0
    np.testing.assert_allclose(found.alpha_covariance[0], more * fits.alpha_covariance[0], rtol=5e-3, atol=1e-12)


def test_covariance_by_an_exact_model_is_exact(rng):
    # The mean of 240 chi-squares over their three degrees of freedom: 1, with a standard deviation of 0.05.
    noise, errors = NoiseModel((1.4e-3,)), []
    for _ in range(80):
        found = segment(1.0 / corner_with(noise, CAMERA, rng), CAMERA, noise=noise)
        for alpha, covariance in zip(found.alpha, found.alpha_covariance, strict=True):
            error = alpha - CORNER[np.abs(CORNER - alpha).sum(axis=1).argmin()]
            errors.append(error @ np.linalg.solve(covariance, error) / 3.0)
    assert len(errors) == 240
    assert 0.85 < np.mean(errors) < 1.15


@pytest.mark.parametrize("pixels", [0.8, 1.5, 3.0])
def test_a_model_that_the_frame_contradicts_is_not_believed(pixels):
    # By this model, of independent errors, the mean squared error of α would be 5 to 100 times its covariance.
    rng, truth, errors = np.random.default_rng(21), np.array([0.1, 0.0, 0.6]), []
    for _ in range(15):
        noise = gaussian_filter(rng.standard_normal(CAMERA.shape), pixels)
        q = truth[0] * CAMERA.tan_x + truth[2] + 1e-3 * noise / noise.std()
        found = segment(1.0 / q, CAMERA, noise=NoiseModel((1e-3,)))
        error = found.alpha[0] - truth
        errors.append(error @ np.linalg.solve(found.alpha_covariance[0], error) / 3.0)
    assert 0.35 < np.mean(errors) < 1.7


def stairs():
    """Five steps, as seen from above."""
    faces = [scenes.polygon("floor", [(-2.0, 0.0, 0.3), (2.0, 0.0, 0.3), (2.0, 0.0, 1.5), (-2.0, 0.0, 1.5)])]
    for k in range(5):
        side, low, high, z, far = 0.6, -0.17 * k, -0.17 * (k + 1), 1.5 + 0.28 * k, 1.78 + 0.28 * k
        faces += [
            scenes.polygon("riser", [(-side, low, z), (side, low, z), (side, high, z), (-side, high, z)]),
            scenes.polygon("tread", [(-side, high, z), (side, high, z), (side, high, far), (-side, high, far)]),
        ]
    return scenes.Scene(faces, scenes.look_at((0.25, -1.5, 0.1), (0.0, -0.4, 2.0)))


@pytest.mark.parametrize(("pixels", "least", "most"), [(0.0, 1.0, 1.2), (0.8, 2.5, 4.5)])
def test_creases_are_no_errors_that_neighbours_share(pixels, least, most):
    # Half of the flat squares of 32 pixels have a crease in them. If these counted, one of the first three frames would
    # have standard deviations 1.6 times as large although its errors are independent.
    noise = NoiseModel((1.4e-3,))
    q = 1.0 / stairs().render(VGA).depth
    for seed in range(3):
        error = gaussian_filter(np.random.default_rng(seed).standard_normal(VGA.shape), pixels)
        depth = 1.0 / (q + 1.4e-3 * error / error.std())
        found = segment(depth, VGA, noise=noise)
        of_independent = fit_labels(depth, replace(VGA, noise=noise), found.labels).offset_std
        assert least < np.median(found.offset_std / of_independent) < most


def test_a_little_that_squares_show_may_be_chance():
    counts = np.array([100, 100, 20])
    assert may_be_chance(np.array([0.9, 1.0, 0.8]), counts)  # not even that
    assert may_be_chance(np.array([1.1, 1.1, 1.1]), counts)
    assert not may_be_chance(np.array([1.2, 1.2, 1.2]), counts)
    assert may_be_chance(np.array([1.2, 1.2, 1.2]), counts // 10)
    assert not may_be_chance(np.array([0.0, 1.3, 0.0]), np.array([0, 120, 0]))
    assert may_be_chance(np.zeros(3), np.zeros(3, int))  # no squares, no doubt


@pytest.mark.parametrize("place", [(4, 8), (19, 23), (12, 16)])
@pytest.mark.parametrize("other", [0, 2])
def test_a_square_is_in_one_plane_if_all_that_is_measured_of_it_is(place, other):
    label, inverse_depth = np.ones((24, 32), np.int32), np.ones((24, 32), np.float32)
    assert is_in_one(label, inverse_depth, 4, 8, 16)
    label[place] = other
    assert not is_in_one(label, inverse_depth, 4, 8, 16)
    inverse_depth[place] = 0.0
    assert is_in_one(label, inverse_depth, 4, 8, 16)
    assert not is_in_one(label, np.zeros_like(inverse_depth), 4, 8, 16)


def test_squares_that_are_not_in_one_plane_show_no_shared_errors():
    noise = gaussian_filter(np.random.default_rng(22).standard_normal(CAMERA.shape), 1.0)
    work, frame = Workspace(CAMERA), as_depth_frame(1.0 / (0.5 + 1e-2 * noise), CAMERA)
    read_frame(*frame.values, rays_of(CAMERA), work.inverse_depth, work.pyramid)
    one = np.ones(CAMERA.shape, np.int32)
    stripes = one + (np.arange(CAMERA.width, dtype=np.int32) // 4) % 2
    for label, expected in ((one, 3.0), (0 * one, 1.0), (stripes, 1.0)):
        assert shared_by_planes(3.0, work.pyramid, label, work.inverse_depth) == expected
    one[np.random.default_rng(23).random(CAMERA.shape) < 0.3] = 0
    assert shared_by_planes(3.0, work.pyramid, one, work.inverse_depth) == 1.0
    work.inverse_depth[one == 0] = 0.0  # missing pixels are no edge
    assert shared_by_planes(3.0, work.pyramid, one, work.inverse_depth) == 3.0


def test_plane_covariance_is_that_of_alpha_carried_over(room):
    found = segment(room[1], CAMERA)

    def plane(alpha):
        return np.append(-alpha, 1.0) / np.linalg.norm(alpha)

    assert len(found) > 10
    for i, alpha in enumerate(found.alpha):
        np.testing.assert_allclose(plane(alpha), found.planes[i], rtol=1e-12, atol=1e-12)
        steps = 1e-6 * np.eye(3)
        slope = np.array([plane(alpha + step) - plane(alpha - step) for step in steps]).T / 2e-6
        expected = slope @ found.alpha_covariance[i] @ slope.T
        np.testing.assert_allclose(found.plane_covariance[i], expected, atol=1e-6 * expected.max())


def test_covariance_is_honest_although_edges_are_shared():
    rendering = scenes.room().render(CAMERA)
    normalised = []  # squared errors of α in its covariance: χ²(3), whose median is 2.37
    for seed in range(5):
        depth = rendering.measure(holes=0.05, seed=seed)
        found = segment(depth, CAMERA)
        truth = np.where(depth > 0, rendering.labels, 0)
        for true, own in compare_labels(found.labels, truth).detection(0.75).pairs - 1:
            error = found.alpha[own] + rendering.planes[true, :3] / rendering.planes[true, 3]
            normalised.append(error @ np.linalg.solve(found.alpha_covariance[own], error))
    assert np.median(normalised) < 3.0


def of_independent_pixels(sigma):
    """Covariance of α of the whole image, by NumPy."""
    rays = np.stack([*np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y), np.ones(CAMERA.shape)]).reshape(3, -1)
    return sigma**2 * np.linalg.inv(rays @ rays.T)


@pytest.mark.parametrize(("measured", "off"), [(0.0, 0.4), (3e-4, 0.15), (2e-3, 0.15)])
def test_the_residual_or_the_noise_counts_whichever_is_larger(measured, off, rng):
    q = 0.5 + 0.05 * CAMERA.tan_x + measured * rng.standard_normal(CAMERA.shape)
    found = segment(1.0 / q, CAMERA, noise=1e-3)
    wanted = of_independent_pixels(max(measured, 1e-3))
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    np.testing.assert_allclose(found.alpha_covariance[0] / scale, wanted / scale, atol=off)


def test_one_square_of_outliers_says_little_of_where_a_plane_is_noisier(rng):
    # They are none of its pixels, which lie all around them. By all that they are off, the slopes' variances would be
    # two and a half times as large.
    q = 0.5 + 0.05 * CAMERA.tan_x + 1e-3 * rng.standard_normal(CAMERA.shape)
    q[9:15, 9:15] = 2.0
    found = segment(1.0 / q, CAMERA)
    corners = found.labels[8:16:7, 8:16:7]
    assert (corners == 1).all()
    assert not found.labels[10:14, 10:14].any()
    np.testing.assert_allclose(np.diag(found.alpha_covariance[0]), np.diag(of_independent_pixels(1e-3)), rtol=0.3)


def mean_weights(on, sigma, rng):
    """(5,): what `weigh_rays` makes of a plane with these pixels and this noise, the mean of eight frames."""
    u, v = np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y)
    work, all_weighted = Workspace(CAMERA), np.empty((8, 1, 5))
    for weighted in all_weighted:
        q = 0.5 + 0.05 * u + sigma * rng.standard_normal(CAMERA.shape)
        frame = as_depth_frame(1.0 / q, CAMERA)
        read_frame(*frame.values, rays_of(CAMERA), work.inverse_depth, work.pyramid)
        rows = np.stack([np.ones(on.sum()), u[on], v[on], q[on]])
        moments = (rows @ rows.T)[np.triu_indices(4)]
        alpha, rss, *_ = np.linalg.lstsq(rows[[1, 2, 0]].T, q[on])
        weigh_rays(on.astype(np.int32), work.pyramid, moments[None], alpha[None], rss, weighted)
    return all_weighted.mean(axis=(0, 1))


def test_rays_are_weighed_up_to_the_edges(rng):
    # Whole squares do not reach an oblique edge: by theirs alone, this triangle's mean ray would be off by 0.013.
    u, v = np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y)
    on = np.abs(u) < 0.6 * (v + 0.45)
    wanted = [of[on].mean() for of in (u, v, u * u, u * v, v * v)]  # the noise is the same everywhere
    np.testing.assert_allclose(mean_weights(on, 1e-3, rng), wanted, atol=2e-3)


def test_rims_that_are_rougher_than_the_squares_count_more(rng):
    # By weights that only tell the squares from each other, the variance of the slope across this strip would be 0.70
    # of what it is; by equal ones 0.64.
    row, column = np.indices(CAMERA.shape)
    away = np.abs(row - 120.0 - 0.35 * (column - 160.0))
    on, sigma = away < 12.0, np.where(away > 8.0, 2e-3, 1e-3)
    u, v = np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y)
    rays = np.stack([u[on], v[on], np.ones(on.sum())])
    inverse = np.linalg.inv(rays @ rays.T)
    wanted = inverse @ (rays * sigma[on] ** 2) @ rays.T @ inverse / np.mean(sigma[on] ** 2)
    x, y, xx, xy, yy = mean_weights(on, sigma, rng)
    made = on.sum() * inverse @ [[xx, xy, x], [xy, yy, y], [x, y, 1.0]] @ inverse
    ratio = np.linalg.eigvals(np.linalg.solve(wanted, made)).real
    assert 0.82 < ratio.min() < ratio.max() < 1.1


@pytest.mark.parametrize("noise", [1e-6, 1e-5])
def test_a_picture_frame_has_a_covariance(noise):
    """Its left side alone contains squares of 8 pixels, and its rims are rounder than they: what the squares show of
    errors here and there is no more than chance, and says nothing of the other sides."""
    camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    row, column = np.indices(camera.shape)
    beyond = np.maximum(np.abs(row - 227.5) - 186.5, np.abs(column - 285.5) - 208.5)  # of its outer edge
    is_frame = (beyond <= 0.0) & (beyond > -14.0)
    is_rim = is_frame & (np.abs(beyond + 6.5) > 4.0)
    q = 1.0 / np.where(is_frame, 1.0 / 0.3 - 0.05, 1.0 / 0.3) + np.where(is_rim, 1e-4, 0.0)
    found = segment(1.0 / (q + np.random.default_rng(0).normal(0.0, noise, q.shape)), camera)
    frame = found.labels[220, 84] - 1
    assert found.sizes[frame] == np.count_nonzero(is_frame)
    smallest, _, largest = np.linalg.eigvalsh(found.alpha_covariance[frame])
    moments = np.array([camera.tan_x[is_frame], camera.tan_y[is_frame], np.ones(found.sizes[frame])])
    of_equals = np.linalg.eigvalsh(np.linalg.inv(moments @ moments.T))
    assert smallest / largest == pytest.approx(of_equals[0] / of_equals[2], rel=0.1)
    assert np.isfinite(found.offset_std).all()
