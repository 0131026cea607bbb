"""Frames of distances along the ray, and of another unit, are told from frames of depth, and nothing else is."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import rgbd_planes as rp
from bench import real_data
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.frame_warnings import warn_of_distances, warn_of_reach
from rgbd_planes.cli import main as cli
from rgbd_planes.evaluation import scenes

CAMERAS = {
    "kinect": replace(rp.presets.primesense(), depth_scale=None),
    "distorted": replace(rp.presets.tum_freiburg1(), depth_scale=None),
    "negative fy": replace(rp.presets.icl_nuim(), depth_scale=None),
    "wide": rp.Camera(256, 256, 128.0, 128.0, 127.5, 127.5),
    "small": rp.Camera(80, 60, 65.0, 65.0, 39.5, 29.5),
    "narrow": rp.Camera(640, 480, 1200.0, 1200.0, 319.5, 239.5),
}
cameras = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def ray(camera):
    return np.sqrt(1.0 + camera.tan_x**2 + camera.tan_y**2)


def says_so(depth, camera):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.filterwarnings("ignore", message="many pixels are")  # of a sky
        warn_of_distances(as_depth_frame(depth, camera), camera)
    assert all("flat as distances along the ray" in str(warning.message) for warning in caught)
    return bool(caught)


@cameras
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_distances_are_told(camera, dtype):
    distance = (scenes.room().render(camera).depth * ray(camera)).astype(dtype)
    assert says_so(distance, camera)
    if camera.height > 100:  # too little is left of fewer rows
        distance[: camera.height // 4] = 1e10  # a sky
        assert says_so(distance, camera)


@cameras
def test_depth_and_what_does_not_tell_pass(camera):
    rendering = scenes.room().render(camera)
    depth = rendering.depth
    noisy = rendering.measure(quantise=False)
    with_sky = np.where(np.indices(depth.shape)[0] < camera.height // 4, 1e10, depth)
    for frame in (depth, depth.astype(np.float32), depth.astype(np.float16), with_sky, noisy, noisy * ray(camera)):
        assert not says_so(frame, camera)
    assert not says_so(depth / ray(camera), camera)  # divided twice
    assert not says_so(np.full_like(depth, np.nan), camera)
    scale, offset = 0.01, 0.2
    assert not says_so((1.0 / (depth * ray(camera)) - offset) / scale, replace(camera, disparity=(scale, offset)))


@cameras
@pytest.mark.parametrize("share", [0.003, 0.03, 0.3])
def test_outliers_pass(camera, share, rng):
    """Near ones are farther off in inverse depth than as numbers."""
    depth = scenes.room().render(camera).measure(quantise=False)
    outliers = rng.random(depth.shape) < share
    depth[outliers] = 1.0 / rng.uniform(0.2, 2.0, np.count_nonzero(outliers))
    assert not says_so(depth, camera)


@cameras
def test_a_patch_that_is_flat_as_distances_is_not_enough(camera):
    """Beside a wall that is flat as depth."""
    wall = 1.0 / (0.5 + 0.1 * camera.tan_x + 0.05 * camera.tan_y)
    patch = wall * ray(camera)
    patch[:, : camera.width // 2] = np.nan
    assert says_so(patch, camera)
    assert not says_so(np.where(np.isnan(patch), wall, patch), camera)


@pytest.mark.parametrize("name", ["kinect", "distorted", "wide", "small"])
def test_distances_that_were_rounded_or_have_a_little_noise_are_told(name, rng):
    """And depths of the same kind are not."""
    camera = replace(CAMERAS[name], depth_scale=1000.0)
    depth = scenes.room().render(camera).depth
    for made in (
        lambda frame: np.rint(1000.0 * frame).astype(np.uint16),
        lambda frame: np.rint(1e6 * frame).astype(np.int32) / 1e6,
        lambda frame: frame.astype(np.float16),
        lambda frame: frame + 1e-4 * rng.normal(size=frame.shape),
    ):
        assert says_so(made(depth * ray(camera)), camera)
        assert not says_so(made(depth), camera)


@cameras
def test_inverse_depths_and_z_buffers_are_told(camera):
    depth = scenes.room().render(camera).depth
    near, far = 0.1, 20.0
    buffer = (1.0 / near - 1.0 / depth) / (1.0 / near - 1.0 / far)
    for frame in (buffer, 1.0 / depth, (30.0 / depth + 5.0).astype(np.float32)):
        with pytest.warns(UserWarning, match="flat as the numbers are: if it holds inverse depths") as told:
            warn_of_distances(as_depth_frame(frame, camera), camera)
        assert len(told) == 1
    read = replace(camera, disparity=(-(1.0 / near - 1.0 / far), 1.0 / near))
    np.testing.assert_allclose(read.points(buffer)[..., 2], depth, rtol=1e-9)
    corner = 1.0 / np.maximum(0.3 + 0.25 * camera.tan_x, 0.3 - 0.2 * camera.tan_x)
    for frame in (corner, corner.astype(np.float32), corner.astype(np.float16), np.rint(1000.0 * corner) / 1000.0):
        warn_of_distances(as_depth_frame(frame, camera), camera)
    warn_of_distances(as_depth_frame(buffer, read), read)  # nothing is said: warnings are errors here


@pytest.mark.skipif(not real_data.FOLDER.is_dir(), reason=real_data.REASON)
def test_real_frames_are_depth():
    files = sorted(real_data.FOLDER.glob("*/depth/*.png"))
    for file in files[:: max(1, len(files) // 40)]:
        camera = rp.Camera.load(file.parents[1] / "camera.json")
        for warn in (warn_of_distances, warn_of_reach):
            warn(as_depth_frame(rp.images.read_depth(file), camera), camera)


@cameras
@pytest.mark.parametrize("radius", [0.8, 1.0, 1.2, 1.5])
def test_a_ball_that_bulges_like_distances_of_a_wall_passes(camera, radius):
    rays = np.stack([camera.tan_x, camera.tan_y, np.ones_like(camera.tan_x)], axis=-1)
    centre = np.array([0.1, -0.1, 1.0 + radius])
    a, b = (rays**2).sum(axis=-1), rays @ centre
    with np.errstate(invalid="ignore"):
        assert not says_so((b - np.sqrt(b * b - a * (centre @ centre - radius**2))) / a, camera)


def test_segment_says_so():
    camera = CAMERAS["kinect"]
    distance = (scenes.room().render(camera).depth * ray(camera)).astype(np.float32)
    with pytest.warns(UserWarning, match="divide it by") as caught:
        rp.segment(distance, camera)
    assert [warning.filename for warning in caught] == [__file__]
    rp.segment(distance / ray(camera), camera)  # nothing is said: warnings are errors here


def test_an_estimate_of_noise_says_so():
    camera = CAMERAS["kinect"]
    frames = [scenes.room((0.3 * i, -1.5, -0.1 * i)).render(camera).depth * ray(camera) for i in range(2)]
    with pytest.warns(UserWarning, match="divide it by"):
        rp.estimate_noise(frames, camera)


@pytest.mark.filterwarnings("default")
def test_the_commands_say_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    camera = CAMERAS["kinect"]
    depth = scenes.room().render(camera).depth
    camera.save("camera.json")
    for name, frame in (("distance", depth * ray(camera)), ("depth", depth)):
        Image.fromarray(frame.astype(np.float32)).save(f"{name}.tif")
        for command in ("fit", "segment", "normals"):
            assert cli.main([command, f"{name}.tif", "--camera", "camera.json"]) == 0
            said = capsys.readouterr().err
            assert said.count("flat as distances along the ray") == (name == "distance")


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("options", [[], ["--segments"]], ids=["tiles", "segments"])
def test_the_batch_command_says_so(tmp_path, capsys, options):
    pytest.importorskip("pyarrow")
    command = ["batch", str(frames_of_distances(tmp_path / "frames")), "--out", str(tmp_path / "out")]
    assert cli.main([*command, *options]) == 1  # for the damaged frame
    assert capsys.readouterr().err.count("flat as distances along the ray") == 1


def frames_of_distances(path, count=12):
    """A folder of frames of distances along the ray, the first of which is damaged."""
    camera = CAMERAS["small"]
    path.mkdir()
    camera.save(path / "camera.json")
    for i in range(count):
        np.save(path / f"{i}.npy", scenes.room((0.02 * i, -1.5, -0.2)).render(camera).depth * ray(camera))
    (path / "0.npy").write_bytes(b"")
    return path


def batch_says(sequence, out, **options):
    """The names of the frames that a batch warns of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rp.fit_sequence(sequence, out, **options)
    assert all(warning.filename == __file__ for warning in caught)
    names, sayings = zip(*(str(warning.message).split(": ", 1) for warning in caught), strict=True)
    assert all(saying.startswith("this frame's surfaces are bent") for saying in sayings)
    return list(names)


