"""The door for depth frames: every dtype, layout, unit and kind of missing pixel, against the contract."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rgbd_planes import normals, segment
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.depth_frame import as_depth_frame, step_of
from rgbd_planes.evaluation import scenes

CAMERA = Camera(width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5, depth_scale=1000.0)


def camera(shape=(4, 6), **depth):
    height, width = shape
    return Camera(width, height, 100.0, 100.0, 0.5 * (width - 1), 0.5 * (height - 1), **depth)


def expected_valid(depth, cam):
    """Which pixels are measurements, one by one, from the words of the contract."""
    valid = np.zeros(depth.shape, bool)
    nearest, farthest = cam.depth_range or (0, np.inf)
    is_float = depth.dtype.kind == "f"
    sentinels = [depth.dtype.type(v) if is_float else v for v in cam.invalid_values]
    for index, value in np.ndenumerate(depth):
        raw = float(value)
        if not np.isfinite(raw) or value in sentinels:
            continue
        if cam.disparity is not None:
            q = cam.disparity[0] * raw + cam.disparity[1]
            valid[index] = q > 0 and nearest <= 1 / q <= farthest
        else:
            z = value if is_float else raw / cam.depth_scale
            low, high = (depth.dtype.type(limit) if is_float else limit for limit in (nearest, farthest))
            valid[index] = z > 0 and low <= z <= high
    return valid


ranges = st.one_of(st.none(), st.tuples(st.floats(0, 30), st.floats(0.001, 80)).filter(lambda r: r[0] < r[1]))
units = st.one_of(
    st.fixed_dictionaries({"depth_scale": st.sampled_from([1.0, 1000.0, 5000.0, 999.7, 256.0])}),
    st.fixed_dictionaries(
        {
            "disparity": st.tuples(
                st.floats(-0.01, 0.01).filter(lambda s: abs(s) > 1e-6), st.floats(-2, 4).map(lambda v: round(v, 3))
            )
        }
    ),
)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_limits_have_the_digits_of_the_frame(dtype):
    """0.7 is no number of binary digits: a frame that was made of it holds the nearest of its own."""
    cam = camera((1, 5), depth_range=(0.7, 4.1), invalid_values=(2.7,))
    frame = as_depth_frame(np.array([[0.69, 0.7, 2.7, 4.1, 4.12]], dtype), cam)
    assert frame.valid.tolist() == [[False, True, False, True, False]]


def test_the_ends_of_the_range_may_stand_for_missing():
    """As where a driver writes its largest depth for what is farther."""
    cam = camera((1, 3), depth_range=(0.5, 8.0), invalid_values=(0.5, 8.0))
    assert as_depth_frame(np.array([[0.5, 1.0, 8.0]]), cam).valid.tolist() == [[False, True, False]]


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.uint32, np.int64, np.float32, np.float64])
def test_the_largest_number_of_16_bits_is_doubted(dtype):
    scale = 1000.0 if np.dtype(dtype).kind == "f" else 1.0
    depth = np.full((480, 640), 2000.0)
    depth[:50] = 65535.0
    depth = (depth / scale).astype(dtype)
    with pytest.warns(UserWarning, match=r"many pixels are 65\.?535.*are they missing"):
        as_depth_frame(depth, camera(depth.shape, depth_scale=1000.0))
    for said in ({"invalid_values": (65535.0 / scale,)}, {"depth_range": (0.0, 10.0)}):
        as_depth_frame(depth, camera(depth.shape, depth_scale=1000.0, **said))  # warnings are errors here


codes = st.one_of(st.integers(0, 65535), st.sampled_from([0, 1, 2047, 65534, 65535]))


@pytest.mark.filterwarnings("ignore:with a depth_scale of")  # the units are any
@pytest.mark.filterwarnings("ignore:many pixels are")
@given(
    depth=hnp.arrays(np.uint16, (4, 6), elements=codes),
    unit=units,
    depth_range=ranges,
    invalid=st.lists(codes, max_size=4).map(tuple),
    take=st.booleans(),
)
@settings(max_examples=60)
def test_uint16_validity(depth, unit, depth_range, invalid, take):
    if take and invalid:
        depth = depth.copy()
        depth[1, :3] = invalid[0]
    cam = camera(**unit, depth_range=depth_range, invalid_values=invalid)
    frame = as_depth_frame(depth, cam)
    valid = expected_valid(depth, cam)
    np.testing.assert_array_equal(frame.valid, valid)
    np.testing.assert_array_equal(np.isfinite(frame.metres), valid)
    np.testing.assert_array_equal(frame.raw[valid], depth[valid])
    q = depth * frame.scale + frame.offset if frame.is_disparity else frame.scale / np.maximum(depth, 1)
    np.testing.assert_allclose(frame.inverse_depth[valid], q[valid], rtol=1e-15)


@given(
    depth=hnp.arrays(
        st.sampled_from([np.float32, np.float64]),
        (4, 6),
        elements=st.one_of(
            st.floats(-10, 40, width=32), st.sampled_from([0.0, -0.0, np.nan, np.inf, -np.inf, 0.5, 8.0, 30.0, -1.0])
        ),
    ),
    disparity=st.one_of(st.none(), st.tuples(st.sampled_from([-0.3, 0.02, 1.7]), st.sampled_from([0.0, 2.5, -1.0]))),
    depth_range=st.one_of(ranges, st.sampled_from([(0.5, 8.0)])),
    invalid=st.lists(st.sampled_from([0.0, 0.5, 8.0, 30.0, -1.0, 0.1]), max_size=3).map(tuple),
)
@settings(max_examples=100)
def test_float_validity(depth, disparity, depth_range, invalid):
    assume(not ((np.abs(depth) < 1e-30) & (depth != 0)).any())  # no depth: see the test of extremes
    cam = camera(disparity=disparity, depth_range=depth_range, invalid_values=invalid)
    frame = as_depth_frame(depth, cam)
    assert frame.raw.dtype == depth.dtype
    np.testing.assert_array_equal(frame.valid, expected_valid(depth, cam))


@given(bound=st.floats(1e-3, 1e3), dtype=st.sampled_from([np.float32, np.float64]))
@settings(max_examples=50)
def test_the_ends_of_the_range_are_exact(bound, dtype):
    cam = camera((1, 2), depth_range=(bound, 2e3))
    lowest = as_depth_frame(np.ones((1, 2), dtype), cam).lowest
    assert lowest == dtype(bound)


@pytest.mark.parametrize(
    ("dtype", "becomes"),
    [
        ("u1", "u2"),
        ("u2", "u2"),
        (">u2", "u2"),
        ("i2", "f8"),
        ("u4", "f8"),
        (">i4", "f8"),
        ("i8", "f8"),
        ("f2", "f4"),
        ("f4", "f4"),
        (">f4", "f4"),
        ("f8", "f8"),
        (">f8", "f8"),
    ],
)
def test_values_of_any_dtype_are_kept(dtype, becomes):
    depth = (np.arange(24).reshape(4, 6) % 7).astype(dtype)
    frame = as_depth_frame(depth, camera(depth_scale=2.0))
    assert frame.raw.dtype == np.dtype(becomes)
    assert frame.raw.dtype.isnative
    np.testing.assert_array_equal(frame.raw, depth)
    np.testing.assert_array_equal(frame.valid, depth > 0)
    scale = 2.0 if np.dtype(dtype).kind in "ui" else 1.0
    np.testing.assert_array_equal(frame.metres[frame.valid], depth[depth > 0] / scale)


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.int32])
def test_limits_and_invalid_values_of_integers_may_be_between_them(dtype):
    raw = np.arange(1400, 1424).reshape(4, 6).astype(dtype)
    cam = camera(depth_scale=1000.0, depth_range=(1.4025, 1.4195), invalid_values=(1410.5, 1412.0))
    np.testing.assert_array_equal(as_depth_frame(raw, cam).valid, (raw >= 1403) & (raw <= 1419) & (raw != 1412))


def test_negative_integers_are_missing():
    depth = np.array([[-5, 0, 3], [7, -32768, 32767]], np.int16)
    frame = as_depth_frame(depth, camera((2, 3), depth_scale=1000.0, depth_range=(0.004, 100)))
    assert frame.valid.tolist() == [[False, False, False], [True, False, True]]


def test_frames_of_any_memory_layout_are_the_same():
    whole = np.arange(96, dtype=np.uint16).reshape(8, 12)
    read_only = whole[:4, :6].copy()
    read_only.flags.writeable = False
    unaligned = np.frombuffer(b"\0" + whole[:4, :6].tobytes(), np.uint16, 24, 1).reshape(4, 6)
    for depth in (whole[::2, ::2], whole[:4, :6], whole[:6, :4].T, whole[3::-1, 5::-1], read_only, unaligned):
        frame = as_depth_frame(depth, camera(depth_scale=1000.0))
        assert frame.raw.flags.c_contiguous
        assert frame.raw.flags.aligned
        assert not frame.raw.flags.writeable
        np.testing.assert_array_equal(frame.raw, depth)


def test_the_common_case_copies_nothing():
    depth = np.ones((4, 6), np.uint16)
    cam = camera(depth_scale=1000.0, invalid_values=(0, 65535), depth_range=(0, 20))
    assert np.shares_memory(as_depth_frame(depth, cam).raw, depth)
    assert depth.flags.writeable


def test_invalid_values_inside_the_interval_leave_the_callers_frame_alone():
    depth = np.full((4, 6), 7, np.uint16)
    depth[0, 0] = 9
    frame = as_depth_frame(depth, camera(depth_scale=1000.0, invalid_values=(7,)))
    assert frame.valid.sum() == 1
    assert (depth[0, 0], depth[1, 1]) == (9, 7)


def test_a_disparity_of_which_every_code_is_a_measurement_is_widened():
    depth = np.full((4, 6), 100, np.uint16)
    depth[0] = [0, 65535, 100, 2047, 2048, 2046]
    cam = camera(disparity=(1e-5, 0.1), invalid_values=(2047,))
    frame = as_depth_frame(depth, cam)
    assert frame.raw.dtype == np.float64
    assert frame.valid[0].tolist() == [True, True, True, False, True, True]
    untouched = as_depth_frame(np.where(depth == 2047, 5, depth).astype(np.uint16), cam)
    assert untouched.raw.dtype == np.uint16
    assert untouched.valid.all()


def test_no_raw_value_is_valid():
    frame = as_depth_frame(np.arange(24, dtype=np.uint16).reshape(4, 6), camera(disparity=(-1.0, -1.0)))
    assert not frame.valid.any()
    frame = as_depth_frame(np.ones((4, 6)), camera(depth_range=(2, 3)))
    assert not frame.valid.any()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_extremes_that_would_overflow_are_missing(dtype):
    depth = np.zeros((4, 6), dtype)
    info = np.finfo(dtype)
    largest = np.finfo(np.float32).max  # which also stands for missing
    depth[0] = [info.smallest_subnormal, info.tiny / 2, 1e-30, 1e30, np.inf, info.max]
    frame = as_depth_frame(depth, camera())
    assert frame.valid[0].tolist() == [False, False, True, True, False, False]
    frame = as_depth_frame(depth, camera(invalid_values=(1e300, 1e30)))  # of which float32 holds but one
    assert frame.valid[0].tolist() == [False, False, True, False, False, False]
    depth[0] = [largest, np.nextafter(largest, np.float32(0.0)), 1.0, 1.0, 1.0, 1.0]
    assert as_depth_frame(depth, camera()).valid[0].tolist() == [False, True, True, True, True, True]


def test_float_frames_are_metres_whatever_the_depth_scale():
    frame = as_depth_frame(np.full((4, 6), 1.5, np.float32), camera(depth_scale=1000.0))
    assert (frame.scale, frame.offset) == (1.0, 0.0)
    assert (frame.metres == 1.5).all()


def test_float_disparity():
    frame = as_depth_frame(np.full((4, 6), 200.5), camera(disparity=(0.01, 0.1)))
    assert frame.is_disparity
    np.testing.assert_allclose(frame.metres, 1 / 2.105)


def test_millimetres_as_floats_draw_one_warning_here():
    depth = np.full((480, 640), 1500.0, np.float32)
    depth[::3] = 0
    depth[:, ::20] = np.nan
    with pytest.warns(UserWarning, match="float depth is in metres.*millimetres") as caught:
        as_depth_frame(depth, camera((480, 640), depth_scale=1000.0))
    assert len(caught) == 1
    assert caught[0].filename == __file__
    with pytest.warns(UserWarning, match="millimetres"):
        camera((480, 640), depth_range=(0.1, 10.0)).points(depth)


def test_integers_in_unlikely_units_draw_a_warning():
    depth = np.full((480, 640), 1500, np.uint16)
    depth[::3] = 0
    for dtype in (np.uint16, np.int32):
        with pytest.warns(UserWarning, match="is it in millimetres, depth_scale=1000") as caught:
            as_depth_frame(depth.astype(dtype), camera((480, 640), depth_scale=1.0))
        assert caught[0].filename == __file__
    with pytest.warns(UserWarning, match="most of this frame is beyond 50 m"):
        as_depth_frame(np.full((480, 640), 40000, np.uint16), camera((480, 640), depth_scale=600.0))
    picture = (depth // 10).astype(np.uint8)
    for depth_range in (None, (0, 20)):
        with pytest.warns(UserWarning, match=r"ends at 0\.26 m: is it a picture of the depth"):
            as_depth_frame(picture, camera((480, 640), depth_scale=1000.0, depth_range=depth_range))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_depth_frame(picture, camera((480, 640), depth_scale=1000.0, depth_range=(0, 0.2)))
        as_depth_frame(depth, camera((480, 640), depth_scale=1.0, depth_range=(1, 4000)))
        as_depth_frame(picture, camera((480, 640), depth_scale=100.0))
        as_depth_frame(np.full((480, 640), 65534, np.uint16), camera((480, 640), depth_scale=1000.0))


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint16, np.int32])
def test_metres_that_are_taken_for_millimetres_draw_a_warning(dtype):
    metres = np.linspace(1.0, 9.5, 480 * 640).reshape(480, 640)
    metres[::3] = 0.0
    divided = metres / 1000.0 if dtype in (np.float32, np.float64) else metres
    said = "float depth is in metres, but" if divided is not metres else "with a depth_scale of 1000 per metre"
    with pytest.warns(UserWarning, match=f"{said} all of this frame is nearer than 0.02 m") as caught:
        as_depth_frame(divided.astype(dtype), camera((480, 640), depth_scale=1000.0))
    assert (len(caught), caught[0].filename) == (1, __file__)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_depth_frame(divided.astype(dtype), camera((480, 640), depth_scale=1000.0, depth_range=(0.0, 0.02)))
        as_depth_frame(np.zeros((480, 640), dtype), camera((480, 640), depth_scale=1000.0))
        divided[1::2] *= 25.0  # a sensor that sees something near
        as_depth_frame(divided.astype(dtype), camera((480, 640), depth_scale=1000.0))


@pytest.mark.parametrize("missing", [np.inf, np.finfo(np.float32).max])
def test_numbers_for_missing_say_nothing_of_units(missing):
    depth = np.linspace(1.0, 9.5, 480 * 640, dtype=np.float32).reshape(480, 640)
    depth[np.random.default_rng(0).random(depth.shape) < 0.6] = missing
    as_depth_frame(depth, camera(depth.shape))  # warnings are errors here
    with pytest.warns(UserWarning, match="all of this frame is nearer than 0.02 m"):
        as_depth_frame(np.where(depth == missing, depth, depth / 1000.0), camera(depth.shape))


def test_the_largest_number_of_16_bits_is_most_likely_missing():
    depth = np.full((480, 640), 1500, np.uint16)
    depth[40:80, 200:500] = 65535
    for scale in (1000.0, 5000.0, 256.0):
        with pytest.warns(UserWarning, match=r"are they missing.*invalid_values=\(65535,\)") as caught:
            as_depth_frame(depth, camera((480, 640), depth_scale=scale))
        assert caught[0].filename == __file__
    strewn = np.random.default_rng(0).random(depth.shape)
    stray = np.where(strewn < 0.004, 65535, 1500).astype(np.uint16)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_depth_frame(stray, camera((480, 640), depth_scale=1000.0))
        as_depth_frame(depth, camera((480, 640), depth_scale=1000.0, invalid_values=(65535,)))
        as_depth_frame(depth, camera((480, 640), depth_scale=1000.0, depth_range=(0, 20)))
        as_depth_frame(depth, camera((480, 640), disparity=(1e-4, 0.0)))


@pytest.mark.parametrize(
    ("number", "dtype"),
    [
        (1e10, np.float32),
        (1000.0, np.float32),
        (65504, np.float16),
        (65504.0, np.float32),
        (1e10, np.float64),
        (2**32 - 1, np.uint32),
        (2**32 - 1, np.float32),
        (2**31 - 1, np.int32),
        (2**63 - 1, np.int64),
        (32767, np.int16),
        (32.767, np.float32),
        (32.767, np.float64),
    ],
)
def test_numbers_for_missing_are_doubted(number, dtype):
    depth = np.linspace(1.0, 9.0, 480 * 640).reshape(480, 640) * (1000.0 if np.dtype(dtype).kind in "iu" else 1.0)
    depth = depth.astype(dtype)
    missing = np.random.default_rng(0).random(depth.shape) < 0.6
    depth[missing] = number
    with pytest.warns(UserWarning, match="are they missing") as caught:
        as_depth_frame(depth, camera(depth.shape, depth_scale=1000.0))
    assert (len(caught), caught[0].filename) == (1, __file__)
    said = re.search(r"invalid_values=\((.*),\)", str(caught[0].message))
    for right in ({"invalid_values": (float(said[1]),)}, {"depth_range": (0.0, 20.0)}):
        frame = as_depth_frame(depth, camera(depth.shape, depth_scale=1000.0, **right))  # warnings are errors here
        np.testing.assert_array_equal(frame.valid, ~missing)


def test_numbers_for_missing_do_not_hide_other_units():
    metres = np.linspace(1.0, 9.0, 480 * 640).reshape(480, 640)
    missing = np.random.default_rng(0).random(metres.shape) < 0.2
    for depth, number, unit in (
        (metres / 1000.0, 1e10, "nearer than 0.02 m"),
        (1000.0 * metres, 65535.0, "beyond 50 m: millimetres"),
    ):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            as_depth_frame(np.where(missing, number, depth), camera(metres.shape))
        assert [str(warning.message).count("are they missing") for warning in caught] == [1, 0]
        assert unit in str(caught[1].message)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint16, np.int32])
def test_what_is_far_is_not_taken_for_missing(dtype):
    rng = np.random.default_rng(0)
    near = rng.uniform(0.5, 1.5, (480, 640))
    some = rng.random(near.shape)
    frames = [
        np.where(some < 0.4, 5.0, near),  # a wall that faces the camera, rendered without noise
        np.minimum(12.0 * near, 10.0),  # a renderer's far plane
        np.where(some < 0.004, 60.0, near),  # strays
        np.where(some < 0.4, 60.0, 20.0 * near),
        np.where(some < 0.4, rng.uniform(55.0, 60.0, near.shape), near),  # the street behind a window
        np.where(some < 0.4, near, 0.0),
        np.where(some < 0.4, 1.5, 0.0),
    ]
    for depth in frames:
        raw = depth if np.dtype(dtype).kind == "f" else np.rint(1000.0 * depth)
        as_depth_frame(raw.astype(dtype), camera(depth.shape, depth_scale=1000.0))  # warnings are errors here
    sky = np.where(some < 0.4, 1e4, near).astype(np.float32)
    as_depth_frame(sky, camera(sky.shape, depth_range=(0.0, 2e4)))
    as_depth_frame(sky, camera(sky.shape, disparity=(0.2, 0.0)))


@pytest.mark.parametrize("far", [0, 0.4, 0.49])
def test_no_warning_for_metres(far):
    depth = np.full((32, 100), 3.0)
    depth[:, : int(far * 100)] = np.linspace(200.0, 300.0, int(far * 100))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_depth_frame(depth, camera((32, 100)))
        as_depth_frame(np.full((32, 100), 300.0), camera((32, 100), depth_range=(1, 1000)))
        as_depth_frame(np.full((32, 100), np.nan), camera((32, 100)))
        as_depth_frame(np.full((32, 100), np.inf), camera((32, 100)))
        as_depth_frame(np.full((32, 100), 300.0), camera((32, 100), disparity=(0.001, 0)))


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint16, np.int16])
@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_the_scale_of_disparities_is_doubted(dtype, offset):
    focal_length, baseline, parts = 525.0, 0.075, 1 if np.dtype(dtype).kind == "f" else 16
    depth = np.linspace(0.8, 6.0, 480 * 640).reshape(480, 640)
    right = 1.0 / (parts * focal_length * baseline)
    disparity = (1.0 / depth - offset) / right
    disparity = (disparity if parts == 1 else np.rint(disparity)).astype(dtype)
    missing = np.random.default_rng(0).random(depth.shape) < 0.3
    disparity[missing] = 0
    said = "the scale is 1 / (focal length in pixels * baseline in metres)"
    for scale, units, ends in (
        (parts * focal_length * baseline, "all of this frame is nearer than 0.02 m", 0.02),
        (right / 1000.0, "most of this frame is beyond 50 m", 1e4),
    ):
        wrong = {"disparity": (scale, offset * scale / right), "invalid_values": (0,)}
        for depth_range in (None, (0.1, 20.0)):
            with pytest.warns(UserWarning, match=re.escape(f") {units}: {said}")) as caught:
                as_depth_frame(disparity, camera(depth.shape, depth_range=depth_range, **wrong))
            assert (len(caught), caught[0].filename) == (1, __file__)
        as_depth_frame(disparity, camera(depth.shape, depth_range=(0.0, ends), **wrong))  # warnings are errors here
    as_depth_frame(disparity, camera(depth.shape, disparity=(right, offset), invalid_values=(0,)))
    as_depth_frame(np.zeros_like(disparity), camera(depth.shape, disparity=(right, 0.0)))
    for relative in ((1.0, 0.0), (-1.0, 2000.0)):
        as_depth_frame(disparity, camera(depth.shape, disparity=relative))  # of a network, as documented
    disparity[np.random.default_rng(1).random(depth.shape) < 0.7] = parts // 2 or 0.5  # beyond 50 m: said to be missing
    as_depth_frame(disparity, camera(depth.shape, disparity=(right, 0.0), depth_range=(0.0, 30.0)))


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_the_scale_of_disparities_is_doubted_whatever_invalid_values_would_mean(dtype):
    """The Kinect's code for missing, 2047, would be farther than all others."""
    codes = np.linspace(300.0, 1000.0, 480 * 640).reshape(480, 640).astype(dtype)
    codes[np.random.default_rng(0).random(codes.shape) < 0.3] = 2047
    with pytest.warns(UserWarning, match="all of this frame is nearer than 0.02 m"):
        as_depth_frame(codes, camera(codes.shape, disparity=(-3.0, 6145.0), invalid_values=(2047,)))


