"""The camera: rays, points, projection, files, importers, presets."""

import copy
import json
import math
import pickle
import re
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench import real_data
from rgbd_planes import TilePlanes, fit_tiles, noise
from rgbd_planes.camera import presets
from rgbd_planes.camera.camera import Camera
from rgbd_planes.camera.lenses import brown_conrady
from rgbd_planes.camera.lenses import distortion as lens_models
from rgbd_planes.camera.lenses.brown_conrady import TOLERANCE, distort
from rgbd_planes.camera.rays import rays_through

REAL = [root / "camera.json" for root in real_data.sets()]
real_cameras = pytest.mark.parametrize(
    "path",
    REAL or [pytest.param(None, marks=pytest.mark.skip(reason=real_data.REASON))],
    ids=lambda path: path.parent.name if path else "none",
)
PRESETS = [v for k, v in vars(presets).items() if callable(v) and v.__module__ == presets.__name__]
KINECT = (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
RATIONAL = (0.5479397, -0.0209714, 2.0557e-05, -7.2104e-05, -0.0026522, 0.889679, 0.0861302, -0.0139104)
FISHEYE = (-0.0023, 0.0372, -0.0365, 0.0069)
MATRIX = [[525.0, 0, 319.5], [0, 520.0, 239.5], [0, 0, 1]]


def small(**changed):
    return replace(Camera(64, 48, 52.0, 50.0, 31.0, 24.5), **changed)


def pixels(camera):
    return np.meshgrid(np.arange(camera.width), np.arange(camera.height))


def assert_rays_land_on_their_pixels(camera, atol):
    column, row = pixels(camera)
    ray = np.stack([camera.tan_x, camera.tan_y, np.ones(camera.shape)], -1)
    landed = camera.project(2.5 * ray)
    np.testing.assert_allclose(landed, np.stack([column, row], -1), atol=atol, rtol=0)


@pytest.mark.filterwarnings("ignore:c[xy] =:UserWarning")  # of parts of an image
@pytest.mark.parametrize("fy", [50.0, -48.0])
def test_rays_without_distortion(fy):
    camera = small(fy=fy, cx=-20.0, cy=70.25)
    column, row = pixels(camera)
    np.testing.assert_array_equal(camera.tan_x, (column - -20.0) / 52.0)
    np.testing.assert_array_equal(camera.tan_y, (row - 70.25) / fy)
    assert not camera.is_distorted
    np.testing.assert_array_equal(camera.tan_x_columns, camera.tan_x[0])
    np.testing.assert_array_equal(camera.tan_y_rows, camera.tan_y[:, 0])


@pytest.mark.parametrize("fy", [50.0, -50.0])
@pytest.mark.parametrize("distortion", [KINECT[:4], KINECT, RATIONAL])
def test_rays_with_distortion(distortion, fy):
    camera = small(distortion=distortion, fx=80.0, fy=np.copysign(80.0, fy), cx=30.3)
    assert camera.is_distorted
    x, y = distort(camera.tan_x, camera.tan_y, distortion)
    np.testing.assert_allclose(x, np.broadcast_to(camera.tan_x_columns, x.shape), atol=TOLERANCE, rtol=0)
    np.testing.assert_allclose(y, np.broadcast_to(camera.tan_y_rows[:, None], y.shape), atol=TOLERANCE, rtol=0)
    assert_rays_land_on_their_pixels(camera, 1e-8)


def test_rays_against_opencv():
    cv2 = pytest.importorskip("cv2")
    camera = Camera.from_opencv(MATRIX, KINECT, (640, 480))
    points = np.stack(pixels(camera), -1).reshape(-1, 1, 2).astype(float)
    undistort_points = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)  # OpenCV 4 and 5
    options = {"R": np.eye(3), "P": np.eye(3)}
    options["criteria"] = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 1000, 1e-14)
    expected = undistort_points(points, np.array(MATRIX), np.array(KINECT), **options).reshape(480, 640, 2)
    np.testing.assert_allclose(np.stack([camera.tan_x, camera.tan_y], -1), expected, atol=1e-9, rtol=0)


def test_inverse_brown_conrady_takes_the_pixel_to_the_ray():
    camera = small(distortion=KINECT, distortion_model="inverse_brown_conrady", fx=80.0, fy=80.0)
    plain = replace(camera, distortion=())
    x, y = distort(plain.tan_x, plain.tan_y, KINECT)
    np.testing.assert_array_equal(camera.tan_x, x)
    np.testing.assert_array_equal(camera.tan_y, y)
    assert_rays_land_on_their_pixels(camera, 1e-8)
    assert np.abs(camera.tan_x - replace(camera, distortion_model="brown_conrady").tan_x).max() > 1e-3


@pytest.mark.parametrize("lens", [(), (0.0,) * 4, FISHEYE])
def test_a_fisheye_bends_rays_also_where_all_coefficients_are_zero(lens):
    camera = small(distortion=lens, distortion_model="fisheye", fx=30.0, fy=-30.0)
    assert camera.distortion == (lens or (0.0,) * 4)
    assert camera.is_distorted
    assert_rays_land_on_their_pixels(camera, 1e-10)
    angle = np.arctan(np.hypot(camera.tan_x, camera.tan_y))
    if not any(lens):
        np.testing.assert_allclose(30 * angle, np.hypot(*np.subtract(pixels(camera), [[[31.0]], [[24.5]]])))
    assert np.degrees(angle.max()) > 70


def test_a_fisheye_sees_only_what_is_in_front_of_the_camera():
    camera = small(distortion_model="fisheye", fx=20.0, fy=20.0, depth_scale=1000.0)
    column, row = pixels(camera)
    unseen = np.hypot(column - 31.0, row - 24.5) >= 20.0 * np.radians(85)
    assert 0.1 < unseen.mean() < 0.2
    x, y = camera.tan_x[unseen], camera.tan_y[unseen]
    np.testing.assert_allclose(np.hypot(x, y), np.hypot(camera.tan_x, camera.tan_y)[~unseen].max())
    np.testing.assert_allclose(np.arctan2(y, x), np.arctan2(row - 24.5, column - 31.0)[unseen])
    narrow = replace(camera, distortion=(-1 / 3, 0, 0, 0), fx=40.0, fy=40.0)  # up to an angle of 1
    assert 1.4 < np.hypot(narrow.tan_x, narrow.tan_y).max() < np.tan(1.0)
    np.testing.assert_array_equal(np.isnan(camera.points(np.where(unseen, 0.0, 1.0))[..., 2]), unseen)
    seen = np.isfinite(camera.project([[0, 0, 1], [11, 0, 1], [12, 0, 1], [0, 0, -1]])).all(-1)
    assert seen.tolist() == [True, True, False, False]


