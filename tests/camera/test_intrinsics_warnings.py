"""Intrinsics of another image size, or in another order, are doubted; those of sensors are not."""

from dataclasses import replace

import numpy as np
import pytest

import rgbd_planes as rp
from bench import real_data
from rgbd_planes import Camera
from rgbd_planes.camera import presets

DOUBLED = (320, 240, 525.0, 525.0, 319.5, 239.5)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        (DOUBLED, r"cx = 319\.5 is 50% of the width off .* 640 x 480 has its middle there\. Camera\.resized makes"),
        ((1280, 960, 525.0, 525.0, 319.5, 239.5), "cx = 319.5 is 25% of the width off"),
        ((640, 480, 600.0, 600.0, 423.5, 239.5), "cx = 423.5 is 16% of the width off"),
        ((640, 360, 525.0, 525.0, 319.5, 239.5), "cy = 239.5 is 17% of the height off"),
        ((640, 480, 525.0, 525.0, 239.5, 319.5), "are they swapped"),
        ((512, 424, 365.5, 365.5, 205.4, 254.9), "are they swapped"),
        ((640, 480, 525.0, 319.5, 525.0, 239.5), "in the order fx, cx, fy, cy"),
        ((640, 480, 241.0, 426.0, 319.5, 239.5), "fx = 241 and fy = 426 differ by 1.77 times"),
        ((80, 60, 131.0, 131.0, 79.5, 59.5), "cx = 79.5 is 50% of the width off"),
    ],
)
def test_intrinsics_of_another_image_are_doubted_once(numbers, words):
    with pytest.warns(UserWarning, match=words) as told:
        Camera(*numbers)
    assert len(told) == 1
    assert told[0].filename == __file__


def test_whoever_states_them(tmp_path):
    width, height, fx, fy, cx, cy = DOUBLED
    matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    realsense = {
        "width": width, "height": height, "fx": fx, "fy": fy, "ppx": cx, "ppy": cy, "model": "none", "coeffs": [0] * 5,
    }  # fmt: skip
    ros = {"width": width, "height": height, "K": np.ravel(matrix).tolist(), "D": [], "P": [0.0] * 12}
    open3d = {"width": width, "height": height, "intrinsic_matrix": np.ravel(np.transpose(matrix)).tolist()}
    (tmp_path / "camera.json").write_text(
        '{"width": 320, "height": 240, "fx": 525, "fy": 525, "cx": 319.5, "cy": 239.5}'
    )
    for make in (
        lambda: Camera.from_opencv(matrix, None, (width, height)),
        lambda: Camera.from_realsense(realsense),
        lambda: Camera.from_ros(ros),
        lambda: Camera.from_open3d(open3d),
        lambda: Camera.load(tmp_path / "camera.json"),
    ):
        with pytest.warns(UserWarning, match="off the middle of an image of 320 x 240") as told:
            make()
        assert [warning.filename for warning in told] == [__file__]


def test_parts_of_an_image_are_not_asked(tmp_path):
    part = presets.kinect_v1().cropped(0, 0, 200, 150)
    assert part.cx == 319.5
    part.save(tmp_path / "part.json")
    assert Camera.load(tmp_path / "part.json") == part  # warnings are errors here
    assert rp.Camera.from_dict(part.to_dict()).with_noise(None).resized(100, 75).is_part
    roi = {"x_offset": 300, "y_offset": 200, "width": 320, "height": 240}
    info = {"width": 640, "height": 480, "K": [525.0, 0, 319.5, 0, 525.0, 239.5, 0, 0, 1], "D": [], "roi": roi}
    assert Camera.from_ros(info).is_part
    assert not Camera.from_ros({**info, "roi": None}).is_part
    assert Camera(*DOUBLED, is_part=True).cx == 319.5


def test_presets_and_modes_are_not_doubted():
    made = [make for make in vars(presets).values() if getattr(make, "__module__", "") == presets.__name__]
    for make in made:
        assert make().tan_x.shape == make().shape
    for width, height in ((1280, 720), (848, 480), (640, 360)):
        presets.realsense_d435(width, height)
    Camera(640, 576, 504.6, 504.7, 332.8, 348.8)  # an Azure Kinect's narrow mode, 10.6 % off
    Camera(512, 512, 1586.1, 2301.1, 255.0, 255.0)  # a range scanner
    Camera(640, 240, 525.0, 262.5, 319.5, 119.5)  # every other line left out