@pytest.mark.parametrize(
    ("two_metres", "unit"),
    [
        (np.uint16(2000), {"depth_scale": 1000.0}),
        (np.int32(2000), {"depth_scale": 1000.0}),
        (np.float32(2.0), {}),
        (np.uint16(20), {"disparity": (0.02, 0.1)}),
        (np.float64(20.0), {"disparity": (0.02, 0.1)}),
    ],
)
def test_a_range_in_millimetres_is_doubted(two_metres, unit):
    depth = np.full((480, 640), two_metres)
    depth[::3] = 2047
    unit |= {"invalid_values": (2047,)}
    with pytest.warns(UserWarning, match=re.escape("in millimetres? In metres that is depth_range=(0.3, 5)")) as caught:
        as_depth_frame(depth, camera(depth.shape, depth_range=(300.0, 5000.0), **unit))
    assert (len(caught), caught[0].filename) == (1, __file__)
    as_depth_frame(np.full_like(depth, 2047), camera(depth.shape, depth_range=(300.0, 5000.0), **unit))  # an empty one
    as_depth_frame(depth, camera(depth.shape, depth_range=(3.0, 5.0), **unit))


def test_a_range_of_what_is_far_is_not_doubted():
    depth = np.full((480, 640), 2.0)
    depth[:100] = np.linspace(100.0, 400.0, 640)
    as_depth_frame(depth, camera(depth.shape, depth_range=(300.0, 5000.0)))  # warnings are errors here


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32])
def test_integers_need_a_unit(dtype):
    with pytest.raises(ValueError, match=r"depth_scale .* or disparity .*got a camera with neither"):
        as_depth_frame(np.ones((4, 6), dtype), camera())