def test_a_batch_says_so_once_a_call(tmp_path):
    pytest.importorskip("pyarrow")
    sequence = rp.open_sequence(frames_of_distances(tmp_path / "frames"))
    out = tmp_path / "out"
    assert batch_says(sequence, out, num_threads=1) == ["1.npy"]
    assert rp.fit_sequence(sequence, out).resumed == 12  # nothing is done, and nothing is said
    (out / "part-000002.parquet").unlink()
    assert batch_says(sequence, out, num_threads=1) == ["8.npy"]
    np.save(tmp_path / "frames" / "0.npy", scenes.room().render(CAMERAS["small"]).depth * ray(CAMERAS["small"]))
    assert batch_says(sequence, out, num_threads=1, retry=True) == ["0.npy"]


def test_a_worker_elsewhere_says_so_of_its_part(tmp_path):
    pytest.importorskip("pyarrow")
    from rgbd_planes.batch.table import Columns
    from rgbd_planes.batch.worker import fit_part

    sequence = rp.open_sequence(frames_of_distances(tmp_path / "frames", 3))
    for segments in (False, True):
        settings, columns = rp.FitSettings(segments=segments), Columns(segments, False, False)
        for where in (None, tmp_path / "part.parquet"):
            part = fit_part(sequence, 0, settings, columns, where)
            assert [name for name, _ in part.warnings.values()] == ["1.npy"]