@pytest.mark.skipif(not real_data.FOLDER.is_dir(), reason=real_data.REASON)
def test_real_cameras_are_not_doubted():
    files = sorted(real_data.FOLDER.glob("*/camera.json"))
    assert len(files) > 10
    for file in files:
        camera = Camera.load(file)
        assert camera._without_ray is None


def test_a_resize_that_changes_the_shape_says_crop_first():
    camera = presets.kinect_v1()
    with pytest.warns(UserWarning, match=r"camera\.cropped\(0, 60, 640, 360\)\.resized\(160, 90\) is right") as told:
        camera.resized(160, 90)
    assert len(told) == 1
    assert camera.cropped(0, 60, 640, 360).resized(160, 90).fx == camera.cropped(0, 60, 640, 360).resized(160, 90).fy
    assert camera.resized(160, 90, stretched=True).fy == 525.0 * 90 / 480
    for width, height in ((320, 240), (213, 160), (160, 120), (80, 60), (1280, 960), (300, 225)):
        camera.resized(width, height)
    with pytest.raises(ValueError, match=r"camera\.cropped\(left, top, width, height\) is that of a part"):
        rp.fit_tiles(np.ones((90, 160)), camera)


PUBLISHED = Camera(  # a Kinect's, as CAPE's example data have it
    640, 480, 575.93, 576.41, 315.15, 230.59, (-0.0451, 0.2395, -0.0096, -0.0029, -1.0148), depth_scale=1000.0
)


def test_a_published_lens_that_folds_in_the_corners():
    camera = rp.Camera(**{**PUBLISHED.to_dict(), "distortion": PUBLISHED.distortion})
    depth = np.full(camera.shape, 1500, np.uint16)
    with pytest.warns(UserWarning, match=r"^3219 pixels of 640 x 480 \(1\.0 %\) have no single ray"):
        points = camera.points(depth)
    tiles = rp.fit_tiles(depth, camera, 32)  # said once: another warning would be an error here
    camera.with_noise(rp.noise.kinect_v1()).points(depth)
    missing = np.isnan(points[..., 2])
    assert np.count_nonzero(missing) == 3219
    assert missing[[0, 0, -1, -1], [0, -1, 0, -1]].all()
    assert not missing[:, 60:-60].any()
    cv2 = pytest.importorskip("cv2")
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    back = cv2.projectPoints(points[~missing], np.zeros(3), np.zeros(3), matrix, np.array(camera.distortion))[0][:, 0]
    row, column = np.nonzero(~missing)
    np.testing.assert_allclose(back, np.stack([column, row], axis=1), atol=1e-7)
    assert tiles.fitted.mean() > 0.97


def test_replacing_the_unit_says_how():
    with pytest.raises(ValueError, match=r"replace\(camera, depth_scale=None, disparity=\.\.\.\)"):
        replace(presets.kinect_v1(), disparity=(0.001, 0.0))


OAK = {
    "width": 640, "height": 480, "distortion_model": "plumb_bob", "D": [], "K": [0.0] * 9,
    "P": [450.0, 0, 320.0, 0, 0, 451.0, 240.0, 0, 0, 0, 1, 0],
}  # fmt: skip


def test_ros_cameras_that_fill_one_matrix():
    assert Camera.from_ros(OAK) == Camera(640, 480, 450.0, 451.0, 320.0, 240.0)
    with pytest.raises(ValueError, match="its P is there: rectified=True takes that"):
        Camera.from_ros(OAK, rectified=False)
    other = {**OAK, "K": [450.0, 0, 320.0, 0, 451.0, 240.0, 0, 0, 1], "P": [0.0] * 12}
    assert Camera.from_ros(other) == Camera.from_ros(OAK)
    with pytest.raises(ValueError, match="its K is there: rectified=False takes that"):
        Camera.from_ros(other, rectified=True)