@pytest.mark.parametrize("dtype", [bool, complex, object, "U3", "M8[s]"])
def test_other_dtypes_are_refused(dtype):
    with pytest.raises(TypeError, match="integers or floats, got dtype"):
        as_depth_frame(np.zeros((4, 6), dtype), camera())


def test_masked_arrays_are_refused():
    with pytest.raises(TypeError, match="masked"):
        as_depth_frame(np.ma.masked_equal(np.ones((4, 6)), 0), camera())


@pytest.mark.parametrize(
    ("shape", "hint"),
    [
        ((4, 6, 3), "colour"),
        ((4, 6, 4), "colour"),
        ((4, 6, 1), "squeeze"),
        ((1, 4, 6), "squeeze"),
        ((6, 4), "transposed"),
        ((8, 12), r"got \(8, 12\): .* of another resolution\? camera\.resized\(12, 8\)"),
        ((8, 13), r"got \(8, 13\)$"),
        ((6,), "a row of a frame"),
        ((24,), r"got \(24,\)$"),
        ((), r"got \(\)$"),
        ((0, 0), r"got \(0, 0\)$"),
    ],
)
def test_other_shapes_are_refused_with_a_hint(shape, hint):
    with pytest.raises(ValueError, match=rf"\(4, 6\).*{hint}"):
        as_depth_frame(np.ones(shape), camera())