def test_a_fisheye_with_its_focal_length_in_millimetres():
    camera = small(distortion_model="fisheye", fx=2.0, fy=2.0)
    message = r"inside the image, got 30\d\d of 3072 pixels, the first at row 0, column 0, .* up to 85 degrees"
    with pytest.raises(ValueError, match=message):
        _ = camera.tan_x


def test_zeros_at_the_end_of_a_distortion_make_no_other_camera():
    for same in (
        [small(distortion=(0.0,) * count) for count in (0, 4, 5, 8)],
        [small(distortion=KINECT[:4] + (0.0,) * count) for count in (0, 1, 4)],
        [small(distortion=KINECT + (0.0,) * count) for count in (0, 3)],
    ):
        assert len(set(same)) == 1
    assert small(distortion=KINECT[:4]) != small(distortion=KINECT)
    # Also where the other model takes five only.
    other = replace(small(distortion=(*KINECT[:4], 0.0)), distortion_model="inverse_brown_conrady")
    assert other.distortion == (*KINECT[:4], 0.0)


@pytest.mark.parametrize("model", ["brown_conrady", "inverse_brown_conrady"])
def test_a_distortion_that_folds_inside_the_image(model):
    """Pixels beyond the fold are missing, and counted in one warning, unless they are most of the image."""
    camera = small(distortion=(-0.5 if model == "brown_conrady" else -0.75, 0, 0, 0, 0), distortion_model=model)
    with pytest.warns(UserWarning, match=r"^\d+ pixels of 64 x 48 .* have no single ray") as warned:
        missing = np.isnan(camera.points(np.ones(camera.shape))[..., 2])
    assert str(warned[0].message).startswith(f"{np.count_nonzero(missing)} pixels of 64 x 48")
    assert 0 < missing.mean() < 0.3
    column, row = pixels(camera)
    folds = 0.5443 if model == "brown_conrady" else 2.0 / 3.0  # where the radial part has its largest value
    np.testing.assert_array_equal(missing, np.hypot((column - 31.0) / camera.fx, (row - 24.5) / camera.fy) > folds)
    assert missing[[0, 0, -1, -1], [0, -1, 0, -1]].all()  # the corners
    wide = small(distortion=(-1.0, 0, 0, 0, 0), distortion_model=model, fx=30.0, fy=30.0)
    message = (
        r"inside the image, got \d+% of the pixels without a single ray, one of them at row 0, column 0: .* 0\.577"
    )
    with pytest.raises(ValueError, match=message):
        _ = wide.tan_x
    assert small(distortion=(-1.0, 0, 0, 0, 0), distortion_model=model, fx=160.0, fy=160.0).tan_x.shape == (48, 64)


@pytest.mark.filterwarnings("ignore:c[xy] =:UserWarning")  # of parts of an image
def test_a_fold_between_the_axis_and_an_image_beside_it():
    # All of the image lies where the model grows again, past its fold.
    camera = small(
        fx=500.0, fy=500.0, cx=-700.0, distortion=(-2.0, 1.2, 0, 0, 0), distortion_model="inverse_brown_conrady"
    )
    with pytest.raises(ValueError, match=r"at row 0, column 0: the radial part folds at radius 0\.4597"):
        _ = camera.tan_x


def test_a_lens_that_cannot_be_inverted_is_refused_after_a_look_at_few_pixels(monkeypatch):
    """Looking for rays that are not there takes a hundred times as long as for others."""
    looked_at = []
    undistort = brown_conrady.undistort
    monkeypatch.setattr(brown_conrady, "undistort", lambda x, *rest: looked_at.append(x.size) or undistort(x, *rest))
    camera = Camera(1920, 1080, 500.0, 500.0, 959.5, 539.5, distortion=(0.1, -0.1, 0, 0, 0))
    with pytest.raises(ValueError, match="at row 0, column 0: the radial part folds"):
        _ = camera.tan_x
    assert sum(looked_at) < camera.width * camera.height / 200


def test_a_pixel_without_a_ray_between_those_that_are_looked_at_first(monkeypatch):
    camera = small(distortion=KINECT)
    single_rays = lens_models._single_rays

    def but_one(x, *rest):
        found = single_rays(x, *rest)
        if x.shape == camera.shape:
            found[2][5, 7] = False
        return found

    monkeypatch.setattr(lens_models, "_single_rays", but_one)
    with pytest.warns(UserWarning, match="^1 pixel of "):
        _ = camera.tan_x
    assert np.argwhere(camera._without_ray).tolist() == [[5, 7]]
    assert camera.tan_x[5, 7] in (camera.tan_x[5, 6], camera.tan_x[5, 8], camera.tan_x[4, 7], camera.tan_x[6, 7])


@pytest.mark.parametrize("distortion", [(), KINECT[:4]])
def test_tables_are_made_once_and_cannot_be_written(distortion):
    camera = small(distortion=distortion, fx=80.0, fy=80.0)
    barrier = threading.Barrier(8)
    seen = []

    def look():
        barrier.wait()
        seen.append((camera.tan_x, camera.tan_y))

    threads = [threading.Thread(target=look) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({(id(x), id(y)) for x, y in seen}) == 1
    for table in seen[0]:
        assert table.dtype == np.float64
        assert table.shape == (48, 64)
        assert table.flags.c_contiguous
        assert not table.flags.writeable
    assert not camera.tan_x_columns.flags.writeable
    assert not camera.tan_y_rows.flags.writeable


def test_a_camera_is_a_value():
    a, b = (small(distortion=[0.1, 0, 0, 0], invalid_values=[7]), small(distortion=(0.1, 0, 0, 0), invalid_values=(7,)))
    _ = a.tan_x
    assert a == b
    assert hash(a) == hash(b)
    assert a != small()
    for copied in (copy.copy(a), copy.deepcopy(a), pickle.loads(pickle.dumps(a))):
        assert copied == a
        assert not copied.tan_x.flags.writeable
    assert len(pickle.dumps(a)) < 1000  # without the tables
    with pytest.raises(AttributeError):
        a.fx = 3.0


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"width": 0}, "width must be at least 1, got 0"),
        ({"width": 2**31}, r"width must be below 2\*\*31, got 2147483648"),
        ({"fx": 0}, "expected fx in pixels, not 0"),
        ({"fx": 1e-300}, r"expected fx in pixels, 0.01 to 1e\+08 or minus that, got 1e-300"),
        ({"fy": -1e300}, r"expected fy in pixels, 0.01 to 1e\+08 or minus that, got -1e\+300"),
        ({"cx": 1e300}, r"expected cx in pixels, 0 to 1e\+08 or minus that, got 1e\+300"),
        ({"fy": np.nan}, "expected fy as a finite number, got nan"),
        ({"cx": np.inf}, "expected cx as a finite number, got inf"),
        ({"distortion": (1, 2, 3)}, "expected 0, 4, 5, 8 distortion coefficients .* got 3"),
        ({"distortion": (1, 2, 3, np.nan)}, "expected distortion as a finite number"),
        ({"distortion": (1e308,) * 8}, r"expected distortion coefficients of at most 1e\+60, got \(1e\+308, "),
        ({"distortion": (0,) * 8, "distortion_model": "inverse_brown_conrady"}, "expected 0, 5 distortion .* got 8"),
        ({"distortion_model": "ftheta"}, "distortion_model must be one of .* got 'ftheta'"),
        (
            {"distortion": (0.1,) * 5, "distortion_model": "fisheye"},
            r"expected 0, 4 distortion coefficients for fisheye .k1 k2 k3 k4., got 5",
        ),
        ({"depth_scale": 0}, "expected depth_scale > 0"),
        ({"depth_scale": -1000.0}, "expected depth_scale > 0 .* got -1000"),
        ({"depth_scale": 1000.0, "disparity": (1, 0)}, "expected depth_scale or disparity, got both"),
        ({"disparity": (0, 1)}, "expected disparity as .scale, offset., scale not 0"),
        ({"disparity": (1, 2, 3)}, "expected disparity as .scale, offset."),
        ({"depth_range": (3, 2)}, "expected depth_range as .nearest, farthest."),
        ({"depth_range": (-1, 2)}, "expected depth_range as .nearest, farthest."),
        ({"depth_range": (np.nan, 2)}, "expected depth_range as .nearest, farthest."),
    ],
)
def test_values_that_cannot_be_are_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        small(**changed)


