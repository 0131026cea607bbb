"""The paper's noise model per pixel, against its formula and against noise drawn by the scenes."""

from dataclasses import replace

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes.evaluation import scenes


@pytest.fixture
def camera():
    return rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0)


def test_paper_figures(camera):
    """The paper's eq. 2: sigma_Z = 1.425e-3 Z², and X and Y about half of it at the image's periphery."""
    sigma = rp.measurement_noise(np.full((480, 640), 2000, np.uint16), camera.with_noise(rp.noise.kinect_v1()))
    assert sigma.shape == (480, 640, 3)
    np.testing.assert_allclose(sigma[..., 2], 1.425e-3 * 4.0)
    np.testing.assert_allclose(sigma[10, 20, 0], abs(20 - 319.5) / 525.0 * 1.425e-3 * 4.0)
    np.testing.assert_allclose(sigma[10, 20, 1], abs(10 - 239.5) / 525.0 * 1.425e-3 * 4.0)
    assert 0.4 < sigma[240, 0, 0] / sigma[240, 0, 2] < 0.65
    assert (sigma >= 0).all()


def test_predicts_the_spread_of_measured_points(camera):
    rendering = scenes.plane((0.4, 0.1, -1.0), 2.5).render(camera)
    points = []
    for seed in range(40):
        z = rendering.measure(seed=seed, quantise=False)
        points.append(np.stack([z * camera.tan_x, z * camera.tan_y, z], axis=-1))
    predicted = rp.measurement_noise(rendering.depth, camera.with_noise(rp.noise.kinect_v1()))
    ratio = np.std(points, axis=0, ddof=1) / predicted
    assert np.median(ratio[..., 2]) == pytest.approx(1.0, abs=0.02)
    assert np.median(ratio[..., 0]) == pytest.approx(1.0, abs=0.02)


def test_missing_is_nan_and_coefficient_scales(camera):
    depth = np.full((480, 640), 1.5)
    depth[3, 4] = 0.0
    sigma = rp.measurement_noise(depth, camera, 2.85e-3)
    assert np.isnan(sigma[3, 4]).all()
    assert np.isfinite(np.delete(sigma.reshape(-1, 3), 3 * 640 + 4, axis=0)).all()
    np.testing.assert_allclose(sigma[0, 0], 2.0 * rp.measurement_noise(depth, camera, 1.425e-3)[0, 0])
    assert (rp.measurement_noise(depth, camera, 0.0)[0, 0] == 0.0).all()


def test_the_noise_of_the_camera_is_taken_unless_another_is_given(camera):
    def sigma(q):
        assert (q > 0.0).all()  # a user's function need not know missing pixels
        return 1e-3 * q

    depth = np.linspace(0.5, 4.0, 640 * 480).reshape(480, 640)
    depth[3, 4] = np.nan
    noisy = replace(camera, noise=rp.noise.function(sigma))
    made = rp.measurement_noise(depth, noisy)
    np.testing.assert_allclose(made[..., 2], 1e-3 * depth)  # σ_Z = σ_q·Z²
    np.testing.assert_allclose(made[..., 0], np.abs(camera.tan_x) * 1e-3 * depth)
    np.testing.assert_allclose(rp.measurement_noise(depth, noisy, 2e-3)[..., 2], 2e-3 * depth**2)


@pytest.mark.parametrize("sigma", [-1.0, np.nan, np.inf])
def test_bad_sigma_is_refused(camera, sigma):
    with pytest.raises(ValueError, match="sigma_inverse_depth must be 0 or more"):
        rp.measurement_noise(np.ones((480, 640)), camera, sigma)


def test_a_camera_without_noise_is_doubted(camera):
    depth = np.full((480, 640), 1.5)
    with pytest.warns(UserWarning, match="a Kinect v1's noise is taken"):
        sigma = rp.measurement_noise(depth, camera)
    np.testing.assert_array_equal(sigma, rp.measurement_noise(depth, camera, rp.noise.KINECT_V1))
