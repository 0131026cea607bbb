"""Segmentation: what a frame with known planes gives, and that no frame breaks it."""

import signal
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from processes import printed_by
from segment_frames import CAMERA, inside, two_planes

from bench.segmentation import empty_room
from rgbd_planes import Camera, fit_tiles, segment
from rgbd_planes._core.status import Reason
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels, plane_errors
from rgbd_planes.noise import kinect_v1
from rgbd_planes.segmentation.workspace import Workspace, rays_of


@pytest.mark.parametrize("distortion", [(), (0.1, -0.05, 0.001, -0.001, 0.01)])
def test_empty_room_with_holes(distortion):
    camera = Camera(**{**CAMERA.to_dict(), "distortion": distortion})
    rendering = empty_room().render(camera)
    depth = rendering.measure(holes=0.05, seed=4)
    found = segment(depth, camera)
    assert len(found) == 6
    scores = compare_labels(found.labels, np.where(depth > 0, rendering.labels, 0)).detection(0.9)
    assert scores.recall == 1.0
    assert scores.matched_iou > 0.99
    truth, own = scores.pairs.T
    errors = plane_errors(found.planes[own - 1], rendering.planes[truth - 1])
    assert errors.angle_deg.max() < 0.3
    assert np.abs(errors.offset).max() < 0.005


def test_empty_room_in_the_circular_image_of_a_fisheye():
    # Walls, floor and ceiling meet in curves; in metres, since at 85 degrees a millimetre is much.
    camera = Camera(480, 480, 155.0, 155.0, 239.5, 239.5, distortion_model="fisheye")
    rendering = empty_room().render(camera)
    depth = rendering.measure(holes=0.05, quantise=False, seed=4)
    found = segment(depth, camera)
    scores = compare_labels(found.labels, np.where(depth > 0, rendering.labels, 0)).detection(0.9)
    assert scores.recall == scores.precision == 1.0
    truth, own = scores.pairs.T
    assert plane_errors(found.planes[own - 1], rendering.planes[truth - 1]).angle_deg.max() < 0.3


def test_furnished_room_with_holes(room):
    # 24 planes, five of them under 200 pixels.
    rendering, depth = room
    found = segment(depth, CAMERA)
    scores = compare_labels(found.labels, np.where(depth > 0, rendering.labels, 0)).detection(0.75)
    assert scores.recall > 0.75
    assert scores.precision > 0.9
    assert scores.matched_iou > 0.94


def test_planes_are_the_least_squares_fit_of_their_pixels():
    rng = np.random.default_rng(5)
    q, _ = two_planes(CAMERA, 0.05)
    depth = 1.0 / (q + rng.normal(0.0, 1e-3, q.shape))
    found = segment(depth, CAMERA)
    assert len(found) == 2
    for label in (1, 2):
        own = inside(found.labels, found.reason != Reason.MISSING) & (found.labels == label)
        rays = np.column_stack([CAMERA.tan_x[own], CAMERA.tan_y[own], np.ones(own.sum())])
        alpha, *_ = np.linalg.lstsq(rays, 1.0 / depth[own], rcond=None)
        assert found.alpha[label - 1] == pytest.approx(alpha, rel=1e-3, abs=1e-4)
    assert np.linalg.norm(found.planes[:, :3], axis=1) == pytest.approx(1.0)
    assert (found.planes[:, 3] > 0).all()
    assert found.fitted_inverse_depth()[found.labels == 1].mean() == pytest.approx(1.0, abs=1e-4)
    assert found.rmse == pytest.approx(1e-3, rel=0.02)
    assert found.sizes.tolist() == [np.count_nonzero(found.labels == label) for label in (1, 2)]


def test_labels_are_in_the_order_of_their_first_pixels():
    q = np.where(np.arange(CAMERA.width) < 160, 0.5, 0.7) + np.zeros(CAMERA.shape)
    depth = 1.0 / q
    depth[0, :160] = 0.0  # the first blocks on the left begin in the next row
    labels = segment(depth, CAMERA).labels
    assert (labels[1:, :160] == 2).all()
    assert (labels[:, 160:] == 1).all()