@pytest.mark.parametrize(
    "changed",
    [
        {"width": 4.0},
        {"height": True},
        {"fx": "525"},
        {"fx": None},
        {"cx": True},
        {"distortion": 0.1},
        {"invalid_values": "0"},
    ],
)
def test_types_that_cannot_be_are_refused(changed):
    with pytest.raises(TypeError, match=rf"{next(iter(changed))} (as|must be) .*, got"):
        small(**changed)


@pytest.mark.parametrize("distortion", [(), KINECT[:4]])
def test_points_project_back_to_their_pixels(distortion):
    camera = small(distortion=distortion, fx=80.0, fy=-80.0, depth_scale=1000.0, depth_range=(0.1, 9))
    depth = np.random.default_rng(0).integers(0, 10000, camera.shape).astype(np.uint16)
    points = camera.points(depth)
    z = np.where((depth >= 100) & (depth <= 9000), depth / 1000.0, np.nan)
    np.testing.assert_array_equal(points, np.stack([z * camera.tan_x, z * camera.tan_y, z], -1))
    landed, column_row = camera.project(points), np.stack(pixels(camera), -1)
    valid = np.isfinite(z)
    np.testing.assert_allclose(landed[valid], column_row[valid], atol=1e-8)
    assert np.isnan(landed[~valid]).all()


LENSES = [
    {},
    {"distortion": KINECT, "fx": 80.0, "fy": -80.0},
    {"distortion": RATIONAL},
    {"distortion": (0.1, -0.02, 1e-3, 2e-3, 0.0), "distortion_model": "inverse_brown_conrady"},
    {"distortion": FISHEYE, "distortion_model": "fisheye", "fx": 30.0, "fy": 30.0},
]


@pytest.mark.parametrize("lens", LENSES)
def test_a_part_of_an_image_has_its_rays_and_its_noise(lens):
    camera = small(**lens, depth_scale=1000.0, noise=replace(noise.kinect_v1(), falloff=2.0, lateral=0.5))
    part = camera.cropped(20, 9, 31, 25)
    assert part == replace(camera, width=31, height=25, cx=camera.cx - 20, cy=camera.cy - 9)
    inside = slice(9, 34), slice(20, 51)
    for name in ("tan_x", "tan_y"):
        np.testing.assert_allclose(getattr(part, name), getattr(camera, name)[inside], rtol=0, atol=1e-9)
    assert camera.cropped(0, 0, *camera.shape[::-1]) == camera


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("size", [(32, 24), (21, 12), (128, 144)])
def test_a_pixel_of_a_resized_image_looks_through_the_middle_of_its_pixels(lens, size):
    camera = small(**lens, depth_scale=1000.0)
    resized = camera.resized(*size, stretched=True)
    pinhole = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    assert replace(resized, **pinhole) == camera
    step = np.array([camera.width / size[0], camera.height / size[1]])
    rays = np.stack([resized.tan_x, resized.tan_y, np.ones(resized.shape)], axis=-1)
    middles = (np.stack(pixels(resized), axis=-1) + 0.5) * step - 0.5
    np.testing.assert_allclose(camera.project(rays), middles, atol=1e-8)
    if size == (32, 24) and not lens:
        for name in ("tan_x", "tan_y"):
            of_four = getattr(camera, name).reshape(24, 2, 32, 2).mean(axis=(1, 3))
            np.testing.assert_allclose(getattr(resized, name), of_four, atol=1e-12)


def test_a_resized_image_has_another_noise():
    assert small(noise=noise.kinect_v1()).resized(640, 480).noise is None  # without a doubt about its intrinsics


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: small().resized(32.0, 24), TypeError, "width must be a whole number of pixels, got 32.0"),
        (lambda: small().resized(32, 0), ValueError, "height must be at least 1, got 0"),
        (lambda: small().cropped(-1, 0, 3, 3), ValueError, "left must be at least 0, got -1"),
        (lambda: small().cropped(0, 0.5, 3, 3), TypeError, "top must be a whole number of pixels, got 0.5"),
        (lambda: small().cropped(0, 0, 3, 0), ValueError, "height must be at least 1, got 0"),
        (lambda: small().cropped(2, 0, 63, 3), ValueError, "part of the image, of width 64, got left 2 and width 63"),
        (lambda: small().cropped(0, 46, 3, 3), ValueError, "part of the image, of height 48, got top 46 and height 3"),
    ],
)
def test_images_that_no_camera_resizes_or_crops(make, error, message):
    with pytest.raises(error, match=re.escape(message)):
        make()


def test_points_of_a_disparity_image():
    camera = small(disparity=(0.01, 0.1))
    points = camera.points(np.full(camera.shape, 40, np.uint16))
    np.testing.assert_allclose(points[..., 2], 2.0, rtol=1e-15)


