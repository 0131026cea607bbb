"""Calibration files of other tools, as these tools write them, by `Camera.load`."""

import json

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes import Camera
from rgbd_planes.camera.calibrations import yaml_subset

PINHOLE = {"width": 640, "height": 480, "fx": 517.3, "fy": 516.5, "cx": 318.6, "cy": 255.3}
LENS = (0.26, -0.95, -0.005, 0.0026, 1.16)
CAMERA = Camera(**PINHOLE, distortion=LENS)
FISHEYE = Camera(**PINHOLE, distortion=(-0.002, 0.037, -0.036, 0.007), distortion_model="fisheye")

FILES = {
    "opencv.yml": (
        CAMERA,
        """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 517.3, 0., 318.6, 0.,
       5.165e+02, 255.3, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0.26, -0.95, -0.005,
       0.0026, 1.16 ]
avg_reprojection_error: 2.1e-01
""",
    ),
    "opencv.xml": (
        CAMERA,
        """<?xml version="1.0"?>
<opencv_storage>
<image_width>640</image_width>
<image_height>480</image_height>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    517.3 0. 318.6 0. 516.5 255.3 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>5</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    0.26 -0.95 -0.005 0.0026 1.16</data></distortion_coefficients>
</opencv_storage>
""",
    ),
    "opencv.json": (
        CAMERA,
        """{
    "image_size": [ 640, 480 ],
    "K": { "type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
        "data": [ 517.3, 0.0, 318.6, 0.0, 516.5, 255.3, 0.0, 0.0, 1.0 ] },
    "D": { "type_id": "opencv-matrix", "rows": 5, "cols": 1, "dt": "d", "data": [ 0.26, -0.95, -0.005, 0.0026, 1.16 ] }
}
""",
    ),
    "ros.yaml": (
        CAMERA,
        """image_width: 640
image_height: 480
camera_name: depth
camera_matrix:
  rows: 3
  cols: 3
  data: [517.3, 0, 318.6, 0, 516.5, 255.3, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.26, -0.95, -5e-03, 0.0026, 1.16]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [500, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, 0]
""",
    ),
    "camchain.yaml": (
        Camera(**PINHOLE, distortion=LENS[:4]),
        """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [0.26, -0.95, -0.005, 0.0026]
  distortion_model: radtan
  intrinsics: [517.3, 516.5, 318.6, 255.3]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
""",
    ),
    "camchain-fisheye.yaml": (
        FISHEYE,
        """cam0:
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.1]
  - [1.0, 0.0, 0.0, 0.2]
  - [0.0, 0.0, -1.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs:
  - -0.002
  - 0.037
  - -0.036
  - 0.007
  distortion_model: equidistant
  intrinsics: [517.3, 516.5, 318.6, 255.3]
  resolution: [640, 480]
""",
    ),
    "TUM1.yaml": (
        Camera(**PINHOLE, distortion=LENS, depth_scale=5000.0),
        """%YAML:1.0

#--------------------------------------------------------------------------------------------
# Camera Parameters. Adjust them!
#--------------------------------------------------------------------------------------------
Camera.type: "PinHole"
Camera.fx: 517.3
Camera.fy: 516.5
Camera.cx: 318.6
Camera.cy: 255.3

Camera.k1: 0.26
Camera.k2: -0.95
Camera.p1: -0.005
Camera.p2: 0.0026
Camera.k3: 1.16

Camera.width: 640
Camera.height: 480

# Camera frames per second
Camera.fps: 30.0
Camera.bf: 40.0
ThDepth: 40.0

# Deptmap values factor
DepthMapFactor: 5000.0
""",
    ),
    "orb3.yaml": (
        Camera(**PINHOLE, distortion=FISHEYE.distortion, distortion_model="fisheye", depth_scale=1000.0),
        """%YAML:1.0
File.version: "1.0"
Camera.type: "KannalaBrandt8"
Camera1.fx: 517.3
Camera1.fy: 516.5
Camera1.cx: 318.6
Camera1.cy: 255.3
Camera1.k1: -0.002
Camera1.k2: 0.037
Camera1.k3: -0.036
Camera1.k4: 0.007
Camera.width: 640
Camera.height: 480
RGBD.DepthMapFactor: 1000.0
""",
    ),
    "vins.yaml": (
        Camera(**PINHOLE, distortion=LENS[:4]),
        """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 640
image_height: 480
distortion_parameters:
   k1: 0.26
   k2: -0.95
   p1: -0.005
   p2: 0.0026
projection_parameters:
   fx: 517.3
   fy: 516.5
   cx: 318.6
   cy: 255.3
""",
    ),
    "cameras.txt": (
        Camera(**PINHOLE, distortion=LENS[:4]),
        """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 1
1 OPENCV 640 480 517.3 516.5 319.1 255.8 0.26 -0.95 -0.005 0.0026
""",
    ),
    "transforms.json": (
        Camera(**PINHOLE, distortion=(*LENS[:4], 0.0)),
        """{"camera_model": "OPENCV", "fl_x": 517.3, "fl_y": 516.5, "cx": 319.1, "cy": 255.8, "w": 640, "h": 480,
 "k1": 0.26, "k2": -0.95, "p1": -0.005, "p2": 0.0026,
 "frames": [{"file_path": "images/1.png", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}
""",
    ),
    "transforms_frames.json": (
        Camera(**PINHOLE),
        json.dumps(
            {
                "frames": [
                    {
                        "file_path": f"{i}.png",
                        "fl_x": 517.3,
                        "fl_y": 516.5,
                        "cx": 319.1,
                        "cy": 255.8,
                        "w": 640,
                        "h": 480,
                    }
                    for i in range(3)
                ]
            }
        ),
    ),
    "metadata": (  # of Record3D, which gives it no suffix: K column by column, depth of another size than the images
        Camera(192, 256, 200.0, 200.0, 0.2 * (478.5 + 0.5) - 0.5, 0.2 * (641.0 + 0.5) - 0.5),
        '{"h": 1280, "w": 960, "dh": 256, "dw": 192, "K": [1000, 0, 0, 0, 1000, 0, 478.5, 641, 1], "fps": 60}',
    ),
    "polycam.json": (
        Camera(**PINHOLE, depth_scale=1000.0),
        json.dumps({**PINHOLE, "blur_score": 80.1, "t_00": 1.0, "t_01": 0.0, "timestamp": 7, "neighbors": [1, 2]}),
    ),
    "open3d.json": (
        Camera(**PINHOLE),
        '{"width": 640, "height": 480, "intrinsic_matrix": [517.3, 0, 0, 0, 516.5, 0, 318.6, 255.3, 1]}',
    ),
    "realsense.json": (
        Camera(**PINHOLE),
        '{"width": 640, "height": 480, "fx": 517.3, "fy": 516.5, "ppx": 318.6, "ppy": 255.3, '
        '"model": "Brown Conrady", "coeffs": [0, 0, 0, 0, 0]}',
    ),
    "nice_slam.yaml": (
        Camera(**PINHOLE, depth_scale=6553.5),
        "cam:\n  H: 480\n  W: 640\n  fx: 517.3\n  fy: 516.5\n  cx: 318.6\n  cy: 255.3\n  png_depth_scale: 6553.5 #m\n",
    ),
    "1.pincam": (Camera(**PINHOLE, depth_scale=1000.0), "640 480 517.3 516.5 318.6 255.3"),
    "info.txt": (
        Camera(**PINHOLE, depth_scale=1000.0),
        "m_versionNumber = 4\nm_sensorName = StructureSensor\nm_colorWidth = 1296\nm_colorHeight = 968\n"
        "m_depthWidth = 640\n"
        "m_depthHeight = 480\nm_depthShift = 1000\n"
        "m_calibrationDepthIntrinsic = 517.3 0 318.6 0 0 516.5 255.3 0 0 0 1 0 0 0 0 1\nm_frames.size = 3\n",
    ),
}


