"""Folders as users have them: with a calibration, resized, with images that are no depth, and in other units."""

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes import sequences
from rgbd_planes.camera import presets
from rgbd_planes.sequences import images

CORNER = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_scale=1000.0)


@pytest.fixture
def depth():
    """Two walls, 640 x 480 of a Structure sensor, and other sizes of it."""
    return rp.scenes.room().render(presets.scannet()).measure(seed=1)


def write(root, frames, name="frame-{:06d}.depth.png"):
    for i, frame in enumerate(frames):
        path = root / name.format(i)
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".npy":
            np.save(path, frame)
        else:
            images.write_png(path, frame)


def matrix_of(camera, size=4):
    matrix = np.eye(size)
    matrix[:2, :3] = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy]]
    return matrix


def test_scannet_resized_has_its_camera_resized(tmp_path, depth):
    write(tmp_path, [depth[::2, ::2]], "depth/{}.png")
    (tmp_path / "intrinsic").mkdir()
    np.savetxt(tmp_path / "intrinsic" / "intrinsic_depth.txt", matrix_of(presets.scannet()))
    camera = rp.open_sequence(tmp_path).camera
    assert camera == presets.scannet().resized(320, 240)
    write(tmp_path / "other", [depth[:300, :300]], "depth/{}.png")
    (tmp_path / "intrinsic").rename(tmp_path / "other" / "intrinsic")
    with pytest.raises(ValueError, match=r"principal point at \(319\.5, 239\.5\), the middle of 640 x 480"):
        rp.open_sequence(tmp_path / "other")


INFO = """m_versionNumber = 4
m_depthWidth = 640
m_depthHeight = 480
m_depthShift = 1000.000000
m_calibrationDepthIntrinsic = 480 0 320 0 0 481 240 0 0 0 1 0 0 0 0 1
"""


@pytest.mark.parametrize("name", ["info.txt", "_info.txt", "camera-intrinsics.txt", "intrinsics.txt", "camera.yaml"])
def test_the_calibration_beside_the_frames_is_read(tmp_path, depth, name):
    write(tmp_path, [depth, depth])
    text = INFO if "info" in name else "480 0 320\n0 481 240\n0 0 1\n"
    if name == "camera.yaml":
        text = "width: 640\nheight: 480\nfx: 480\nfy: 481\ncx: 320\ncy: 240\n"
    (tmp_path / name).write_text(text)
    sequence = rp.open_sequence(tmp_path)
    camera = sequence.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.depth_scale) == (480.0, 481.0, 320.0, 240.0, 1000.0)
    assert "preset" not in repr(sequence)


def test_of_3dmatch_it_stands_one_folder_above(tmp_path, depth):
    write(tmp_path / "scene" / "seq-01", [depth])
    np.savetxt(tmp_path / "scene" / "camera-intrinsics.txt", matrix_of(presets.scannet(), 3))
    assert rp.open_sequence(tmp_path / "scene" / "seq-01").camera.fx == presets.scannet().fx


def test_a_preset_is_named_where_nothing_states_a_calibration(tmp_path, depth):
    write(tmp_path / "plain", [depth])
    sequence = rp.open_sequence(tmp_path / "plain")
    assert sequence.camera == presets.seven_scenes()
    assert "calibration of presets.seven_scenes" in repr(sequence)
    assert "calibration of presets.seven_scenes" in repr(sequence[:1])
    assert "preset" not in repr(rp.open_sequence(tmp_path / "plain", presets.scannet(), "seven_scenes"))
    (tmp_path / "plain" / "info.txt").write_text("recorded on a Monday")  # no calibration: that is still the preset's
    assert rp.open_sequence(tmp_path / "plain").camera == presets.seven_scenes()


def test_a_calibration_that_cannot_be_read_is_an_error(tmp_path, depth):
    write(tmp_path, [depth])
    (tmp_path / "camera-intrinsics.txt").write_text("fx is 480")
    with pytest.raises(ValueError, match=r"camera-intrinsics\.txt"):
        rp.open_sequence(tmp_path)
    np.savetxt(tmp_path / "camera-intrinsics.txt", matrix_of(presets.scannet(), 3))
    np.savetxt(tmp_path / "intrinsics.txt", matrix_of(presets.kinect_v1(), 3))
    with pytest.raises(ValueError, match=r"expected one calibration, got camera-intrinsics\.txt, intrinsics\.txt"):
        rp.open_sequence(tmp_path)
    np.savetxt(tmp_path / "intrinsics.txt", matrix_of(presets.scannet(), 3))  # twice the same is one
    assert rp.open_sequence(tmp_path).camera.fx == presets.scannet().fx
    np.savetxt(tmp_path / "camera-intrinsics.txt", matrix_of(presets.scannet().resized(1280, 960), 3))
    (tmp_path / "intrinsics.txt").unlink()
    with pytest.raises(ValueError, match="the middle of 1280 x 960"):
        rp.open_sequence(tmp_path)