def test_project_knows_what_cannot_be_seen():
    camera = small(distortion=(-0.3, 0, 0, 0))  # folds at radius 1.054
    points = [[0, 0, 1], [0, 0, -1], [0, 0, 0], [1.0, 0, 1], [1.1, 0, 1], [40.0, 0, 1], [np.nan, 0, 1]]
    seen = np.isfinite(camera.project(points)).all(-1)
    assert seen.tolist() == [True, False, False, True, False, False, False]
    inverse = small(distortion=(-0.3, 0, 0, 0, 0), distortion_model="inverse_brown_conrady")
    seen = np.isfinite(inverse.project(points)).all(-1)  # no place gives a ray beyond radius 0.703
    assert seen.tolist() == [True, False, False, False, False, False, False]
    with pytest.raises(ValueError, match=r"expected points of shape \(\.\.\., 3\), got \(2,\)"):
        camera.project([1.0, 2.0])


numbers = st.floats(-1e4, 1e4)
cameras = st.builds(
    Camera,
    width=st.integers(1, 5000),
    height=st.integers(1, 5000),
    fx=numbers.filter(lambda focal: abs(focal) >= 0.01),
    fy=numbers.filter(lambda focal: abs(focal) >= 0.01),
    cx=numbers,
    cy=numbers,
    distortion=st.sampled_from([(), KINECT[:4], KINECT, RATIONAL]),
    depth_scale=st.one_of(st.none(), st.floats(1.0, 1e6)),
    depth_range=st.one_of(st.none(), st.tuples(st.floats(0, 5), st.sampled_from([6.0, 20.0, np.inf]))),
    invalid_values=st.lists(st.one_of(st.integers(0, 65535), st.floats()), max_size=3).map(tuple),
)


@pytest.mark.filterwarnings("ignore:(with )?f[xy] =:UserWarning", "ignore:c[xy] =:UserWarning")  # that nobody has
@given(camera=cameras)
def test_json_gives_the_same_camera_back(camera):
    for lens in (camera, replace(camera, distortion=camera.distortion[:4], distortion_model="fisheye")):
        assert Camera.from_dict(json.loads(json.dumps(lens.to_dict(), allow_nan=False))) == lens
        assert pickle.loads(pickle.dumps(lens)) == lens


def test_save_and_load(tmp_path):
    camera = Camera(640, 480, 525.0, -525.0, 319.5, 239.5, KINECT, disparity=(-0.0028, 3.1), invalid_values=(2047,))
    camera = replace(camera, noise=noise.quantised(noise.kinect_v1(), camera))
    path = tmp_path / "camera.json"
    camera.save(path)
    camera.save(path)
    assert Camera.load(path) == camera
    assert json.loads(path.read_text())["disparity"] == {"scale": -0.0028, "offset": 3.1}
    assert list(tmp_path.iterdir()) == [path]


def test_save_where_nothing_can_be_written(tmp_path):
    with pytest.raises(FileNotFoundError):
        small().save(tmp_path / "no" / "camera.json")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        small().save(tmp_path / "folder")
    assert [p.name for p in tmp_path.iterdir()] == ["folder"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a JSON file, got .*camera.json"),
        ("[1]", "expected a JSON object in .*camera.json, got list"),
        ('{"width": 1', "expected a JSON file"),
        ('{"width": 1, "height": 2, "fx": 3, "cx": 5}', "missing: fy, cy"),
        ('{"width": 1, "height": 2, "fx": 3, "fy": 3, "cx": 5, "cy": 5, "scale": 7, "k1": 0}', "also k1, scale$"),
        ('{"width": 1, "height": 2, "intrinsic_matrix": []}', "Camera.from_open3d takes that"),
        ('{"width": 1, "height": 2, "K": []}', "Camera.from_ros takes that"),
        (
            '{"width": 1, "height": 2, "fx": 3, "fy": 3, "cx": 5, "cy": 5, "depth_scale": 0.001}',
            "got 0.001: if these are metres per unit, 1000 is meant",
        ),
    ],
)
def test_load_a_file_that_is_none(tmp_path, text, message):
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        Camera.load(path)