def test_small_planes_and_the_reason_why_not():
    rng = np.random.default_rng(9)
    q = np.full(CAMERA.shape, 0.5)
    q[100:112, 100:112] = 0.6
    depth = 1.0 / (q + rng.normal(0.0, 1e-3, q.shape))
    assert segment(depth, CAMERA, min_size=100).sizes.tolist() == [q.size - 144, 144]
    found = segment(depth, CAMERA, min_size=200)
    assert len(found) == 1
    assert np.isin(found.reason[102:110, 102:110], [Reason.SMALL, Reason.UNCLAIMED]).all()


@pytest.mark.parametrize("least", [150, 600, 3000])
def test_a_larger_least_size_leaves_out_small_planes_and_changes_no_others(room, least):
    _, depth = room
    everything, large = segment(depth, CAMERA), segment(depth, CAMERA, min_size=least)
    stays = everything.sizes >= least
    assert 0 < np.count_nonzero(stays) < len(everything)
    assert len(large) == np.count_nonzero(stays)
    np.testing.assert_array_equal(large.planes, everything.planes[stays])
    np.testing.assert_array_equal(large.plane_covariance, everything.plane_covariance[stays])
    left = np.concatenate([[0], np.where(stays, np.cumsum(stays), 0)])[everything.labels]
    assert np.mean(large.labels != left) < 1e-3  # pixels that stand alone
    dropped = (everything.labels > 0) & (left == 0) & (large.labels == 0)
    assert np.mean(large.reason[dropped] == Reason.SMALL) > 0.99


def odd_frames():
    rng = np.random.default_rng(11)
    yield "empty", np.zeros((240, 320), np.uint16), 0
    yield "sentinel", np.full((240, 320), 65535, np.uint16), 0
    yield "flat", np.full((240, 320), 1500, np.uint16), 1
    yield "flat metres", np.full((240, 320), 1.5), 1
    yield "one row", np.where(np.arange(240)[:, None] == 100, 1.5, 0.0) * np.ones((1, 320)), 0
    yield "one pixel", np.where(np.arange(320 * 240).reshape(240, 320) == 9000, 2.0, 0.0), 0
    yield "not a number", np.full((240, 320), np.nan), 0
    yield "all noise", rng.integers(500, 6000, (240, 320)).astype(np.uint16), 0
    yield "all noise, very near, too", rng.integers(1, 65535, (240, 320)).astype(np.uint16), 0
    yield "all noise, metres", np.exp(rng.normal(size=(240, 320))), 0
    yield "single tilted", 1.0 / (0.5 + 0.2 * CAMERA.tan_x + 0.1 * CAMERA.tan_y), 1


@pytest.mark.parametrize(
    ("depth", "planes"), [(d, n) for _, d, n in odd_frames()], ids=[name for name, *_ in odd_frames()]
)
def test_odd_frames_give_an_answer(depth, planes):
    camera = CAMERA
    if depth.max() == 65535:
        camera = Camera(**{**CAMERA.to_dict(), "invalid_values": (65535,)})
    found = segment(depth, camera)
    assert len(found) == planes
    assert np.isfinite(found.planes).all()
    assert found.labels.dtype == np.int32
    assert found.labels.max() == len(found)


@pytest.mark.parametrize("size", [(16, 16), (3, 3), (1, 1), (5, 200), (237, 319)])
def test_any_size(size):
    height, width = size
    camera = Camera(width=width, height=height, fx=300.0, fy=-300.0, cx=width / 2, cy=height / 2)
    depth = np.full((height, width), 1.25, np.float32)
    found = segment(depth, camera)
    assert found.labels.shape == size
    if height >= 16:
        assert (found.labels == 1).all()
        assert found.planes[0] == pytest.approx([0.0, 0.0, -1.0, 1.25], abs=1e-6)