def test_nested_lists_are_frames():
    frame = as_depth_frame([[1, 2], [0, 4]], camera((2, 2), depth_scale=2.0))
    np.testing.assert_array_equal(frame.metres, [[0.5, 1.0], [np.nan, 2.0]])


@pytest.mark.parametrize(
    ("depth", "unit"),
    [
        (np.full((40, 60), 1000, np.uint16), {"depth_scale": 1000.0, "invalid_values": (7,)}),
        (np.full((40, 60), 1000, np.uint16), {"disparity": (0.001, 0.5)}),  # all codes are measurements
        (np.full((40, 60), 1.0, np.float32), {}),
        (np.full((40, 60), 1.0), {}),
        (np.full((40, 60), 1.0), {"disparity": (1.0, 0.0)}),
    ],
)
def test_what_a_fisheye_sees_beside_the_camera_is_missing(depth, unit):
    cam = Camera(60, 40, 15.0, 15.0, 29.5, 19.5, distortion_model="fisheye", **unit)
    row, column = np.indices(cam.shape)
    seen = np.hypot(row - 19.5, column - 29.5) < 15 * np.radians(85)
    with pytest.warns(
        UserWarning, match=r"about 3\d% of this frame are measured where the fisheye lens has no ray within"
    ):
        frame = as_depth_frame(depth, cam)
    np.testing.assert_array_equal(frame.valid, seen)
    np.testing.assert_array_equal(np.isfinite(frame.metres), seen)
    assert (depth == depth[0, 0]).all()
    if cam.disparity is None:  # a sensor measures nothing there
        np.testing.assert_array_equal(as_depth_frame(np.where(seen, depth, 0), cam).valid, seen)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("scale", [50.0, 1000.0, 5000.0])
