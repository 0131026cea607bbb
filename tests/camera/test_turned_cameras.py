"""Cameras of turned and mirrored images, and cameras whose rays are given."""

import pickle

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes.camera import rays as between_pixels

SIZE = {"width": 96, "height": 64, "cx": 45.0, "cy": 33.5}
LENSES = {
    "pinhole": {"fx": 80.0, "fy": 82.0},
    "fy < 0": {"fx": 80.0, "fy": -82.0},
    "Brown-Conrady": {"fx": 80.0, "fy": 82.0, "distortion": (0.26, -0.95, -0.0054, 0.0026, 1.16)},
    "rational": {"fx": 80.0, "fy": 82.0, "distortion": (0.55, -0.02, 2e-3, -7e-3, -0.003, 0.89, 0.086, -0.014)},
    "inverse": {
        "fx": 80.0, "fy": 82.0, "distortion": (0.1, -0.1, 4e-3, 3e-3, 0.05),
        "distortion_model": "inverse_brown_conrady",
    },
    "fisheye": {"fx": 50.0, "fy": 52.0, "distortion": (0.01, -0.005, 0.002, 0.0), "distortion_model": "fisheye"},
}  # fmt: skip
TURNS = {  # of rays, as the documentation says
    0: lambda x, y: (x, y), 90: lambda x, y: (y, -x), 180: lambda x, y: (-x, -y), 270: lambda x, y: (-y, x),
}  # fmt: skip


@pytest.fixture(params=LENSES)
def camera(request):
    return rp.Camera(**SIZE, **LENSES[request.param], depth_scale=1000.0)


def given(camera):
    """The same rays as tables."""
    return rp.Camera.from_rays(camera.tan_x, camera.tan_y, depth_scale=1000.0)


@pytest.mark.parametrize("degrees", TURNS)
@pytest.mark.parametrize("as_tables", [False, True])
def test_turned_images_have_turned_rays(camera, degrees, as_tables):
    camera = given(camera) if as_tables else camera
    turned = camera.rotated(degrees)
    expected = TURNS[degrees](*(rp.images.rotated(table, degrees) for table in (camera.tan_x, camera.tan_y)))
    np.testing.assert_allclose((turned.tan_x, turned.tan_y), expected, rtol=0, atol=1e-12)
    assert turned.depth_scale == 1000.0


@pytest.mark.parametrize("direction", ["horizontal", "vertical"])
@pytest.mark.parametrize("as_tables", [False, True])
def test_each_pixel_of_a_mirrored_image_keeps_its_ray(camera, direction, as_tables):
    camera = given(camera) if as_tables else camera
    mirrored = camera.flipped(direction)
    for name in ("tan_x", "tan_y"):
        expected = rp.images.flipped(getattr(camera, name), direction)
        np.testing.assert_allclose(getattr(mirrored, name), expected, rtol=0, atol=1e-12)
    points = camera.points(np.full(camera.shape, 1500, np.uint16))
    again = mirrored.points(np.full(camera.shape, 1500, np.uint16))
    np.testing.assert_allclose(rp.images.flipped(points, direction), again, atol=1e-12)


@pytest.mark.parametrize("name", ["pinhole", "Brown-Conrady", "rational", "fisheye"])
def test_against_opencv(name, rng):
    """A point turned as the documentation says lands where OpenCV puts it with the turned camera's numbers."""
    cv2 = pytest.importorskip("cv2")
    camera = rp.Camera(**SIZE, **LENSES[name])
    points = np.concatenate([0.3 * rng.normal(size=(500, 2)), np.ones((500, 1))], axis=1)

    def projected(made, points):
        matrix = np.array([[made.fx, 0, made.cx], [0, made.fy, made.cy], [0, 0, 1.0]])
        lens = np.array(made.distortion or (0.0,) * 5)
        if made.distortion_model == "fisheye":
            return cv2.fisheye.projectPoints(points[None], np.zeros(3), np.zeros(3), matrix, lens)[0][0]
        return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, lens)[0][:, 0]

    column, row = projected(camera, points).T
    right, bottom = camera.width - 1, camera.height - 1
    places = {90: (row, right - column), 180: (right - column, bottom - row), 270: (bottom - row, column)}
    for degrees, place in places.items():
        x, y = TURNS[degrees](points[:, 0], points[:, 1])
        found = projected(camera.rotated(degrees), np.stack([x, y, points[:, 2]], axis=1))
        np.testing.assert_allclose(found, np.stack(place, axis=1), atol=1e-9)
    for direction, place in (("horizontal", (right - column, row)), ("vertical", (column, bottom - row))):
        np.testing.assert_allclose(projected(camera.flipped(direction), points), np.stack(place, axis=1), atol=1e-9)