def test_load_a_file_that_begins_with_a_mark(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text("\r\n".join(json.dumps(small().to_dict(), indent=1).splitlines()), encoding="utf-8-sig")
    assert Camera.load(path) == small()


def test_load_a_missing_or_binary_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        Camera.load(tmp_path / "camera.json")
    (tmp_path / "camera.json").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(ValueError, match="expected a JSON file"):
        Camera.load(tmp_path / "camera.json")


def test_from_dict_refuses_a_strange_disparity():
    with pytest.raises(ValueError, match=r"disparity with the keys scale, offset, got scale$"):
        Camera.from_dict(small().to_dict() | {"disparity": {"scale": 1}})


def test_from_opencv():
    camera = Camera.from_opencv(np.array(MATRIX), np.array([KINECT]), (640, 480), depth_scale=1000.0)
    assert camera == Camera(640, 480, 525.0, 520.0, 319.5, 239.5, KINECT, depth_scale=1000.0)
    assert Camera.from_opencv(MATRIX, None, (640, 480)).distortion == ()
    column = np.reshape(FISHEYE, (4, 1))  # as cv2.fisheye.calibrate returns them
    fisheye = Camera.from_opencv(MATRIX, column, (640, 480), distortion_model="fisheye")
    assert fisheye == Camera(640, 480, 525.0, 520.0, 319.5, 239.5, FISHEYE, "fisheye")
    with pytest.raises(ValueError, match="distortion_model must be one of brown_conrady, fisheye, got 'ftheta'"):
        Camera.from_opencv(MATRIX, FISHEYE, (640, 480), distortion_model="ftheta")
    assert Camera.from_opencv(MATRIX, (*RATIONAL, 0, 0, 0, 0), (640, 480)).distortion == RATIONAL
    shifted = Camera.from_opencv(MATRIX, None, (640, 480), pixel_center=0.5)
    assert (shifted.cx, shifted.cy) == (319.0, 239.0)
    with pytest.raises(ValueError, match="at most 8 distortion coefficients"):
        Camera.from_opencv(MATRIX, (*RATIONAL, 0.1, 0, 0, 0), (640, 480))
    with pytest.raises(ValueError, match=r"camera_matrix of shape \(3, 3\), got \(4,\)"):
        Camera.from_opencv([525, 520, 319, 239], None, (640, 480))
    with pytest.raises(ValueError, match=r"camera_matrix as .*fx, 0, cx"):
        Camera.from_opencv([[525.0, 0.2, 319.5], [0, 520.0, 239.5], [0, 0, 1]], None, (640, 480))


def camera_info(**changed):
    return {
        "width": 640,
        "height": 480,
        "distortion_model": "plumb_bob",
        "D": list(KINECT),
        "K": [525.0, 0, 319.5, 0, 520.0, 239.5, 0, 0, 1],
        "R": np.eye(3).ravel().tolist(),
        "P": [500.0, 0, 310.0, -30.0, 0, 510.0, 230.0, 0, 0, 0, 1, 0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    } | changed


def as_object(info, lower):
    """As ROS 1 (K, D, P) or ROS 2 (k, d, p) has it."""
    names = {"K": "k", "D": "d", "P": "p", "R": "r"} if lower else {}
    attributes = {names.get(k, k): v for k, v in info.items()}
    attributes["roi"] = SimpleNamespace(**info["roi"])
    return SimpleNamespace(**attributes)


def as_file(info):
    """As camera_calibration writes it to YAML."""
    return {
        "image_width": info["width"],
        "image_height": info["height"],
        "camera_name": "camera",
        "camera_matrix": {"rows": 3, "cols": 3, "data": info["K"]},
        "distortion_model": info["distortion_model"],
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": info["D"]},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": info["R"]},
        "projection_matrix": {"rows": 3, "cols": 4, "data": info["P"]},
    }


@pytest.mark.parametrize("form", [dict, lambda i: as_object(i, False), lambda i: as_object(i, True), as_file])
def test_from_ros(form):
    info = form(camera_info())
    raw = Camera.from_ros(info, depth_scale=1000.0)
    assert raw == Camera(640, 480, 525.0, 520.0, 319.5, 239.5, KINECT, depth_scale=1000.0)
    assert Camera.from_ros(info, rectified=True) == Camera(640, 480, 500.0, 510.0, 310.0, 230.0)


@pytest.mark.parametrize("form", [dict, lambda i: as_object(i, False)])
def test_from_ros_region_and_binning(form):
    roi = {"x_offset": 100, "y_offset": 60, "width": 400, "height": 300, "do_rectify": False}
    whole = Camera.from_ros(camera_info())
    region = Camera.from_ros(form(camera_info(roi=roi)))
    assert region.shape == (300, 400)
    np.testing.assert_allclose(region.tan_x, whole.tan_x[60:360, 100:500], atol=1e-10)
    np.testing.assert_allclose(region.tan_y, whole.tan_y[60:360, 100:500], atol=1e-10)
    binned = Camera.from_ros(form(camera_info(roi=roi, binning_x=2, binning_y=3)))
    assert binned.shape == (100, 200)
    np.testing.assert_allclose(binned.tan_x, region.tan_x[::3, ::2], atol=1e-10)
    np.testing.assert_allclose(binned.tan_y, region.tan_y[::3, ::2], atol=1e-10)
    rectified = Camera.from_ros(form(camera_info(roi=roi, binning_x=2)), rectified=True)
    assert rectified == Camera(200, 300, 250.0, 510.0, 105.0, 170.0)
    beside = form(camera_info(roi={"x_offset": 400, "y_offset": 0, "width": 200, "height": 90}))
    assert Camera.from_ros(beside).cx < -1.0  # which is nothing to doubt


@pytest.mark.parametrize(
    ("roi", "message"),
    [
        ({"x_offset": 300, "width": 400}, "a roi inside the image, of width 640, got x_offset 300 and width 400"),
        ({"y_offset": 1, "height": 0}, "a roi inside the image, of height 480, got y_offset 1 and height 480"),
    ],
)
def test_a_region_beyond_the_image_is_refused(roi, message):
    with pytest.raises(ValueError, match=message):
        Camera.from_ros(camera_info(roi=roi))


def test_numbers_that_yaml_reads_as_text():
    info = camera_info(D=[0.1, "-1e-05", 0.0, "2e-3", 0.0])  # PyYAML takes a number for one only if it has a point
    assert Camera.from_ros(as_file(info)).distortion == (0.1, -1e-5, 0.0, 2e-3, 0.0)


def test_from_ros_models():
    rational = camera_info(distortion_model="rational_polynomial", D=RATIONAL)
    assert Camera.from_ros(rational).distortion == RATIONAL
    for zeros in (4, 6):  # of thin prisms, and of a tilted sensor too: OpenCV gives 12 or 14 coefficients
        longer = rational | {"D": (*RATIONAL, *[0.0] * zeros)}
        assert Camera.from_ros(longer).distortion == RATIONAL
    for unnamed in (camera_info(distortion_model=""), without(camera_info(), "distortion_model")):
        assert Camera.from_ros(unnamed).distortion == KINECT  # plumb_bob, as that of most drivers is
    assert Camera.from_ros(camera_info(distortion_model="", D=[])).distortion == ()
    for zeros in ([0.0] * 4, []):  # a fisheye all the same: the model itself bends rays
        equidistant = Camera.from_ros(camera_info(distortion_model="equidistant", D=zeros))
        assert (equidistant.distortion, equidistant.distortion_model) == ((0.0,) * 4, "fisheye")
    fisheye = Camera.from_ros(camera_info(distortion_model="equidistant", D=FISHEYE))
    assert (fisheye.distortion, fisheye.distortion_model) == (FISHEYE, "fisheye")
    with pytest.raises(ValueError, match="4 coefficients in D for equidistant, got 5"):
        Camera.from_ros(camera_info(distortion_model="equidistant", D=KINECT))
    with pytest.raises(ValueError, match=r"one of plumb_bob, .*, equidistant, fisheye, got 'thin_prism'"):
        Camera.from_ros(camera_info(distortion_model="thin_prism", D=[0.1, 0, 0, 0]))
    with pytest.raises(ValueError, match="4 or 5 coefficients in D for plumb_bob, got 8"):
        Camera.from_ros(camera_info(D=RATIONAL))
    with pytest.raises(ValueError, match="fx and fy not 0"):
        Camera.from_ros(camera_info(K=[0.0] * 8 + [1.0]))
    for options in ({}, {"rectified": True}):
        with pytest.raises(ValueError, match=r"ROS writes [KP] = 0 for one that is not"):
            Camera.from_ros(camera_info(K=[0.0] * 9, P=[0.0] * 12), **options)
    with pytest.raises(ValueError, match="expected 9 numbers in K, got 12"):
        Camera.from_ros(camera_info(K=[1.0] * 12))
    with pytest.raises(ValueError, match="expected K or k in the dict"):
        Camera.from_ros({"width": 1, "height": 1})


def test_samples_of_noise_are_saved_without_coefficients(tmp_path):
    """Which are not looked at; files that have both are read."""
    samples = ((0.2, 1e-3), (2.0, 2e-3))
    for model in (noise.table(*zip(*samples, strict=True)), noise.NoiseModel((5e-3,), samples)):
        assert model.to_dict() == {"samples": samples}
        camera = Camera(64, 48, 50.0, 50.0, 31.5, 23.5, noise=model)
        camera.save(tmp_path / "camera.json")
        assert Camera.load(tmp_path / "camera.json") == camera
        before = model.to_dict() | {"coefficients": [1.425e-3]}
        assert noise.NoiseModel.from_dict(before) == model
    assert noise.NoiseModel((5e-3,)).to_dict() == {"coefficients": (5e-3,)}


@pytest.mark.parametrize(
    "lens",
    [
        {},
        {"distortion": (0.1, -0.05, 0.001, 0.0, 0.02)},
        {"distortion": (0.1, -0.05, 0.001, 0.0, 0.02), "distortion_model": "inverse_brown_conrady"},
        {"distortion": (0.1, 0.0, 0.0, 0.0), "distortion_model": "fisheye"},
    ],
)
def test_points_without_an_image(lens):
    """At infinity, in the camera's plane and very near it; without a warning, which would be an error here."""
    camera = Camera(64, 48, 50.0, 50.0, 31.5, 23.5, **lens)
    nowhere = [
        [math.inf, math.inf, math.inf], [math.inf, 0.0, 1.0], [0.0, 0.0, math.nan], [1.0, 1.0, 0.0],
        [1e200, 1.0, 1e-200],
    ]  # fmt: skip
    assert np.isnan(camera.project(nowhere)).all()
    near = camera.project([[1.0, 1.0, 1e-100], [1.0, 1.0, 1e-300], [0.0, 0.0, 1.0]])
    assert np.isfinite(near[2]).all()


def test_from_open3d(tmp_path):
    values = {"width": 640, "height": 480, "intrinsic_matrix": [525.0, 0, 0, 0, 520.0, 0, 319.5, 239.5, 1]}
    expected = Camera(640, 480, 525.0, 520.0, 319.5, 239.5, depth_scale=1000.0)
    assert Camera.from_open3d(values, depth_scale=1000.0) == expected
    assert Camera.from_open3d({"extrinsic": [], "intrinsic": values}, depth_scale=1000.0) == expected
    path = tmp_path / "intrinsic.json"
    path.write_text(json.dumps(values))
    assert Camera.from_open3d(path, depth_scale=1000.0) == expected
    row_major = values | {"intrinsic_matrix": [525.0, 0, 319.5, 0, 520.0, 239.5, 0, 0, 1]}
    with pytest.raises(ValueError, match="column-major"):
        Camera.from_open3d(row_major)
    with pytest.raises(ValueError, match="nine numbers, column-major"):
        Camera.from_open3d(values | {"intrinsic_matrix": MATRIX})
    intrinsic = SimpleNamespace(width=640, height=480, intrinsic_matrix=np.array(MATRIX))
    assert Camera.from_open3d(intrinsic, depth_scale=1000.0) == expected
    parameters = SimpleNamespace(intrinsic=intrinsic, extrinsic=np.eye(4))
    assert Camera.from_open3d(parameters, depth_scale=1000.0) == expected


def without(values, key):
    return {k: v for k, v in values.items() if k != key}


def realsense(**changed):
    return {
        "width": 848,
        "height": 480,
        "ppx": 421.2,
        "ppy": 238.9,
        "fx": 425.3,
        "fy": 425.1,
        "model": "brown_conrady",
        "coeffs": [0.0] * 5,
    } | changed


def test_from_realsense():
    expected = Camera(848, 480, 425.3, 425.1, 421.2, 238.9)
    assert Camera.from_realsense(realsense()) == expected
    assert Camera.from_realsense(SimpleNamespace(**realsense())) == expected
    # The device states its unit in float32.
    assert Camera.from_realsense(realsense(), depth_units=float(np.float32(0.001))).depth_scale == 1000.0
    assert Camera.from_realsense(realsense(), depth_units=0.0001).depth_scale == 10000.0
    assert Camera.from_realsense(realsense(), depth_units=1.0).depth_scale == 1.0  # the largest unit
    assert Camera.from_realsense(realsense(), depth_scale=5000.0).depth_scale == 5000.0
    assert Camera.from_realsense(realsense(), disparity=(0.1, 0)).disparity == (0.1, 0.0)
    with pytest.raises(ValueError, match="depth_units or depth_scale, got both"):
        Camera.from_realsense(realsense(), depth_units=0.001, depth_scale=1000.0)
    assert Camera.from_realsense(realsense(), depth_units=0.001, depth_scale=None).depth_scale == 1000.0
    message = "depth_units in metres per raw unit, 0.001 for millimetres, got 1000.0: that is depth_scale"
    with pytest.raises(ValueError, match=message):
        Camera.from_realsense(realsense(), depth_units=1000.0)
    with pytest.raises(ValueError, match="depth_units > 0"):
        Camera.from_realsense(realsense(), depth_units=0.0)


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("brown_conrady", "brown_conrady"),
        (SimpleNamespace(name="inverse_brown_conrady"), "inverse_brown_conrady"),
        ("distortion.inverse_brown_conrady", "inverse_brown_conrady"),
        ("Inverse Brown Conrady", "inverse_brown_conrady"),
        ("RS2_DISTORTION_BROWN_CONRADY", "brown_conrady"),
        (2, "inverse_brown_conrady"),
        (4, "brown_conrady"),
        (np.int64(4), "brown_conrady"),
    ],
)
def test_from_realsense_models(model, expected):
    camera = Camera.from_realsense(realsense(model=model, coeffs=KINECT))
    assert (camera.distortion_model, camera.distortion) == (expected, KINECT)