def test_metres_that_integers_were_made_into_are_rounded(kind, scale):
    camera = replace(CAMERA, depth_scale=scale)
    depth = scenes.room().render(camera).measure(noise=1e-4)
    metres = as_depth_frame((depth / scale).astype(kind), camera)
    assert step_of(metres) == pytest.approx(1.0 / scale, rel=1e-9)
    expected, found = segment(depth, camera), segment(metres.raw, camera)
    assert len(found) == len(expected)
    assert np.mean(found.labels != expected.labels) < 1e-3


@pytest.mark.filterwarnings("ignore:many pixels are")
@pytest.mark.parametrize("farthest", [1e10, 1e15, 3e38])
def test_a_sky_beyond_any_measure_leaves_the_step_of_metres(farthest):
    # As simulators give it. All so large numbers are whole.
    metres = scenes.room().render(CAMERA).measure(holes=0.05) / 1000.0
    metres[metres == 0.0] = farthest
    assert step_of(as_depth_frame(metres, CAMERA)) == pytest.approx(0.001, rel=1e-9)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize(("parts", "scale"), [(16, 2.5e-2), (256, 1.25e-2), (16, -2.5e-2)])
def test_disparities_that_integers_were_divided_into_are_rounded(kind, parts, scale):
    # As OpenCV's matchers give them: 16ths of a pixel, which its examples make into floats.
    whole = replace(CAMERA, depth_scale=None, disparity=(scale / parts, 0.1))
    divided = replace(whole, disparity=(scale, 0.1))
    q = 1.0 / scenes.room().render(CAMERA).depth
    raw = np.rint((q - 0.1) / (scale / parts)).astype(np.int16)
    disparity = (raw / parts).astype(kind)
    assert step_of(as_depth_frame(disparity, divided)) == 1.0 / parts
    expected, found = segment(raw, whole), segment(disparity, divided)
    np.testing.assert_array_equal(found.labels, expected.labels)
    assert found.sigma == pytest.approx(expected.sigma)
    slopes, of_floats = normals(raw, whole, avoid_edges=True), normals(disparity, divided, avoid_edges=True)
    np.testing.assert_allclose(of_floats, slopes, atol=1e-6)


