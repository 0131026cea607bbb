"""The live loops of examples/, each with a stub of its driver that gives rendered frames and then Ctrl-C."""

import datetime
import importlib.util
import io
import sys
import threading
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from recordings import columns_of

import rgbd_planes as rp

FOLDER = Path(__file__).resolve().parents[2] / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))
CAMERA = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=1000.0)
FRAMES = 3

pytest.importorskip("shapely")


@pytest.fixture(scope="module")
def depths():
    """A camera that moves a little through the rendered room."""
    return [
        rp.scenes.room((0.35, -1.5, -0.2 + 0.02 * i)).render(CAMERA).measure(holes=0.03, seed=i) for i in range(FRAMES)
    ]


def example(name, monkeypatch, **drivers):
    """The module of an example, with stubs in place of the drivers that it imports."""
    for driver, stub in drivers.items():
        module = ModuleType(driver)
        module.__dict__.update(stub)
        monkeypatch.setitem(sys.modules, driver, module)
    spec = importlib.util.spec_from_file_location(f"example_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def check(path, depths, camera=CAMERA):
    """A recording shows these frames, by this camera, with their planes."""
    columns = columns_of(path)
    images = columns["/camera/depth", "DepthImage:buffer"]
    assert len(images) == len(depths)
    for image, depth in zip(images, depths, strict=True):
        metres = np.array(image[0], np.uint8).view(np.float32)
        np.testing.assert_allclose(metres, np.nan_to_num(camera.points(depth)[..., 2]).ravel(), rtol=1e-6)
    matrix = np.reshape(columns["/camera", "Pinhole:image_from_camera"][0], (3, 3)).T
    np.testing.assert_allclose(matrix, [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], rtol=1e-6)
    for number, depth in enumerate(depths):
        found = rp.segment(depth, camera)
        assert columns["/found", "Scalars:scalars"][number] == [len(found)]
        assert len(columns["/planes/outlines", "LineStrips3D:strips"][number]) >= len(found) > 5
    planes = [decoded(one[0]) for one in columns["/camera/planes", "EncodedImage:blob"]]
    measured = (depths[0] > 0) & (depths[1] > 0)
    alike = np.abs(planes[0].astype(int) - planes[1]).max(axis=-1) < 30
    assert np.mean(alike[measured]) > 0.8  # a plane keeps its colour


def decoded(image):
    """The pixels of an image as the recording has it."""
    return np.asarray(Image.open(io.BytesIO(bytes(image))).convert("RGB"))


@pytest.fixture
def recording(tmp_path):
    """Where an example writes what it shows; without rerun it is skipped."""
    pytest.importorskip("rerun")
    return tmp_path / "planes.rrd"


def test_realsense(depths, recording, monkeypatch):
    left, calls = list(depths), []

    class Frame:
        def __init__(self, depth):
            self._depth = depth

        def get_data(self):
            return memoryview(self._depth)

        def get_timestamp(self):
            return 1.7e12  # milliseconds

    class Pipeline:
        def start(self, config):
            assert config.enabled == [("depth", 160, 120, "z16", 30)]
            intrinsics = SimpleNamespace(
                width=160, height=120, ppx=79.5, ppy=59.5, fx=131.0, fy=131.0, model="distortion.brown_conrady",
                coeffs=[0.0] * 5,
            )  # fmt: skip
            stream = SimpleNamespace(get_intrinsics=lambda: intrinsics)
            sensor = SimpleNamespace(get_depth_scale=lambda: float(np.float32(0.001)))
            return SimpleNamespace(
                get_stream=lambda kind: SimpleNamespace(as_video_stream_profile=lambda: stream),
                get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor),
            )

        def wait_for_frames(self):
            if not left:
                raise KeyboardInterrupt
            frame = Frame(left.pop(0).copy())
            return SimpleNamespace(get_depth_frame=lambda: frame)

        def stop(self):
            calls.append("stop")

    class Config:
        def __init__(self):
            self.enabled = []

        def enable_stream(self, *what):
            self.enabled.append(what)

    stub = {
        "pipeline": Pipeline, "config": Config, "pipeline_profile": object,
        "stream": SimpleNamespace(depth="depth"), "format": SimpleNamespace(z16="z16"),
    }  # fmt: skip
    module = example("realsense", monkeypatch, pyrealsense2=stub)
    module.main(["--show", str(recording), "--size", "160", "120"])
    assert calls == ["stop"]
    check(recording, depths)