def test_tum_with_its_own_calibration(tmp_path, depth):
    root = tmp_path / "freiburg1_xyz"
    write(root, [depth], "depth/{}.png")
    (root / "depth.txt").write_text("1.5 depth/0.png\n")
    assert "presets.tum_freiburg1" in repr(rp.open_sequence(root))
    (root / "TUM1_camera_info.yaml").write_text("width: 640\nheight: 480\nfx: 480\nfy: 481\ncx: 320\ncy: 240\n")
    camera = rp.open_sequence(root).camera
    assert (camera.fx, camera.depth_scale) == (480.0, 5000.0)


def test_one_frame_in_two_files_and_images_that_are_no_depth(tmp_path, rng):
    metres = rng.uniform(1, 2, (3, 48, 64)).astype(np.float32)
    write(tmp_path, metres, "depth_{}.npy")
    write(tmp_path, (80 * metres).astype(np.uint8), "depth_{}.png")
    write(tmp_path, np.full((3, 48, 64), 2, np.uint8), "depth_confidence_{}.png")
    write(tmp_path, np.full((3, 48, 64), 2, np.uint8), "rgb_{}.png")
    with pytest.warns(UserWarning, match="left out") as told:
        sequence = rp.open_sequence(tmp_path, CORNER)
    assert len(told) == 1
    assert "left out 3 images that by name hold no depth (depth_confidence_0.png, " in str(told[0].message)
    assert "3 files of frames that are there twice (depth_0.png, " in str(told[0].message)
    assert [frame.depth.dtype for frame in sequence] == [np.float32] * 3
    np.testing.assert_array_equal([frame.depth for frame in sequence], metres)


@pytest.mark.parametrize("name", ["Depth", "depth_images", "sensor_depth"])
def test_a_folder_of_depth_of_another_name(tmp_path, depth, name):
    write(tmp_path, [depth], name + "/{}.png")
    write(tmp_path, [depth], "rgb/{}.png")
    assert rp.open_sequence(tmp_path, presets.scannet()).names == (f"{name}/0.png",)
    write(tmp_path, [depth], "depth_raw/{}.png")
    with pytest.raises(ValueError, match=r"found .*depth_raw.*: give one of "):
        rp.open_sequence(tmp_path, presets.scannet())


@pytest.mark.parametrize(
    ("stamp", "unit"), [("1305031102160407000", "nano"), ("1305031102160407", "micro"), ("1305031102160", "milli")]
)
def test_stamps_in_other_units_are_named_with_their_line(tmp_path, depth, stamp, unit):
    root = tmp_path / "freiburg1_xyz"
    write(root, [depth], "depth/{}.png")
    (root / "depth.txt").write_text(f"# time file\n1.5 depth/0.png\n{stamp} depth/0.png\n")
    with pytest.raises(ValueError, match=rf"depth\.txt, line 3: expected seconds, got {stamp}: is it in {unit}seconds"):
        rp.open_sequence(root)


def test_masks_units_and_a_function_for_each_frame(tmp_path, rng):
    raw = rng.integers(500, 2000, (2, 48, 64)).astype(np.uint16)
    write(tmp_path, raw, "depth/{}.png")
    confidence = rng.integers(0, 3, (2, 48, 64)).astype(np.uint8)
    write(tmp_path, confidence, "confidence/{:05d}.png")
    sequence = rp.open_sequence(tmp_path, CORNER)
    for frame, values, sure in zip(sequence.masked(tmp_path / "confidence", 2), raw, confidence, strict=True):
        np.testing.assert_array_equal(frame.depth, np.where(sure >= 2, values, 0))
    np.testing.assert_array_equal(
        sequence.masked(tmp_path / "confidence")[1].depth, np.where(confidence[1] > 0, raw[1], 0)
    )
    disparity = rp.open_sequence(tmp_path, rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, disparity=(0.001, 0.1)))
    masked = disparity.masked(tmp_path / "confidence", 2)[0].depth
    np.testing.assert_array_equal(np.isnan(masked), confidence[0] < 2)

    millimetres = raw.astype(np.float32)
    write(tmp_path / "floats", millimetres, "depth_{}.npy")
    floats = rp.open_sequence(tmp_path / "floats", CORNER).with_float_scale(1000.0)
    np.testing.assert_allclose(floats[0].depth, raw[0] / 1000.0, rtol=1e-6)
    assert floats[0].depth.dtype == np.float32
    np.testing.assert_array_equal(sequence.with_float_scale(1000.0)[0].depth, raw[0])  # integers say their unit

    turned = sequence.map(lambda frame: frame.rotated(180))
    np.testing.assert_array_equal(turned[1].depth, raw[1][::-1, ::-1])
    assert turned[1].camera == CORNER.rotated(180)
    near = sequence.map(lambda frame: np.where(frame.depth < 1000, frame.depth, 0))
    assert near[0].depth.max() < 1000
    assert near[1:][0].depth.max() < 1000
    assert near.with_noise(rp.noise.kinect_v1())[0].depth.max() < 1000
    swapped = rp.open_sequence(tmp_path, CORNER).map(lambda frame: frame.depth.byteswap()).with_swapped_bytes()
    np.testing.assert_array_equal(swapped[0].depth, raw[0])


