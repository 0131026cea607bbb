"""Cameras, depth frames with holes, and the comparison with the oracle, for tests of fits."""

import numpy as np
import oracle

import rgbd_planes as rp
from rgbd_planes.fitting.methods import METHODS as METHODS

HEIGHT, WIDTH = 48, 64

DISTORTIONS = {
    "pinhole": (),
    "five": (0.26, -0.95, -0.005, 0.003, 1.16),
    "eight": (0.55, -0.02, 2e-5, -7e-5, -0.003, 0.89, 0.09, -0.014),
}


def make_camera(distortion=(), width=WIDTH, height=HEIGHT, **options):
    options = {"depth_scale": 1000.0} | options
    return rp.Camera(width, height, 52.0, -51.0, 0.45 * width, 0.55 * height, distortion, **options)


def make_depth(camera, rng, noise=2e-3):
    """A wall, a floor and a ramp, with noise constant in inverse depth: metres, float64."""
    x, y = camera.tan_x, camera.tan_y
    q = np.maximum(np.maximum(0.4 + 0.1 * x, 0.05 - 0.6 * y), 0.3 + 0.5 * x - 0.2 * y)
    return 1.0 / (q + noise * rng.standard_normal(q.shape))


def make_holes(depth, kind, rng):
    """The depth with missing pixels; "tiles" also leaves some tiles one, two or three pixels, or a row."""
    depth = depth.copy()
    if kind == "tiles":
        depth[:16, :20] = 0
        depth[16:32, 20:52] = 0
        depth[17, 22] = depth[20, 30] = depth[20, 37] = depth[29, 33] = 1.5
        depth[18, 40:50] = 2.0
        depth[rng.random(depth.shape) < 0.1] = 0
    else:
        depth[rng.random(depth.shape) < {"none": 0.0, "some": 0.05, "most": 0.6}[kind]] = 0
    return depth


# A number is read in the same way whichever the lens, so not every pair is compiled.
DTYPES_BY_LENS = [
    *(("pinhole", dtype) for dtype in ("uint16", "float32", "float64")),
    *((lens, "uint16") for lens in DISTORTIONS if lens != "pinhole"),
]


def as_dtype(metres, dtype):
    return np.round(metres * 1000).astype(dtype) if dtype == "uint16" else metres.astype(dtype)


# Residuals come from moments, so a residual far below the data's own size is rounding: of the tile's spread
# for "direct", of its depth for "naive", of sums over the whole frame for "integral".
RMSE_FLOOR = {"direct": 2e-7, "naive": 1e-6, "integral": 5e-6}


# So is what the data may change by in a problem that counts as well posed, see `oracle.fit`.
CHANGE = {"direct": 1e-12, "naive": 1e-11, "integral": 1e-11}


def assert_equals_oracle(fits, expected, *, rmse_floor, chosen=slice(None)):
    """Planes equal where the problem is well posed, counts everywhere, and statuses but on the verge of a line."""
    status = fits.status.ravel()[chosen]
    wanted = np.array([plane.status for plane in expected], int)
    # What hardly determines a plane may be lost to rounding: five pixels of a row that distortion bends a little.
    verge = np.array([plane.status in (oracle.OK, oracle.ROUGH) and not plane.well_posed for plane in expected], bool)
    np.testing.assert_array_equal(status, np.where(verge & (status == oracle.DEGENERATE), status, wanted))
    np.testing.assert_array_equal(fits.valid_count.ravel()[chosen], [plane.count for plane in expected])
    planes = fits.planes.reshape(-1, 4)[chosen]
    alpha = fits.alpha.reshape(-1, 3)[chosen]
    rmse, rmse_metric = fits.rmse.ravel()[chosen], fits.rmse_metric.ravel()[chosen]
    no_plane = ~fits.fitted.ravel()[chosen]
    for name, values in {"plane": planes, "alpha": alpha, "rmse": rmse, "rmse_metric": rmse_metric}.items():
        assert np.isnan(values[no_plane]).all(), name
        assert np.isfinite(values[~no_plane]).all(), name
    compared = 0
    for i, plane in enumerate(expected):
        if not np.isfinite(plane.plane[3]) or not plane.well_posed:
            continue
        compared += 1
        wanted = oracle.orient(plane.plane)
        assert oracle.angle(planes[i, :3], wanted[:3]) < 1e-7
        assert abs(planes[i, 3] - wanted[3]) < 0.05 * rmse_floor * wanted[3]
        np.testing.assert_allclose(rmse[i], plane.rmse, rtol=1e-6, atol=rmse_floor)
        np.testing.assert_allclose(rmse_metric[i], plane.rmse_metric, rtol=1e-6, atol=rmse_floor)
        np.testing.assert_allclose(alpha[i], -wanted[:3] / wanted[3], rtol=1e-6, atol=1e-6)
    return compared