def test_azure_kinect(depths, recording, monkeypatch):
    left, calls = [None, *depths], []  # a capture may lack its depth

    class Device:
        def __init__(self, config):
            assert config == {"color_resolution": 0, "depth_mode": 2, "synchronized_images_only": False}
            matrix = np.array([[131.0, 0.0, 79.5], [0.0, 131.0, 59.5], [0.0, 0.0, 1.0]])
            self.calibration = SimpleNamespace(
                get_camera_matrix=lambda kind: matrix if kind == "depth" else None,
                get_distortion_coefficients=lambda kind: np.zeros(8) if kind == "depth" else None,
            )

        def start(self):
            calls.append("start")

        def stop(self):
            calls.append("stop")

        def get_capture(self):
            if not left:
                raise KeyboardInterrupt
            return SimpleNamespace(depth=left.pop(0), depth_timestamp_usec=33_333)

    stub = {
        "PyK4A": Device, "Config": dict, "ColorResolution": SimpleNamespace(OFF=0), "DepthMode": {"NFOV_UNBINNED": 2},
        "CalibrationType": SimpleNamespace(DEPTH="depth"), "Calibration": object,
    }  # fmt: skip
    example("azure_kinect", monkeypatch, pyk4a=stub).main(["--show", str(recording)])
    assert calls == ["start", "stop"]
    check(recording, depths)


def test_oak(depths, recording, monkeypatch):
    left = list(depths)

    class Frame:
        def __init__(self, depth):
            self._depth = depth

        def getFrame(self):  # noqa: N802 (the driver's names)
            return self._depth

        def getTimestamp(self):  # noqa: N802
            return datetime.timedelta(seconds=12.5)

        def getTransformation(self):  # noqa: N802
            matrix = [[131.0, 0.0, 79.5], [0.0, 131.0, 59.5], [0.0, 0.0, 1.0]]
            return SimpleNamespace(getIntrinsicMatrix=lambda: matrix)

    def take():
        if not left:
            raise KeyboardInterrupt
        return Frame(left.pop(0))

    class Stereo:
        subpixel = False

        def build(self, cameras, size):
            assert cameras
            assert size == (160, 120)
            return self

        def setSubpixel(self, on):  # noqa: N802
            self.subpixel = on

        @property
        def depth(self):
            def queue(maxSize, blocking):  # noqa: N803
                assert (maxSize, blocking, self.subpixel) == (1, False, True)
                return SimpleNamespace(get=take)

            return SimpleNamespace(createOutputQueue=queue)

    class Pipeline:
        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def create(self, node):
            return node()

        def start(self):
            self.running = True

        def isRunning(self):  # noqa: N802
            return self.running

    stub = {"Pipeline": Pipeline, "node": SimpleNamespace(StereoDepth=Stereo), "ImgFrame": Frame}
    example("oak", monkeypatch, depthai=stub).main(["--show", str(recording), "--size", "160", "120"])
    check(recording, depths)