def alike(camera, expected):
    for name in PINHOLE:
        assert getattr(camera, name) == pytest.approx(getattr(expected, name), abs=1e-9)
    assert camera.distortion == pytest.approx(expected.distortion, abs=1e-15)
    assert camera.distortion_model == expected.distortion_model
    assert camera.depth_scale == expected.depth_scale


@pytest.mark.parametrize("name", FILES)
def test_files_of_other_tools(tmp_path, name):
    expected, text = FILES[name]
    (tmp_path / name).write_text(text)
    alike(Camera.load(tmp_path / name), expected)
    assert Camera.load(tmp_path / name, depth_scale=4000.0).depth_scale == 4000.0


@pytest.mark.parametrize("name", ["opencv.yml", "opencv.xml"])
def test_what_opencv_itself_writes(tmp_path, name):
    cv2 = pytest.importorskip("cv2")
    storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Sun 29 Nov 2026 12:00:00")
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array([[517.3, 0, 318.6], [0, 516.5, 255.3], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([LENS]))
    storage.release()
    alike(Camera.load(tmp_path / name), CAMERA)


@pytest.mark.parametrize(
    ("model", "parameters", "expected"),
    [
        ("SIMPLE_PINHOLE", "500 320 240", {}),
        ("PINHOLE", "500 500 320 240", {}),
        ("SIMPLE_RADIAL", "500 320 240 0.1", {"distortion": (0.1, 0, 0, 0)}),
        ("RADIAL", "500 320 240 0.1 -0.2", {"distortion": (0.1, -0.2, 0, 0)}),
        ("FULL_OPENCV", "500 500 320 240 .1 .2 .003 .004 .5 .6 .7 .8",
         {"distortion": (0.1, 0.2, 0.003, 0.004, 0.5, 0.6, 0.7, 0.8)}),
        ("OPENCV_FISHEYE", "500 500 320 240 0 0 0 0", {"distortion": (0,) * 4, "distortion_model": "fisheye"}),
        ("SIMPLE_RADIAL_FISHEYE", "500 320 240 0.1", {"distortion": (0.1, 0, 0, 0), "distortion_model": "fisheye"}),
    ],
)  # fmt: skip
def test_models_of_colmap(tmp_path, model, parameters, expected):
    (tmp_path / "cameras.txt").write_text(f"# comment\n3 {model} 640 480 {parameters}\n")
    camera = Camera.load(tmp_path / "cameras.txt")
    assert camera == Camera(640, 480, 500.0, 500.0, 319.5, 239.5, **expected)


def test_one_of_several_cameras(tmp_path):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 320 240 250 250 160 120\n")
    assert Camera.load(tmp_path / "cameras.txt", name="2").width == 320
    with pytest.raises(
        ValueError, match=r"cameras\.txt: expected one camera, got 1, 2: Camera\.load\(path, name='1'\)"
    ):
        Camera.load(tmp_path / "cameras.txt")
    with pytest.raises(ValueError, match="one of 1, 2, got '3'"):
        Camera.load(tmp_path / "cameras.txt", name="3")
    text = FILES["camchain.yaml"][1]
    (tmp_path / "camchain.yaml").write_text(text + text.replace("cam0:", "cam1:").replace("517.3", "520.0"))
    assert Camera.load(tmp_path / "camchain.yaml", name="cam1").fx == 520.0
    with pytest.raises(ValueError, match="got cam0, cam1"):
        Camera.load(tmp_path / "camchain.yaml")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.yaml", "", "an empty file"),
        ("a.yaml", "%YAML:1.0\nK: !!opencv-matrix\n   rows: 3\n   cols: 3\n   data: [1.,0,3,0,1,4,0,0,1]\n",
         r"expected the size of the images .* Camera\.from_opencv\(matrix, distortion, \(width, height\)\)"),
        ("a.yaml", "a: [1, 2", "a bracket that is never closed"),
        ("a.yaml", "width: 640\nheight: 480\nfx: 500\n", "missing: fy, cx, cy"),
        ("cam.yaml", "cam0:\n  camera_model: omni\n  intrinsics: [1, 2]\n", "camera_model pinhole, got 'omni'"),
        ("cam.yaml", "cam0:\n  camera_model: pinhole\n  intrinsics: [1, 2]\n", "expected 4 numbers in intrinsics"),
        ("matrix.txt", "500 0 320\n0 500 240\n0 0 1\n", r"do not say the size .* Camera\.from_opencv\(numpy\.loadtxt"),
        ("calib.npz", "PK", r"Camera\.from_opencv\(values\['mtx'\], values\['dist'\]"),
        ("cameras.bin", "x", "colmap model_converter"),
        ("cameras.txt", "1 FOV 640 480 500 500 320 240 0.9\n", "expected a model of COLMAP .* got FOV"),
        ("cameras.txt", "1 PINHOLE 640 480 500 320 240\n", "expected 4 parameters of PINHOLE, got 3"),
        ("a.xml", "<opencv_storage><a></opencv_storage>", r"expected XML as cv2\.FileStorage writes it"),
        ("transforms.json", '{"fl_x": 500}', "expected the size of the images in a calibration of nerfstudio"),
        ("b.yaml", "&a [*a, *a]", "expected YAML|expected a calibration|expected the camera keys"),
    ],
)  # fmt: skip
def test_what_is_no_calibration_says_the_way_on(tmp_path, name, content, words):
    (tmp_path / name).write_text(content)
    with pytest.raises((TypeError, ValueError), match=words) as told:
        Camera.load(tmp_path / name)
    assert name in str(told.value)
    assert "\n" not in str(told.value)


