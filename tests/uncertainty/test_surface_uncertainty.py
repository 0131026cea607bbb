"""What noise does to surfaces, simulated: standard deviations, and flat tiles that are called curved."""

from dataclasses import replace

import numpy as np
import pytest
from curved_frames import ball, inverse_depth_of_quadric, rays_of
from scipy.ndimage import gaussian_filter

import rgbd_planes as rp

SIGMA = rp.noise.KINECT_V1


def correlated(shape, length, rng):
    """Errors of variance 1 whose correlation at a distance r is exp(-r²/(2·length²))."""
    width = length / np.sqrt(2.0)
    around = int(4 * length) + 1
    white = rng.standard_normal((shape[0] + 2 * around, shape[1] + 2 * around))
    smooth = gaussian_filter(white, width)[around:-around, around:-around]
    return smooth * np.sqrt(4.0 * np.pi) * width


def errors_of(model, shape, rng):
    made = np.sqrt(model._white) * rng.standard_normal(shape)
    for share, length in model.correlation:
        made += np.sqrt(share) * correlated(shape, length, rng)
    return SIGMA * (made + model.floor * correlated(shape, model.floor_length, rng))


def test_curvature_of_a_ball_errs_as_much_as_it_says(rng):
    camera = rp.Camera(20, 20, 525.0, 525.0, 9.5, 9.5, noise=rp.noise.kinect_v1())
    q = inverse_depth_of_quadric(rays_of(camera), *ball((0.0, 0.0, 1.5), 0.3))
    fitter, mean, gaussian, stds = rp.SurfaceFitter(camera, 20, num_threads=1), [], [], []
    for _ in range(1500):
        found = fitter.fit(1.0 / (q + SIGMA * rng.standard_normal(q.shape)))
        mean.append(found.mean_curvature[0, 0])
        gaussian.append(found.gaussian_curvature[0, 0])
        stds.append((found.mean_curvature_std[0, 0], found.gaussian_curvature_std[0, 0]))
    assert abs(np.mean(mean) - 1.0 / 0.3) < 0.05 + 3.0 * np.std(mean) / np.sqrt(len(mean))
    predicted = np.sqrt(np.mean(np.square(stds), axis=0))
    assert 0.94 < predicted[0] / np.std(mean) < 1.06  # 1500 runs know it to 2 %
    assert 0.92 < predicted[1] / np.std(gaussian) < 1.08


@pytest.mark.parametrize(("correlation", "floor"), [((), 0.0), (((0.5, 2.0),), 0.5)])
def test_flat_tiles_are_called_curved_as_often_as_the_level_says(correlation, floor, rng):
    model = replace(rp.noise.kinect_v1(), correlation=correlation, floor=floor)
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, noise=model)
    plane = 0.5 + 0.1 * camera.tan_x - 0.1 * camera.tan_y
    fitter, p_flat, mean, std = rp.SurfaceFitter(camera, 20), [], [], []
    for _ in range(5):
        found = fitter.fit(1.0 / (plane + errors_of(model, plane.shape, rng)))
        p_flat.append(found.p_flat)
        mean.append(found.mean_curvature)
        std.append(found.mean_curvature_std)
    assert 0.006 < np.mean(np.array(p_flat) < 0.01) < 0.015  # of 3840 tiles
    assert 0.16 < np.mean(np.array(p_flat) < 0.2) < 0.24
    assert 0.95 < np.sqrt(np.mean(np.square(std))) / np.std(mean) < 1.06


def test_holes_make_curvature_less_certain_and_no_less_than_it_is(rng):
    model = replace(rp.noise.kinect_v1(), correlation=((0.5, 2.0),))
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, noise=model)
    depth = 1.0 / (0.5 + 0.1 * camera.tan_x + errors_of(model, camera.shape, rng))
    whole = rp.fit_surfaces(depth, camera, 20)
    depth[rng.random(depth.shape) < 0.3] = 0.0
    some = rp.fit_surfaces(depth, camera, 20)
    assert (some.mean_curvature_std > whole.mean_curvature_std).mean() > 0.9
    assert np.std(some.mean_curvature) < 1.05 * np.sqrt(np.mean(some.mean_curvature_std**2))
    assert np.isfinite(some.coefficient_covariance).all()
    assert np.linalg.eigvalsh(some.coefficient_covariance[0, 0] * 1e-6).min() > -1e-12