def test_an_upside_down_sensor_finds_the_same_planes():
    camera = rp.Camera(**SIZE, **LENSES["Brown-Conrady"], depth_scale=1000.0)
    depth = rp.scenes.room().render(camera).measure(seed=1)
    whole = camera.shape
    found = rp.fit_tiles(depth, camera, 16)
    turned = rp.fit_tiles(rp.images.rotated(depth, 180), camera.rotated(180), 16)
    planes = turned.planes[::-1, ::-1] * [-1, -1, 1, 1]
    np.testing.assert_allclose(planes, found.planes, atol=1e-9)
    mirrored = rp.fit_tiles(rp.images.flipped(depth, "horizontal"), camera.flipped("horizontal"), 16)
    np.testing.assert_allclose(mirrored.planes[:, ::-1], found.planes, atol=1e-9)
    assert camera.rotated(90).shape == whole[::-1]
    assert camera.rotated(90).rotated(270) == camera
    assert camera.flipped("vertical").flipped("vertical") == camera


def test_frames_turn_with_their_camera_and_pose(rng):
    camera = rp.Camera(**SIZE, **LENSES["Brown-Conrady"], depth_scale=1000.0)
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 3.0
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    depth = rng.integers(500, 2000, camera.shape).astype(np.uint16)
    frame = rp.sequences.Frame(depth, camera, 0.5, "a", pose)

    def in_world(frame):
        points = frame.camera.points(frame.depth)
        return points @ frame.pose[:3, :3].T + frame.pose[:3, 3]

    for degrees in TURNS:
        np.testing.assert_allclose(
            in_world(frame.rotated(degrees)), rp.images.rotated(in_world(frame), degrees), atol=1e-9
        )
    flipped = in_world(frame.flipped("vertical"))
    np.testing.assert_allclose(flipped, in_world(frame)[::-1], atol=1e-9)


def test_wrong_turns_are_named():
    camera = rp.presets.kinect_v1()
    for turn in (camera.rotated, lambda degrees: rp.images.rotated(np.zeros((2, 2)), degrees)):
        with pytest.raises(ValueError, match="expected degrees, counter-clockwise, as 0, 90, 180 or 270, got 45"):
            turn(45)
        with pytest.raises(TypeError, match="got 'left'"):
            turn("left")
    with pytest.raises(ValueError, match="direction must be one of horizontal, vertical, got 'up'"):
        camera.flipped("up")
    with pytest.raises(ValueError, match="expected a frame of shape"):
        rp.images.flipped(np.zeros(3), "vertical")


def test_rays_as_tables_give_the_bits_of_the_lens(camera, rng):
    depth = rp.scenes.room().render(camera).measure(holes=0.05, seed=3)
    tables = given(camera)
    labels = rng.integers(0, 3, camera.shape)
    fits = [
        (rp.fit_tiles(depth, c, 16), rp.fit_windows(depth, c, [[3, 4, 20, 30]]), rp.fit_labels(depth, c, labels))
        for c in (camera, tables)
    ]
    for lens, table in zip(*fits, strict=True):
        if camera.is_distorted:
            np.testing.assert_array_equal(lens.planes, table.planes)
            np.testing.assert_array_equal(lens.rmse, table.rmse)
        else:  # pinholes take a shorter way
            np.testing.assert_allclose(lens.planes, table.planes, atol=1e-9)
    normals = rp.normals(depth, camera), rp.normals(depth, tables)
    if camera.is_distorted:
        np.testing.assert_array_equal(*normals)
    assert (rp.segment(depth, tables).labels == rp.segment(depth, camera).labels).mean() > 0.99


def test_pixels_without_a_ray_are_missing():
    camera = rp.Camera(**SIZE, **LENSES["Brown-Conrady"])
    tan_x, tan_y = camera.tan_x.copy(), camera.tan_y.copy()
    tan_x[10:20, 30:50] = np.nan
    tan_y[0, 0] = np.nan
    holed = rp.Camera.from_rays(tan_x, tan_y)
    depth = rp.scenes.room().render(camera).depth
    seen = np.isfinite(holed.points(depth)).all(axis=-1)
    assert np.count_nonzero(~seen) == 201
    expected = rp.fit_tiles(np.where(seen, depth, 0.0), camera, 8)
    found = rp.fit_tiles(depth, holed, 8)
    np.testing.assert_array_equal(found.valid_count, expected.valid_count)
    np.testing.assert_allclose(found.planes, expected.planes, atol=1e-9)
    assert np.isfinite(holed.tan_x).all()