def test_the_way_on_from_a_mapping():
    record3d = {"w": 960, "h": 1280, "K": [1000, 0, 0, 0, 1000, 0, 478.5, 641, 1]}
    with pytest.raises(ValueError, match=r"Camera\.load reads Record3D's JSON"):
        Camera.from_dict(record3d)


def test_yaml_against_a_reader_of_all_of_it():
    yaml = pytest.importorskip("yaml")
    for name, (_, text) in FILES.items():
        if name.endswith("yaml") and not text.startswith("%"):
            ours, theirs = yaml_subset.parse(text), yaml.safe_load(text)
            # PyYAML follows YAML 1.1, in which 1e-3 without a point is a text.
            assert json.dumps(ours) == json.dumps(theirs).replace('"-5e-03"', "-0.005")
    text = "a:\n- 1\n- b: 2\n  c: [x, {d: 'e, f'}]\n-\n  - 3\nk: \"q # r\" # s\nn: null\nt: true\n"
    assert yaml_subset.parse(text) == yaml.safe_load(text)


def test_rgbd_planes_own_files_stay_what_they_are(tmp_path):
    camera = rp.presets.tum_freiburg1().with_noise(rp.noise.kinect_v1())
    camera.save(tmp_path / "camera.json")
    assert Camera.load(tmp_path / "camera.json") == camera
    assert "is_part" not in json.loads((tmp_path / "camera.json").read_text())