@pytest.mark.parametrize("preset", ["kinect_v1", "primesense", "kinect_v1_infrared", "seven_scenes"])
def test_files_of_tum_by_a_camera_of_millimetres_are_told(preset):
    camera = getattr(rp.presets, preset)()
    metres = np.full(camera.shape, 1.5)
    metres[:120] = 2.4  # a quarter
    for scaled in (camera, camera.with_noise(rp.noise.kinect_v1())):
        with pytest.warns(UserWarning, match=r"25% of this frame .* depth_scale=5000, .* --depth-scale 5000") as told:
            rp.segment((5000.0 * metres).astype(np.uint16), scaled)
        assert [warning.filename for warning in told] == [__file__]
    # Nothing is said of these: warnings are errors here.
    rp.segment((1000.0 * metres).astype(np.uint16), camera)
    rp.segment((5000.0 * metres).astype(np.uint16), replace(camera, depth_scale=5000.0))
    rp.segment((5000.0 * metres).astype(np.uint16), rp.Camera(640, 480, 400.0, 400.0, 319.5, 239.5, depth_scale=1000.0))
    rp.segment(5.0 * metres, camera)


@pytest.mark.filterwarnings("default")
def test_the_command_names_the_option(tmp_path, capsys):
    Image.fromarray(np.full((480, 640), 12000, np.uint16)).save(tmp_path / "tum.png")
    command = ["segment", str(tmp_path / "tum.png"), "--camera", "kinect_v1"]
    for options, count in (([], 1), (["--depth-scale", "5000"], 0)):
        assert cli.main([*command, *options]) == 0
        assert capsys.readouterr().err.count("--depth-scale 5000") == count