def test_disparities_that_were_measured_have_no_step():
    camera = replace(CAMERA, depth_scale=None, disparity=(0.025, 0.0))
    disparity = 40.0 / scenes.room().render(CAMERA).measure(noise=1e-4, quantise=False)
    few = np.full(CAMERA.shape, 32.0)
    few[:, 100:] = 48.0
    for raw in (disparity, disparity.astype(np.float32), few):
        assert step_of(as_depth_frame(raw, camera)) == 0.0


def test_metres_that_were_measured_have_no_step():
    depth = scenes.room().render(CAMERA).measure(noise=1e-4, quantise=False)
    flat = np.full(CAMERA.shape, 2.0)
    flat[:, 100:] = 3.5
    for metres in (depth, depth.astype(np.float32), flat, np.zeros(CAMERA.shape)):
        assert step_of(as_depth_frame(metres, CAMERA)) == 0.0


def test_many_numbers_of_16_bits_are_no_strays():
    strewn = np.random.default_rng(0).random((480, 640))
    with pytest.warns(UserWarning, match="many pixels are 65535"):
        as_depth_frame(np.where(strewn < 0.04, 65535, 1500).astype(np.uint16), camera(strewn.shape, depth_scale=1000.0))


def test_a_few_measurements_beside_what_a_fisheye_sees_are_strays():
    cam = Camera(640, 480, 150.0, 150.0, 319.5, 239.5, distortion_model="fisheye")
    beside = np.hypot(cam.tan_x_columns, cam.tan_y_rows[:, None]) >= np.radians(85.0)
    strewn = np.random.default_rng(0).random(cam.shape)
    as_depth_frame(np.where(beside & (strewn > 0.02), 0.0, 1.5), cam)  # warnings are errors here
    with pytest.warns(UserWarning, match="where the fisheye lens has no ray"):
        as_depth_frame(np.where(beside & (strewn > 0.2), 0.0, 1.5), cam)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32, np.int32])