@pytest.mark.parametrize("model", ["brown_conrady", "fisheye"])
def test_one_pixel_on_the_axis_of_a_lens(model):
    camera = Camera(1, 1, 5.0, 5.0, 0.0, 0.0, distortion=(0.1, -0.2, 0.001, -0.002, 0.05))
    if model == "fisheye":
        camera = Camera(1, 1, 5.0, 5.0, 0.0, 0.0, distortion=(0.1, -0.02, 0.0, 0.0), distortion_model="fisheye")
    assert len(segment(np.ones((1, 1)), camera)) == 0


@pytest.mark.filterwarnings("ignore:many pixels are 65535", "ignore:c[xy] =:UserWarning", "ignore:with a depth_scale")
@settings(max_examples=60)
@given(
    depth=arrays(
        np.uint16,
        st.tuples(st.integers(1, 40), st.integers(1, 40)),
        elements=st.sampled_from([0, 1, 700, 1000, 1001, 1004, 1400, 65535]),
    ),
    min_size=st.integers(3, 80),
)
def test_any_frame_gives_consistent_numbers(depth, min_size):
    height, width = depth.shape
    camera = Camera(width=width, height=height, fx=40.0, fy=-50.0, cx=3.0, cy=20.0, depth_scale=1000.0)
    found = segment(depth, camera, min_size=min_size)
    assert np.bincount(found.labels.ravel(), minlength=len(found) + 1)[1:].tolist() == found.sizes.tolist()
    assert ((found.reason == Reason.PLANE) == (found.labels > 0)).all()
    assert ((found.reason == Reason.MISSING) == (depth == 0)).all()
    for name in ("planes", "alpha", "alpha_covariance", "rmse"):
        assert np.isfinite(getattr(found, name)).all()
    assert (found.planes[:, 3] > 0).all()