def test_from_realsense_of_a_fisheye():
    camera = Camera.from_realsense(realsense(model="kannala_brandt4", coeffs=(*FISHEYE, 0.0)))
    assert (camera.distortion_model, camera.distortion) == ("fisheye", FISHEYE)
    assert Camera.from_realsense(realsense(model="kannala_brandt4")).distortion_model == "fisheye"


def test_from_realsense_without_a_lens():
    assert Camera.from_realsense(realsense(model=0)) == Camera.from_realsense(realsense())  # RS2_DISTORTION_NONE
    for unknown in (-1, 6, None, False, np.int64(6)):
        with pytest.raises(ValueError, match="model"):
            Camera.from_realsense(realsense(model=unknown))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: small(fx=10**400), "expected fx as a finite number, got 1000"),
        (lambda: small(width=10**400), r"width must be below 2\*\*31, got 1000"),
        (lambda: small(distortion=np.array(5.0)), r"expected distortion as a sequence of numbers, got array"),
        (lambda: small(distortion=np.zeros((1, 5))), r"expected distortion as a sequence of numbers, got array"),
        (
            lambda: Camera.from_opencv(MATRIX, None, (640, 480), pixel_center="a"),
            "expected pixel_center as a number, got 'a'",
        ),
        (lambda: Camera.from_open3d(None), "expected intrinsic_matrix in the NoneType"),
        (lambda: Camera.from_opencv([["a"]], None, (1, 1)), "expected camera_matrix as numbers, got an array of <U1"),
        (lambda: Camera.from_opencv(np.ma.array(MATRIX), None, (1, 1)), "expected a plain array, got a masked array"),
        (lambda: Camera.from_opencv(np.array(MATRIX, complex), None, (1, 1)), "as numbers, got an array of complex128"),
        (lambda: Camera.from_opencv(MATRIX, "ab", (1, 1)), "expected distortion as numbers, got an array of <U2"),
        (lambda: Camera.from_ros(camera_info(width=math.inf)), "width must be a whole number, got inf"),
        (lambda: Camera.from_ros(camera_info(binning_x=2.7)), "binning_x must be a whole number, got 2.7"),
        (lambda: Camera.from_ros(camera_info(binning_y=-1)), "binning_y must be at least 0, got -1"),
        (lambda: Camera.from_ros(camera_info(roi={"x_offset": "4"})), "x_offset must be a whole number, got '4'"),
        (lambda: Camera.from_ros(camera_info(K=[10**400] * 9)), "expected K as numbers, got"),
        (lambda: Camera.from_ros(camera_info(D=None)), "expected D, empty without distortion, as numbers, got None"),
        (lambda: Camera.from_ros(camera_info(K=None)), "expected K as numbers, got None"),
        (lambda: Camera.from_ros(camera_info(D=5)), "4 or 5 coefficients in D for plumb_bob, got 1"),
        (lambda: Camera.from_open3d({"intrinsic": None}), "expected intrinsic_matrix in the NoneType"),
        (lambda: Camera.from_open3d({"intrinsic_matrix": [[1], 2]}), "expected intrinsic_matrix as an array, got a"),
        (lambda: Camera.from_realsense(realsense(coeffs=["k"] * 5)), "expected coeffs as numbers, got"),
        (lambda: Camera.from_realsense(realsense(), depth_units="a"), "expected depth_units as a number, got 'a'"),
        # What says how the lens bends must not be left out in silence.
        (lambda: Camera.from_realsense(without(realsense(coeffs=KINECT), "model")), "expected model in"),
        (lambda: Camera.from_realsense(without(realsense(), "coeffs")), "expected coeffs in"),
        (lambda: Camera.from_ros(without(camera_info(), "D")), "expected D or d in"),
        (lambda: Camera.from_ros(without(as_file(camera_info()), "distortion_coefficients")), "expected D or d in"),
        (lambda: Camera.from_ros(None), "expected a CameraInfo, got None"),
        (lambda: Camera.from_ros("camera.yaml"), "expected a mapping, or an object, got the path 'camera.yaml'"),
    ],
)
def test_formats_refuse_what_they_do_not_have(make, message):
    with pytest.raises((TypeError, ValueError), match=message):
        make()