@pytest.mark.parametrize("scale", [1.0 / 300.0, -1.0 / 300.0])
def test_a_lowest_disparity_of_many_pixels_is_doubted(dtype, scale, rng):
    """With an offset it is a depth; without one, or below it, nothing is measured there."""
    cam = camera((240, 320), disparity=(scale, 0.5))
    raw = rng.integers(20, 100, cam.shape).astype(dtype)
    missing = rng.random(cam.shape) < 0.1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_depth_frame(raw, cam)
        as_depth_frame(np.where(missing, raw.dtype.type(0), raw), replace(cam, invalid_values=(0,)))
        as_depth_frame(np.where(missing, raw.dtype.type(0), raw), replace(cam, disparity=(abs(scale), 0.0)))
        as_depth_frame(np.where(missing, raw.dtype.type(0), raw), replace(cam, disparity=(1.0, 0.5)))  # relative
    for number in (0, -1)[: 1 if dtype == np.uint16 else 2]:
        with pytest.warns(UserWarning, match=rf"disparity of {number}, .* invalid_values=\({number},\) says so"):
            as_depth_frame(np.where(missing, raw.dtype.type(number), raw), cam)


def test_depths_that_are_all_negative_are_doubted():
    depth = scenes.room().render(CAMERA).depth
    for negative in (-depth, -depth.astype(np.float32), (-1000.0 * depth).astype(np.int32)):
        with pytest.warns(UserWarning, match="does its z axis point backwards"):
            as_depth_frame(negative, CAMERA)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        as_depth_frame(np.full(CAMERA.shape, -1.0), CAMERA)  # nothing was measured
        as_depth_frame(np.where(np.arange(320) % 2 == 0, depth, -1.0), CAMERA)
    with pytest.warns(UserWarning, match="millimetres") as caught:  # not all are negative
        as_depth_frame(1000.0 * np.where(np.arange(320) % 4 == 0, -depth, depth), CAMERA)
    assert len(caught) == 1