def test_masks_and_functions_that_do_not_fit(tmp_path, rng):
    raw = rng.integers(500, 2000, (2, 48, 64)).astype(np.uint16)
    write(tmp_path, raw, "depth/{}.png")
    sequence = rp.open_sequence(tmp_path, CORNER)
    write(tmp_path, raw[:1, :24], "mask/{}.png")
    with pytest.raises(ValueError, match=r"mask: expected an image for the frame depth/1\.png, .* got none"):
        sequence.masked(tmp_path / "mask")
    with pytest.raises(ValueError, match=r"mask/0\.png: expected a mask .* shape \(48, 64\), got \(24, 64\)"):
        sequence[:1].masked(tmp_path / "mask")[0]
    with pytest.raises(NotADirectoryError):
        sequence.masked(tmp_path / "none")
    with pytest.raises(ValueError, match="expected float_scale > 0"):
        sequence.with_float_scale(0.0)
    with pytest.raises(TypeError, match="expected a function of a Frame, got str"):
        sequence.map("upside down")
    with pytest.raises(TypeError, match=r"expected a Frame or a depth \(H, W\) from the function of map, got NoneType"):
        sequence.map(lambda frame: None)[0]


def test_a_batch_with_steps_is_resumed_as_what_it_is(tmp_path, rng):
    pytest.importorskip("pyarrow")
    raw = rng.integers(500, 2000, (2, 48, 64)).astype(np.uint16)
    write(tmp_path, raw, "depth/{}.png")
    write(tmp_path, raw, "confidence/{}.png")
    sequence = rp.open_sequence(tmp_path, CORNER)
    masked = sequence.masked(tmp_path / "confidence", 1000)
    rp.fit_sequence(masked, tmp_path / "out")
    assert rp.fit_sequence(masked, tmp_path / "out").resumed == 2
    with pytest.raises(ValueError, match="another sequence"):
        rp.fit_sequence(sequence, tmp_path / "out")


def test_sequences_of_functions_of_a_module_can_be_pickled(tmp_path, rng):
    import pickle

    raw = rng.integers(500, 2000, (2, 48, 64)).astype(np.uint16)
    write(tmp_path, raw, "depth/{}.png")
    sequence = sequences.folder(tmp_path, CORNER).with_swapped_bytes().with_float_scale(10.0)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(sequence))[1].depth, raw[1].byteswap())


def test_swapped_bytes_are_doubted(rng):
    depth = rp.scenes.room().render(presets.kinect_v1()).measure(seed=1)
    with pytest.warns(UserWarning, match=r"multiples of 256: .* frame\.byteswap\(\) swaps them"):
        rp.fit_tiles(depth.byteswap(), presets.kinect_v1())
    rp.fit_tiles(depth, presets.kinect_v1())
    coarse = (depth // 256 * 256).astype(np.uint16)  # all are multiples: a picture of 8 bits in 16
    rp.fit_tiles(coarse, presets.kinect_v1())
    rp.fit_tiles(rng.integers(1, 60000, (480, 640)).astype(np.uint16), presets.kinect_v1().with_noise(None))


def test_disparities_on_the_side_that_means_missing_are_doubted():
    camera = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, disparity=(0.02, 0.0))
    values = np.linspace(5, 60, 64 * 48).reshape(48, 64).astype(np.float32)
    for wrong, made in ((-values, camera), (values, rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, disparity=(-0.02, 0.0)))):
        with pytest.warns(
            UserWarning, match=r"no 1/Z = .* is positive, and all of it is missing: .* reads them"
        ) as told:
            tiles = rp.fit_tiles(wrong, made)
        assert len(told) == 1
        assert not tiles.fitted.any()
    rp.fit_tiles(values, camera)
    rp.fit_tiles(np.zeros((48, 64)), camera)  # nothing is measured
    rp.fit_tiles(np.full((48, 64), -1.0), camera)  # a number that stands for missing