def test_folder(depths, recording, monkeypatch, tmp_path, capsys):
    """Files appear one by one; one is half written at first, and one is no image at all."""
    watched = tmp_path / "frames"
    watched.mkdir()
    CAMERA.save(watched / "camera.json")
    module = example("folder", monkeypatch)
    monkeypatch.setattr(module, "PATIENCE", 0.3)
    shown = threading.Semaphore(0)

    class View(rp.LiveView):
        def show(self, *arguments, **more):
            super().show(*arguments, **more)
            shown.release()

    def write():
        for number, depth in enumerate(depths):
            rp.images.write_png(tmp_path / "next.png", depth)
            content = (tmp_path / "next.png").read_bytes()
            path = watched / f"{number}.png"
            if number == 1:
                path.write_bytes(content[:500])
                time.sleep(0.1)
            path.write_bytes(content)
            assert shown.acquire(timeout=60.0)
        (watched / "broken.png").write_bytes(b"no image")
        time.sleep(0.5)
        stop.set()

    stop, sleep = threading.Event(), time.sleep

    def sleep_or_stop(seconds):
        if stop.is_set() and threading.current_thread() is threading.main_thread():
            raise KeyboardInterrupt
        sleep(seconds)

    monkeypatch.setattr(rp, "LiveView", View)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=time.monotonic, sleep=sleep_or_stop))
    writer = threading.Thread(target=write)
    writer.start()
    module.main([str(watched), "--show", str(recording)])
    writer.join()
    check(recording, depths)
    assert capsys.readouterr().out.startswith(f"skipped {watched / 'broken.png'}: ")


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_ros2_node(encoding, depths, recording, monkeypatch):
    """Rows are padded, and the second half of the frames is big-endian."""
    published, subscribed, calls = [], {}, []

    class Image(SimpleNamespace):
        pass

    class Node:
        def __init__(self, name):
            assert name == "planes"

        def declare_parameter(self, name, value):
            return SimpleNamespace(value=str(recording) if name == "show" else value)

        def create_publisher(self, kind, topic, depth):
            assert (kind, topic) == (Image, "labels")
            return SimpleNamespace(publish=published.append)

        def create_subscription(self, kind, topic, callback, qos):
            subscribed[topic] = callback

        def destroy_node(self):
            calls.append("destroy")

    def image(number, depth):
        order = "<>"[number % 2]
        values = depth if encoding == "16UC1" else depth / np.float32(1000.0)
        rows = np.pad(values.astype(order + ("u2" if encoding == "16UC1" else "f4")), ((0, 0), (0, 4)))
        stamp = SimpleNamespace(sec=5, nanosec=500_000_000)
        return Image(
            header=SimpleNamespace(stamp=stamp), height=120, width=160, encoding=encoding, is_bigendian=number % 2,
            step=rows.strides[0], data=rows.tobytes(),
        )  # fmt: skip

    def spin(node):
        projection = [131.0, 0.0, 79.5, 0.0, 0.0, 131.0, 59.5, 0.0, 0.0, 0.0, 1.0, 0.0]
        info = SimpleNamespace(
            width=160, height=120, k=[100.0, 0.0, 80.0, 0.0, 100.0, 60.0, 0.0, 0.0, 1.0], d=[0.1, 0.0, 0.0, 0.0, 0.0],
            p=projection, distortion_model="plumb_bob", binning_x=0, binning_y=0,
            roi=SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0),
        )  # fmt: skip
        subscribed["depth"](image(0, depths[0]))  # before the camera is known
        subscribed["camera_info"](info)
        for number, depth in enumerate(depths):
            subscribed["depth"](image(number, depth))
        with pytest.raises(ValueError, match="16UC1 or 32FC1, got rgb8"):
            subscribed["depth"](Image(encoding="rgb8"))
        raise KeyboardInterrupt

    messages = {"CameraInfo": SimpleNamespace, "Image": Image}
    stubs = {
        "rclpy": {"init": lambda: None, "spin": spin, "try_shutdown": lambda: calls.append("shutdown")},
        "rclpy.node": {"Node": Node}, "rclpy.qos": {"qos_profile_sensor_data": object()},
        "sensor_msgs": {}, "sensor_msgs.msg": messages,
    }  # fmt: skip
    example("ros2_node", monkeypatch, **stubs).main()
    assert calls == ["destroy", "shutdown"]
    check(recording, depths)
    assert len(published) == FRAMES
    for message, depth in zip(published, depths, strict=True):
        labels = np.frombuffer(message.data, "<i4").reshape(message.height, message.width)
        assert (message.encoding, message.step) == ("32SC1", 640)
        found = rp.segment(depth, CAMERA)
        np.testing.assert_array_equal(labels > 0, found.labels > 0)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_tested(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 80
    assert f"test_{path.stem}" in globals()


def test_a_folder_without_a_camera_is_said_in_a_line(monkeypatch, tmp_path, capsys):
    with pytest.raises(SystemExit):
        example("folder", monkeypatch).main([str(tmp_path)])
    assert "camera.json: there is no such file" in capsys.readouterr().err.splitlines()[-1]