def test_a_file_is_named_with_what_is_wrong_in_it(tmp_path):
    path = tmp_path / "camera.json"
    for matrix, width, error, message in (
        ([1.0] * 8, 4, ValueError, "expected .* nine numbers, column-major, got shape"),
        ([9.0, 0, 0, 0, 9.0, 0, 1, 1, 1], "4", TypeError, "width must be a whole number of pixels, got '4'"),
    ):
        path.write_text(json.dumps({"width": width, "height": 3, "intrinsic_matrix": matrix}))
        with pytest.raises(error, match=rf"camera\.json: {message}"):
            Camera.from_open3d(path)
    path.write_text("[" * 100_000)
    too_deep = "(maximum recursion|Stack overflow)"  # as Python up to 3.13, and later, calls it
    with pytest.raises(ValueError, match=rf"expected a JSON file, got .*camera\.json: {too_deep}"):
        Camera.load(path)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"correlation": 5}, "expected correlation as pairs .share, length., got 5"),
        ({"correlation": (0.5, 3.0)}, "expected correlation as pairs"),
        ({"correlation": ((0.5, "a"),)}, "expected correlation as pairs"),
        ({"samples": ((1.0, 2.0), (3.0,))}, "expected samples as pairs .inverse depth, sigma."),
        ({"samples": ()}, "expected samples of growing"),
        ({"floor_length": "a"}, "expected floor_length as a number, got 'a'"),
        ({}, "expected a noise model with coefficients or samples, got {}"),
        ({"step": 0.001}, "expected a noise model with coefficients or samples"),
    ],
)
def test_noise_that_cannot_be_is_refused(changed, message):
    with pytest.raises((TypeError, ValueError), match=message):
        Camera.from_dict(small().to_dict() | {"noise": changed})


@pytest.mark.parametrize("given", [[None, None], [None, 3.0], [0.5, None, 2.0]])
def test_a_depth_range_without_numbers_is_named_as_it_is(given):
    """Only the farthest depth may be null, for infinity."""
    with pytest.raises(TypeError, match=re.escape(f"expected depth_range as a sequence of numbers, got {given}")):
        Camera.from_dict(small().to_dict() | {"depth_range": given})
    assert Camera.from_dict(small().to_dict() | {"depth_range": [0.5, None]}).depth_range == (0.5, np.inf)


def test_from_realsense_models_that_cannot_be_are_refused():
    assert Camera.from_realsense(realsense(model="none", coeffs=KINECT)).distortion == ()
    assert Camera.from_realsense(realsense(model="Modified Brown Conrady")).distortion == ()
    with pytest.raises(ValueError, match=r"got modified_brown_conrady with coefficients"):
        Camera.from_realsense(realsense(model="Modified Brown Conrady", coeffs=KINECT))
    with pytest.raises(ValueError, match=r"expected a RealSense model, one of .* got 'cubic'"):
        Camera.from_realsense(realsense(model="cubic"))


@pytest.mark.parametrize("preset", PRESETS, ids=lambda p: p.__name__)
def test_presets_name_their_source_and_have_rays(preset):
    camera = preset()
    assert "Source:" in preset.__doc__
    assert (camera.depth_scale is None) != (camera.disparity is None)
    assert abs(camera.cx - camera.width / 2) < 0.1 * camera.width
    assert abs(camera.cy - camera.height / 2) < 0.12 * camera.height
    assert_rays_land_on_their_pixels(camera, 1e-7)


@pytest.mark.parametrize("preset", PRESETS, ids=lambda p: p.__name__)
def test_presets_have_the_units_and_signs_that_they_state(preset):
    camera, stated = preset(), preset.__doc__.split("Source:")[0]
    if camera.disparity is None:
        units = {"millimetres": 1000.0, "5000 units per metre": 5000.0, "5000 per metre": 5000.0}
        assert [camera.depth_scale] == [scale for words, scale in units.items() if words in stated]
    assert camera.fx > 0.0
    assert (camera.fy < 0.0) == ("fy is negative" in stated)
    missing = re.findall(r"(\d+) means? missing", preset.__doc__)
    assert camera.invalid_values == tuple(map(float, missing))