def test_same_bits_every_time(room):
    _, depth = room
    first, second = segment(depth, CAMERA), segment(depth, CAMERA)
    for name in ("labels", "planes", "alpha_covariance", "rmse", "reason"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_a_frame_leaves_nothing_behind_for_the_next(room):
    # The arrays to work in are kept: what is measured in one frame may be missing in the next, and the other way.
    _, depth = room
    half = depth.copy()
    half[:, : CAMERA.width // 2] = 0
    first = segment(depth, CAMERA)
    segment(half, CAMERA)
    again = segment(depth, CAMERA)
    assert (again.labels == first.labels).all()
    assert (again.reason == first.reason).all()
    assert (again.alpha == first.alpha).all()
    segment(depth[::-1], CAMERA)
    after = segment(half, CAMERA)
    assert ((after.reason == Reason.MISSING) == (half == 0)).all()


def test_large_arrays_begin_with_a_line_of_the_cache(room):
    """For whole vectors: the processor reads one that lies in two lines as two."""
    found = segment(room[1], CAMERA)
    work = Workspace(CAMERA)
    statistics = fit_tiles(room[1], replace(CAMERA, noise=kinect_v1()), tile=16)._statistics
    for values in (found.labels, found.reason, work.inverse_depth, work.pyramid.moments, statistics.rows):
        assert values.ctypes.data % 64 == 0
        assert values.flags.c_contiguous
        assert values.flags.writeable


@pytest.mark.parametrize("degrees", [30.0, 90.0])
def test_a_camera_that_is_rolled_sees_the_same_planes(room, monkeypatch, degrees):
    """Rays that depend on both row and column, by far more than any lens's do."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))

    def rolled(camera):
        rays = rays_of(camera)
        x, y = np.broadcast_arrays(rays.tan_x, rays.tan_y)
        u, v = np.broadcast_arrays(rays.centre_u, rays.centre_v)
        return rays._replace(
            tan_x=cosine * x - sine * y, tan_y=sine * x + cosine * y,
            centre_u=cosine * u - sine * v, centre_v=sine * u + cosine * v,
        )  # fmt: skip

    _, depth = room
    upright = segment(depth, CAMERA)
    monkeypatch.setattr("rgbd_planes.segmentation.segment.rays_of", rolled)
    tilted = segment(depth, CAMERA)
    assert (tilted.labels == upright.labels).mean() > 0.9999
    assert tilted.sizes == pytest.approx(upright.sizes, abs=3)
    assert tilted.alpha[:, 2] == pytest.approx(upright.alpha[:, 2], rel=1e-4)


def test_rays_of_every_pixel_do_as_rays_of_rows_and_columns(room):
    # Next to no distortion: another way through the kernels to the same planes.
    _, depth = room
    camera = Camera(**{**CAMERA.to_dict(), "distortion": (1e-9, 0.0, 0.0, 0.0)})
    assert camera.is_distorted
    bent, straight = segment(depth, camera), segment(depth, CAMERA)
    assert len(bent) == len(straight)
    assert (bent.labels == straight.labels).mean() > 0.999
    assert bent.alpha == pytest.approx(straight.alpha, abs=1e-3)


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.int32, np.uint32, np.int64, ">u2"])
def test_integers_of_any_kind_are_rounded(kind):
    # In steps of two centimetres and hardly any noise: what rounding makes counts, whatever holds the integers.
    camera = replace(CAMERA, depth_scale=50.0)
    depth = scenes.room().render(camera).measure(noise=1e-4)
    expected, found = segment(depth, camera), segment(depth.astype(kind), camera)
    np.testing.assert_array_equal(found.labels, expected.labels)
    np.testing.assert_array_equal(found.planes, expected.planes)


@pytest.mark.parametrize(("width", "height", "least"), [(160, 120, 12), (80, 60, 5)])
def test_where_the_squares_of_a_small_frame_fall_costs_no_planes(width, height, least):
    # Nearly all of its squares of 32, or of 16, pixels lie across an edge, which is no noise that grows.
    focal = 0.82 * width
    for pad in (0, 1, 2, 3):
        camera = Camera(width + pad, height + pad, focal, focal, width / 2 - 0.5 + pad, height / 2 - 0.5 + pad)
        rendering = scenes.room().render(camera)
        depth = rendering.measure(quantise=False)
        depth[:pad] = depth[:, :pad] = np.nan
        assert compare_labels(segment(depth, camera).labels, rendering.labels).hoover(0.8).correct >= least


def test_a_row_of_pixels_is_no_plane():
    # Of every three rows one is measured: they are apart, and none of them determines a plane.
    depth = scenes.room().render(CAMERA).measure(quantise=False)
    depth[np.arange(CAMERA.height) % 3 != 0] = np.nan
    found = segment(depth, CAMERA)
    assert np.isfinite(found.planes).all()
    for label in range(1, len(found) + 1):
        assert len(np.unique(np.nonzero(found.labels == label)[0])) > 1


def test_small_things_all_over_a_large_frame_are_planes():
    # Like a chessboard, each field tilted another way: hardly a square of 32 pixels is within one.
    camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    row, column = np.indices(camera.shape) // 44
    field = row * 15 + column
    rng = np.random.default_rng(22)
    height, tilt = rng.uniform(0.4, 0.6, field.max() + 1), rng.uniform(-1.0, 1.0, (2, field.max() + 1))
    x, y = (np.indices(camera.shape)[::-1] % 44 - 21.5) / 525.0
    q = height[field] + tilt[0][field] * x + tilt[1][field] * y + rng.normal(0.0, 1e-3, camera.shape)
    found = segment(1.0 / q, camera)
    assert compare_labels(found.labels, field + 1).hoover(0.8).correct > 0.85 * field.max()


def test_segmenting_while_segmenting(room):
    """As what handles a signal may do; a noise function, here."""

    def sigma(q):
        return np.full_like(q, 1.4e-3)

    def sigma_of_another(q):
        segment(np.full(CAMERA.shape, 2000, np.uint16), replace(CAMERA, depth_scale=1000.0))
        return sigma(q)

    one, other = (segment(room[1], CAMERA, noise=noise) for noise in (sigma, sigma_of_another))
    np.testing.assert_array_equal(one.labels, other.labels)
    np.testing.assert_array_equal(one.planes, other.planes)


def test_share_and_residual_in_metres_are_those_of_the_pixels():
    q, _ = two_planes(CAMERA, 0.05)
    depth = 1.0 / (q + np.random.default_rng(6).normal(0.0, 1e-3, q.shape))
    depth[60:180, 100:140] = np.nan
    depth[20:30, 20:30] = 0.4  # a speck, which is no plane
    depth[22:28:2, 22:28] = 0.7
    found = segment(depth, CAMERA, min_size=120)
    measured = np.isfinite(depth)
    assert found.share == np.count_nonzero(found.labels[measured]) / measured.sum() < 1.0
    z = np.where(measured, depth, 0.0)
    points = np.stack([CAMERA.tan_x * z, CAMERA.tan_y * z, z], axis=-1)
    for label, plane in enumerate(found.planes, start=1):
        own = inside(found.labels, found.reason != Reason.MISSING) & (found.labels == label)
        off = points[own] @ plane[:3] + plane[3]
        assert found.rmse_metric[label - 1] == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.05)


def test_fitted_depth_is_where_rays_meet_planes(room):
    _, depth = room
    found = segment(depth, CAMERA)
    fitted = found.fitted_depth()
    inside = found.labels > 0
    assert np.array_equal(np.isfinite(fitted), inside)
    n_x, n_y, n_z, d = found.planes[found.labels[inside] - 1].T
    z = -d / (n_x * CAMERA.tan_x[inside] + n_y * CAMERA.tan_y[inside] + n_z)
    np.testing.assert_allclose(fitted[inside], z, rtol=1e-9)
    assert np.median(np.abs(fitted[inside] - depth[inside] / 1000.0)) < 0.01


def test_plot_draws(room):
    found = segment(room[1], CAMERA)
    figure = found.plot(room[1])
    assert figure._repr_png_().startswith(b"\x89PNG")
    (axes,) = figure.axes
    share = f"{100.0 * found.share:.1f} % of the measured pixels"
    assert axes.get_title() == f"{len(found)} planes, {share}"
    assert repr(found) == f"<Segmentation: {axes.get_title()} of {CAMERA.width} x {CAMERA.height}>"
    assert axes.get_xlabel().startswith("dark grey: on no plane")
    assert len(axes.images) == 1
    for text in axes.texts:
        label, (column, row) = int(text.get_text()), np.rint(text.get_position()).astype(int)
        around = found.labels[max(row - 10, 0) : row + 11, max(column - 10, 0) : column + 11]
        assert found.labels[row, column] == label
        assert found.sizes[label - 1] < 5000 or (around == label).mean() > 0.7


def test_real_frames(real_frame):
    depth, camera = real_frame
    found = segment(depth, camera)
    assert len(found) >= 3
    assert (found.labels > 0).sum() > 0.5 * (found.reason != Reason.MISSING).sum()


@pytest.mark.parametrize("upright", [False, True])
def test_a_strip_of_four_pixels_is_no_plane(upright, rng):
    q = np.full(CAMERA.shape, 0.5)
    strip = np.s_[40:200, 100:104] if upright else np.s_[100:104, 40:200]
    q[strip] = 0.8
    found = segment(1.0 / (q + rng.normal(0.0, 1e-3, q.shape)), CAMERA)
    assert len(found) == 1
    assert np.mean(found.reason[strip] == Reason.NARROW) > 0.95


def test_a_column_of_pixels_is_no_plane():
    # Missing pixels lie between it and the wall, too many to be holes.
    camera = Camera(32, 64, 30.0, 30.0, 15.5, 31.5)
    depth = np.full(camera.shape, 2.0)
    depth[:, 10:] = np.nan
    depth[:, 15] = 2.0
    found = segment(depth + 1e-4 * np.random.default_rng(0).normal(size=depth.shape), camera)
    assert len(found) == 1
    assert np.isfinite(found.planes).all()
    assert (found.reason[:, 15] == Reason.NARROW).all()


INTERRUPTED = """
import signal, time
import rgbd_planes as rp

camera = rp.Camera(320, 240, 262.5, 262.5, 159.5, 119.5, depth_scale=1000.0, noise={noise})
depth = rp.scenes.room().render(camera).measure(holes=0.05, seed=1)
labels = rp.segment(depth, camera).labels

def work():
    return {work}

wanted = work().planes.tobytes()
durations, interrupts = [], 0
for _ in range(5):
    start = time.perf_counter()
    work()
    durations.append(time.perf_counter() - start)
signal.signal(signal.SIGALRM, signal.default_int_handler)
for i in range(1, 60):
    try:
        signal.setitimer(signal.ITIMER_REAL, min(durations) * i / 60)
        work()
        signal.setitimer(signal.ITIMER_REAL, 0)
    except KeyboardInterrupt:
        interrupts += 1
print(interrupts > 20, work().planes.tobytes() == wanted)
"""
OF_NEIGHBOURS = "rp.noise.NoiseModel((1.4e-3,), correlation=((0.5, 3.0),), floor=0.5)"


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers on this system")
@pytest.mark.parametrize(
    ("work", "noise"),
    [
        ("rp.segment(depth, camera)", None),
        ("rp.segment(depth, camera)", OF_NEIGHBOURS),
        ("rp.fit_labels(depth, camera, labels)", OF_NEIGHBOURS),
    ],
)
def test_an_interrupt_at_any_time_is_one(work, noise):
    """Numba does not expect one where it calls Python, to make an array or a tuple: the process would crash."""
    assert printed_by(INTERRUPTED.format(work=work, noise=noise), timeout=600.0).split() == ["True", "True"]


@pytest.mark.parametrize(("rows", "columns"), [(40, 50), (6, 6)])
def test_a_plane_of_just_the_least_size_is_kept(rows, columns):
    depth = np.full(CAMERA.shape, 2.0)
    depth[60 : 60 + rows, 80 : 80 + columns] = 1.5
    pixels = rows * columns
    for least, sizes in ((pixels, [pixels]), (pixels + 1, [])):
        assert segment(depth, CAMERA, min_size=least).sizes[1:].tolist() == sizes


def test_no_plane_loses_pixels_below_the_least_size():
    """Pixels that stand alone lose their label, unless its plane would have too few."""
    camera = Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=1000.0)
    depth = scenes.room().render(camera).measure(holes=0.05, patches=0.1, seed=0)
    sizes = segment(depth, camera).sizes.tolist()
    for least in sorted({size + more for size in sizes for more in range(-3, 4)}):
        assert segment(depth, camera, min_size=least).sizes.min(initial=least) >= least


def test_a_small_plane_is_fitted_to_all_its_pixels():
    """Of 6 x 6 those whose neighbours are also its are less than half; of 8 x 6 they are enough."""
    camera = Camera(160, 120, 131.0, 131.0, 79.5, 59.5)
    q = 0.5 + 1e-3 * np.random.default_rng(1).standard_normal(camera.shape)
    for rows, rim in ((6, 0), (8, 1)):
        seen = q.copy()
        seen[60 : 60 + rows, 80:86] += 0.5 + 0.1 * camera.tan_x[60 : 60 + rows, 80:86]
        found = segment(1.0 / seen, camera, min_size=20)
        own = np.s_[60 + rim : 60 + rows - rim, 80 + rim : 86 - rim]
        rays = np.dstack([camera.tan_x[own], camera.tan_y[own], np.ones(seen[own].shape)]).reshape(-1, 3)
        expected = np.linalg.lstsq(rays, seen[own].ravel(), rcond=None)[0]
        assert found.sizes.tolist() == [160 * 120 - 6 * rows, 6 * rows]
        np.testing.assert_allclose(found.alpha[1], expected, atol=1e-4)