def test_rays_are_saved_to_the_bit(tmp_path, camera):
    tables = given(camera)
    tables.save(tmp_path / "camera.json")
    loaded = rp.Camera.load(tmp_path / "camera.json")
    assert loaded == tables
    assert hash(loaded) == hash(tables)
    assert pickle.loads(pickle.dumps(tables)) == tables
    np.testing.assert_array_equal(loaded.tan_x, camera.tan_x)
    assert tables != rp.Camera.from_rays(camera.tan_x, np.nextafter(camera.tan_y, 9.0), depth_scale=1000.0)
    assert "RayTable" in repr(tables)
    part = tables.cropped(10, 20, 30, 16)
    np.testing.assert_array_equal(part.tan_x, camera.tan_x[20:36, 10:40])
    half = tables.resized(48, 32)
    np.testing.assert_allclose(half.tan_y, camera.tan_y.reshape(32, 2, 48, 2).mean(axis=(1, 3)), atol=1e-12)
    tables.with_noise(rp.noise.kinect_v1()).save(tmp_path / "noisy.json")
    assert rp.Camera.load(tmp_path / "noisy.json").noise == rp.noise.kinect_v1()


def test_rays_project_where_their_pixels_are(camera, rng):
    tables = given(camera)
    columns, rows = np.meshgrid(np.arange(96.0), np.arange(64.0))
    points = tables.points(np.full(camera.shape, 1500, np.uint16))
    np.testing.assert_allclose(tables.project(points), np.stack([columns, rows], axis=-1), atol=1e-6)
    places = np.stack([rng.uniform(0, 95, 300), rng.uniform(0, 63, 300)], axis=-1)
    through = 2.0 * between_pixels.rays_through(tables, places)
    np.testing.assert_allclose(tables.project(through), places, atol=1e-6)
    assert np.isnan(tables.project([[9.0, 0.0, 1.0], [0.0, 0.0, -1.0]])).all()


def test_a_quarter_of_a_spherical_scan():
    """As the documentation of `from_rays` has it: walls of a box around a lidar are flat."""
    azimuth, elevation = np.radians(np.linspace(-180, 180, 720, endpoint=False)), np.radians(np.linspace(15, -15, 64))
    ahead = np.abs(azimuth) < np.pi / 4
    tan_x = np.broadcast_to(np.tan(azimuth[ahead]), (len(elevation), ahead.sum()))
    tan_y = -np.tan(elevation)[:, None] / np.cos(azimuth[ahead])
    camera = rp.Camera.from_rays(tan_x, tan_y)
    z = 1.0 / np.maximum(0.3 * tan_x + 0.5, 0.1 - 0.2 * tan_x)  # two walls
    distances = z * np.sqrt(1 + tan_x**2 + tan_y**2)
    found = rp.segment(distances / np.sqrt(1 + tan_x**2 + tan_y**2), camera)
    assert len(found) == 2
    wall = found.planes[np.argmin(np.abs(found.planes[:, 3] - 1 / np.hypot(0.3, 0.5)))]
    np.testing.assert_allclose(wall, np.array([-0.3, 0.0, -0.5, 1.0]) / np.hypot(0.3, 0.5), atol=1e-5)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ((np.zeros((3, 4)), np.zeros((4, 3))), r"tables of one shape, at least 2 x 2, got \(3, 4\) and \(4, 3\)"),
        ((np.zeros(4), np.zeros(4)), "at least 2 x 2"),
        ((np.full((4, 4), np.nan), np.zeros((4, 4))), "got 0 of 16 pixels with one"),
        ((np.full((4, 4), 90.0), np.zeros((4, 4))), "tangents, X/Z and Y/Z, not angles"),
    ],
)
def test_tables_that_are_no_rays(tables, message):
    with pytest.raises(ValueError, match=message):
        rp.Camera.from_rays(*tables)


def test_damaged_rays_in_a_file(tmp_path):
    values = given(rp.Camera(**SIZE, **LENSES["pinhole"])).to_dict()
    for change in ({"coding": "gzip"}, {"tan_x": "AAAA"}, {"height": 10**9}, {"width": None}):
        with pytest.raises(ValueError, match=r"expected rays as Camera\.save writes them"):
            rp.Camera.from_dict({**values, "rays": {**values["rays"], **change}})
    with pytest.raises(ValueError, match="expected rays or a lens distortion, got both"):
        rp.Camera.from_dict({**values, "distortion": [0.1, 0, 0, 0]})