def test_preset_modes():
    assert presets.realsense_d435(848, 480).fx == pytest.approx(643.3 * 848 / 1280, rel=1e-4)
    with pytest.raises(ValueError, match=r"expected a mode of .* got 640x480"):
        presets.realsense_d435(640, 480)


def test_kinect_v1_raw_disparity_in_metres():
    z = presets.kinect_v1_disparity().points(np.full((480, 640), 985, np.uint16))[0, 0, 2]
    assert z == pytest.approx(351.3 / (1092.5 - 985), rel=1e-14)


@real_cameras
def test_real_cameras(path):
    camera = Camera.load(path)
    assert_rays_land_on_their_pixels(camera, 1e-7)
    assert Camera.from_dict(json.loads(path.read_text())).to_dict() == camera.to_dict()
    if camera.is_distorted:
        x, y = distort(camera.tan_x, camera.tan_y, camera.distortion)
        assert np.abs(x - camera.tan_x_columns).max() < TOLERANCE
        assert np.abs(y - camera.tan_y_rows[:, None]).max() < TOLERANCE


@real_cameras
def test_real_frames_give_points_in_their_stated_range(path):
    image = pytest.importorskip("PIL.Image")
    camera = Camera.load(path)
    first = sorted((path.parent / "depth").glob("*.png"))[0]
    with image.open(first) as opened:
        depth = np.asarray(opened)
    z = camera.points(depth)[..., 2]
    valid = np.isfinite(z)
    assert 0.5 < valid.mean() <= 1
    assert 0.1 < z[valid].min() < np.median(z[valid]) < z[valid].max() < 20


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fx": 3.6}, "with fx = 3.6 and cx = 319.5, an image of width 640 reaches 89 degrees from the optical"),
        ({"fy": -0.9}, "with fy = -0.9 and cy = 239.5, an image of height 480 reaches 90 degrees"),
        ({"cx": 3195.0}, "cx = 3195, an image of width 640 reaches 81 degrees"),
        ({"cx": 640.0}, "cx = 640 lies outside an image of width 640: are these the intrinsics of another image size?"),
        ({"cy": 539.5}, "cy = 539.5 lies outside an image of height 480"),
        ({"cy": -1.0, "distortion_model": "fisheye"}, "cy = -1 lies outside an image of height 480"),
        ({"cy": -1500.0}, "cy = -1500, an image of height 480 reaches 75 degrees"),
    ],
)
def test_intrinsics_that_no_camera_has_are_doubted(change, words):
    values = {"width": 640, "height": 480, "fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5}
    with pytest.warns(UserWarning, match=re.escape(words)) as warned:
        Camera(**values | change)
    assert len(warned) == 1
    assert warned[0].filename == __file__
    with pytest.warns(UserWarning, match=re.escape(words)) as warned:
        replace(Camera(**values), **change)
    assert [warning.filename for warning in warned] == [__file__]
    # Wide lenses, narrow ones, and crops beside the principal point are no reason.
    parts = {"cx": -0.5, "is_part": True}, {"cy": 479.5, "is_part": True}
    for other in ({"fx": 90.0, "fy": 90.0}, {"fx": 1e6, "fy": 1e6}, *parts):
        Camera(**values | other)
    part = Camera(**values).cropped(600, 0, 20, 100)
    assert (part.cx, part.cy) == (-280.5, 239.5)
    assert part.with_noise(noise.kinect_v1()).resized(40, 200).cx < 0.0


def test_copies_of_a_camera_that_is_doubted_are_doubted_no_more(tmp_path):
    """Warnings are errors here, as by python -W error."""
    with pytest.warns(UserWarning, match="degrees from the optical axis"):
        camera = Camera(640, 480, 50.0, 500.0, 319.5, 239.5, depth_scale=1000.0)
    assert pickle.loads(pickle.dumps(camera)) == copy.deepcopy(camera) == copy.copy(camera) == camera
    assert camera.cropped(0, 0, 640, 480) == camera.resized(640, 480) == camera.with_noise(None) == camera
    tiles = fit_tiles(np.full(camera.shape, 1500, np.uint16), camera)
    assert pickle.loads(pickle.dumps(tiles)).camera == camera
    tiles.save(tmp_path / "planes.npz")
    assert TilePlanes.load(tmp_path / "planes.npz").camera == camera
    camera.save(tmp_path / "camera.json")
    for stated in (lambda: Camera.load(tmp_path / "camera.json"), lambda: Camera.from_dict(camera.to_dict())):
        with pytest.warns(UserWarning, match="degrees from the optical axis") as warned:
            assert stated() == camera
        assert [warning.filename for warning in warned] == [__file__]


def test_a_region_that_binning_does_not_divide():
    assert Camera.from_ros(camera_info(binning_x=7, binning_y=9, D=[])).shape == (480 // 9, 640 // 7)


def test_a_depth_range_without_an_extent_is_refused():
    with pytest.raises(ValueError, match="0 <= nearest < farthest"):
        small(depth_range=(2.0, 2.0))


@pytest.mark.parametrize("tangential", [(0.03, 0.03), (0.02, 0.01)])
def test_rays_beyond_where_the_tangential_part_folds_have_no_image(tangential, rng):
    camera = Camera(640, 480, 525.0, 525.0, 319.5, 239.5, (0.0, 0.0, *tangential, 0.0))
    points = rng.normal(size=(50_000, 3)) * [2.0, 2.0, 1.0]
    points[:, 2] = np.abs(points[:, 2]) + 0.05
    pixels = camera.project(points)
    inside = (pixels >= 0.0).all(axis=1) & (pixels <= [639.0, 479.0]).all(axis=1)
    assert inside.sum() > 1000
    rays = rays_through(camera, pixels[inside])
    np.testing.assert_allclose(rays[:, :2], points[inside, :2] / points[inside, 2:], atol=1e-6)


def test_rays_of_pixels_have_an_image_where_the_radial_part_alone_would_fold():
    """Of a lens whose tangential part keeps it one-to-one all over the image."""
    lens = (0.03834365, -0.09891097, 0.00353125, 0.00314493, 0.06961385, 0.44853761, 0.16415756, 0.02644086)
    camera = Camera(74, 49, 95.47, 99.30, 24.04, 10.35, distortion=lens)
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    rows, columns = np.indices(camera.shape)
    np.testing.assert_allclose(camera.project(rays), np.dstack([columns, rows]), atol=1e-6)
