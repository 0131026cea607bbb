"""Exports, each read back with the tool that it is for."""

import json
import math
import os
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from recordings import columns_of
from ros_messages import round_trip

import rgbd_planes as rp
from rgbd_planes import export, recording
from rgbd_planes.evaluation import scenes
from rgbd_planes.export.tiles import exported
from rgbd_planes.sequences import FrameEntry, FrameSequence, images

CAMERA = rp.Camera(
    width=80, height=60, fx=65.0, fy=66.0, cx=39.5, cy=29.5,
    distortion=(0.05, -0.02, 0.001, 0.0, 0.0), depth_scale=1000.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def depth():
    return scenes.room().render(CAMERA).measure(holes=0.1, patches=0.2, seed=2)


@pytest.fixture(scope="module")
def tiles(depth):
    made = rp.fit_tiles(depth, CAMERA, tile=(12, 16), max_error=0.02)
    assert set(np.unique(made.status)) == {0, 1, 3}
    return made


def test_polygons_lie_on_their_planes_behind_the_corners_of_the_tiles(tiles):
    polygons = export.tile_polygons(tiles)
    chosen = exported(tiles)
    assert polygons.shape == (chosen.sum(), 4, 3)
    assert (chosen <= tiles.fitted).all()
    assert chosen.sum() > 10
    planes = tiles.planes[chosen]
    distance = np.einsum("nki,ni->nk", polygons, planes[:, :3]) + planes[:, 3:]
    np.testing.assert_allclose(distance, 0.0, atol=1e-12)
    row, column = np.argwhere(chosen)[5]
    x, y = 16 * column - 0.5, 12 * row - 0.5
    corners = [(x, y), (x, y + 12), (x + 16, y + 12), (x + 16, y)]
    np.testing.assert_allclose(CAMERA.project(polygons[5]), corners, atol=1e-3)  # rays between pixels are interpolated


@pytest.mark.parametrize("tile", [2, 4, (5, 7), 16])
def test_polygons_of_a_wall_leave_no_gap(tile):
    """Nor do they overlap: together they have the area that the image sees, whatever their size."""
    camera = rp.Camera(70, 50, 60.0, 55.0, 34.5, 24.5)
    tiles = rp.fit_tiles(np.full(camera.shape, 2.0), camera, tile, max_missing=1.0)
    a, b, c, d = np.moveaxis(export.tile_polygons(tiles), 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(c - a, d - b), axis=1).sum()
    covered = tiles.valid_count[tiles.fitted].sum() / camera.width / camera.height
    assert area == pytest.approx(covered * (2.0 * 70 / 60.0) * (2.0 * 50 / 55.0))


def test_polygons_turn_about_their_normals(tiles):
    mirrored = rp.Camera(**{**CAMERA.to_dict(), "fy": -66.0})
    depth = scenes.room().render(mirrored).measure(seed=2)
    for each in (tiles, rp.fit_tiles(depth, mirrored, tile=(12, 16))):
        a, b, c, _ = np.moveaxis(export.tile_polygons(each), 1, 0)
        across = np.cross(b - a, c - a)
        normals = each.planes[exported(each)][:, :3]
        cosine = (across * normals).sum(axis=1) / np.linalg.norm(across, axis=1)
        np.testing.assert_allclose(cosine, 1.0, atol=1e-9)


def test_planes_in_json_have_their_uncertainty_if_the_noise_is_known(depth):
    plain = export.to_dict(rp.fit_tiles(depth, CAMERA))["planes"]
    tiles = rp.fit_tiles(depth, CAMERA.with_noise(rp.noise.kinect_v1()))
    planes = export.to_dict(tiles)["planes"]
    assert {"p_value", "covariance"} == set(planes[0]) - set(plain[0])
    for plane in planes:
        at = plane["row"], plane["column"]
        assert plane["p_value"] == tiles.p_value[at]
        np.testing.assert_array_equal(plane["covariance"], tiles.plane_covariance[at])


def test_a_tile_that_its_corner_rays_miss_has_no_polygon():
    # A plane that the rays of the right-hand columns run away from: q falls below zero.
    camera = rp.Camera(width=16, height=8, fx=8.0, fy=8.0, cx=7.5, cy=3.5)
    inverse_depth = 0.5 - 0.6 * camera.tan_x
    metres = np.where(inverse_depth > 0.0, 1.0 / inverse_depth, np.nan)
    tiles = rp.fit_tiles(metres, camera, tile=(8, 16))
    assert tiles.fitted.all()
    assert not exported(tiles).any()
    assert export.tile_polygons(tiles).shape == (0, 4, 3)
    assert export.to_dict(tiles)["planes"][0]["polygon"] is None
    assert export.to_ros_polygons(tiles)["polygons"] == export.to_ros_planes(tiles)["coefficients"] == []


def test_json_holds_the_tiles(tiles, tmp_path):
    export.write_json(tmp_path / "planes.json", tiles)
    read = json.loads((tmp_path / "planes.json").read_text())
    assert rp.Camera.from_dict(read["camera"]) == CAMERA
    assert (read["method"], read["tile"]) == ("range_explicit", [12, 16])
    assert len(read["planes"]) == tiles.fitted.sum()
    for plane in read["planes"]:
        at = plane["row"], plane["column"]
        assert plane["plane"] == tiles.planes[at].tolist()
        assert plane["rmse_metric"] == tiles.rmse_metric[at]
        assert plane["valid_count"] == tiles.valid_count[at]
        assert rp.TileStatus[plane["status"]] == tiles.status[at]
    chosen = [p["polygon"] for p in read["planes"] if p["polygon"]]
    np.testing.assert_array_equal(chosen, export.tile_polygons(tiles))


def test_ply_holds_the_polygons(tiles, depth, tmp_path):
    plyfile = pytest.importorskip("plyfile")
    export.write_tiles_ply(tmp_path / "tiles.ply", tiles)
    read = plyfile.PlyData.read(tmp_path / "tiles.ply")
    vertex, polygons = read["vertex"], export.tile_polygons(tiles)
    xyz = np.stack([vertex[name] for name in "xyz"], axis=-1)
    np.testing.assert_allclose(xyz.reshape(-1, 4, 3), polygons, rtol=1e-6)
    normals = np.stack([vertex["n" + name] for name in "xyz"], axis=-1)
    planes = tiles.planes[exported(tiles)]
    np.testing.assert_allclose(normals.reshape(-1, 4, 3)[:, 2], planes[:, :3], rtol=1e-6, atol=1e-7)
    blue = np.rint(255 * (0.5 - 0.5 * planes[:, 2]))
    np.testing.assert_array_equal(vertex["blue"].reshape(-1, 4)[:, 0], blue)
    faces = np.stack(read["face"]["vertex_indices"])
    np.testing.assert_array_equal(faces, np.arange(len(xyz)).reshape(-1, 4))

    points = CAMERA.points(depth)
    export.write_ply(tmp_path / "points.ply", points)
    vertex = plyfile.PlyData.read(tmp_path / "points.ply")["vertex"]
    seen = np.isfinite(points[..., 2])
    assert 0 < seen.sum() < seen.size
    xyz = np.stack([vertex[name] for name in "xyz"], axis=-1)
    np.testing.assert_array_equal(xyz, points[seen].astype(np.float32))
    with pytest.raises(ValueError, match="faces must be"):
        export.write_ply(tmp_path / "no.ply", np.zeros((3, 3)), faces=[[0, 1, 3]])
    assert not (tmp_path / "no.ply").exists()


def test_a_mesh_keeps_the_points_that_are_not_finite(tmp_path):
    """By whose numbers its faces go."""
    plyfile = pytest.importorskip("plyfile")
    points = np.array([[0.0, 0.0, 1.0], [np.nan] * 3, [1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    faces = [[0, 2, 3], [0, 3, 4]]
    export.write_ply(tmp_path / "mesh.ply", points, faces=faces)
    read = plyfile.PlyData.read(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(np.stack([read["vertex"][name] for name in "xyz"], axis=-1), points)
    assert [face.tolist() for face in read["face"]["vertex_indices"]] == faces
    export.write_ply(tmp_path / "points.ply", points)
    assert len(plyfile.PlyData.read(tmp_path / "points.ply")["vertex"]) == 4


def test_points_and_normals_that_are_not_finite(depth, tmp_path):
    plyfile = pytest.importorskip("plyfile")
    points, normals = CAMERA.points(depth), rp.normals(depth, CAMERA)
    points[0, 0] = 1e300  # which single precision does not hold
    export.write_ply(tmp_path / "points.ply", points, normals=normals)
    vertex = plyfile.PlyData.read(tmp_path / "points.ply")["vertex"]
    there = np.isfinite(points[..., 2]) & (points[..., 2] < 1e300)
    xyz = np.stack([vertex[name] for name in "xyz"], axis=-1)
    np.testing.assert_array_equal(xyz, points[there].astype(np.float32))
    written = np.stack([vertex["n" + name] for name in "xyz"], axis=-1)
    without = np.isnan(normals[there]).any(axis=-1)
    assert 0 < without.sum() < len(without)
    np.testing.assert_array_equal(written, np.where(without[:, None], 0.0, normals[there]))


def test_colours_of_points_are_shares(tmp_path):
    points = np.zeros((2, 3))
    export.write_ply(tmp_path / "points.ply", points, colours=[[0, 0.5, 1], [1, 0, 0]])
    assert (tmp_path / "points.ply").read_bytes()[-3:] == bytes([255, 0, 0])
    for colours in (np.full((2, 3), 128, np.uint8), np.full((2, 3), np.nan), -points - 0.1):
        with pytest.raises(ValueError, match=r"colours must be RGB in 0\.\.1, got"):
            export.write_ply(tmp_path / "no.ply", points, colours=colours)
    with pytest.raises(TypeError, match="got a masked array"):
        export.write_ply(tmp_path / "no.ply", np.ma.masked_equal(points, 0))
    assert not (tmp_path / "no.ply").exists()


def test_points_keep_their_colours_where_others_are_left_out(tmp_path):
    points = np.array([[0.0, 0.0, 1.0], [np.nan] * 3, [1.0, 0.0, 2.0]])
    export.write_ply(tmp_path / "points.ply", points, colours=[[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    content = (tmp_path / "points.ply").read_bytes()
    assert [content[-18:-15], content[-3:]] == [bytes([255, 0, 0]), bytes([0, 0, 255])]


def test_tiles_of_a_mirrored_camera_have_the_colours_of_its_picture(tmp_path):
    plyfile = pytest.importorskip("plyfile")
    colours = []
    for sign in (1.0, -1.0):
        camera = replace(CAMERA, fx=sign * CAMERA.fx, fy=sign * CAMERA.fy, distortion=())
        wall = scenes.plane((0.3 * sign, -0.5 * sign, -0.8), 2.0).render(camera).depth
        export.write_tiles_ply(tmp_path / "tiles.ply", rp.fit_tiles(wall, camera))
        vertex = plyfile.PlyData.read(tmp_path / "tiles.ply")["vertex"]
        colours.append(np.stack([vertex[name] for name in ("red", "green", "blue")]).astype(int))
    np.testing.assert_allclose(colours[1], colours[0], atol=1)
    assert colours[0].min(axis=1)[:2].min() > 128  # to the right, and up


def test_faces_have_as_many_corners_as_a_byte_can_count(tmp_path):
    plyfile = pytest.importorskip("plyfile")
    points, face = np.zeros((256, 3)), np.arange(256)[None]
    export.write_ply(tmp_path / "face.ply", points, faces=face[:, :255])
    (read,) = plyfile.PlyData.read(tmp_path / "face.ply")["face"]["vertex_indices"]
    np.testing.assert_array_equal(read, face[0, :255])
    for wrong in (face, face[:, :2]):
        with pytest.raises(ValueError, match="K from 3 to 255"):
            export.write_ply(tmp_path / "no.ply", points, faces=wrong)
    assert not (tmp_path / "no.ply").exists()


def test_open3d_gets_the_same_mesh_and_points(tiles, depth, tmp_path):
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    mesh = export.to_open3d(tiles)
    polygons, planes = export.tile_polygons(tiles), tiles.planes[exported(tiles)]
    np.testing.assert_array_equal(np.asarray(mesh.vertices).reshape(-1, 4, 3), polygons)
    mesh.compute_triangle_normals()
    # Counter-clockwise as seen from the camera: Open3D's own normals point at it, as ours do.
    normals = np.asarray(mesh.triangle_normals)
    np.testing.assert_allclose(normals, planes[:, :3].repeat(2, axis=0), atol=1e-9)
    cloud = export.points_to_open3d(depth, CAMERA)
    points = CAMERA.points(depth)
    np.testing.assert_array_equal(np.asarray(cloud.points), points[np.isfinite(points[..., 2])])
    export.write_tiles_ply(tmp_path / "tiles.ply", tiles)
    read = open3d.io.read_triangle_mesh(str(tmp_path / "tiles.ply"))
    assert len(read.triangles) == 2 * len(polygons)
    export.write_ply(tmp_path / "points.ply", points)
    assert len(open3d.io.read_point_cloud(str(tmp_path / "points.ply")).points) == len(cloud.points)


def test_a_stamp_is_that_of_the_message(tiles):
    exact = {"sec": 1_700_000_000, "nanosec": 123_456_789}
    ros_1 = {"secs": exact["sec"], "nsecs": exact["nanosec"]}
    for stamp in (exact, ros_1, SimpleNamespace(**exact), SimpleNamespace(**ros_1)):
        assert export.to_ros_planes(tiles, "camera", stamp)["header"]["stamp"] == exact
    nanoseconds = 10**9 * exact["sec"] + exact["nanosec"]
    of_rclpy = SimpleNamespace(nanoseconds=nanoseconds, seconds_nanoseconds=lambda: tuple(exact.values()))
    for stamp in (of_rclpy, np.datetime64(nanoseconds, "ns")):
        assert export.to_ros_planes(tiles, "camera", stamp)["header"]["stamp"] == exact
    early = export.to_ros_planes(tiles, "camera", -0.25)["header"]["stamp"]
    assert export.to_ros_planes(tiles, "camera", early)["header"]["stamp"] == early
    for wrong in ({"sec": 1}, {"sec": 1.5, "nanosec": 0}, "now"):
        with pytest.raises(TypeError, match="stamp"):
            export.to_ros_planes(tiles, "camera", wrong)
    for wrong in ({"sec": 1, "nanosec": 10**9}, {"sec": 1, "nanosec": -1}, {"secs": 1, "nsecs": 10**9}):
        with pytest.raises(ValueError, match=r"stamp's (nanosec|nsecs) must be (below 1000000000|at least 0)"):
            export.to_ros_planes(tiles, "camera", wrong)


@pytest.mark.parametrize(
    "stamp",
    [
        1_700_000_000_123_456_789,
        -2.2e9,
        1e300,
        math.inf,
        -math.inf,
        10**400,
        {"sec": 2**31, "nanosec": 0},
        SimpleNamespace(nanoseconds=10**9 * 2**31),
        np.datetime64("2038-01-20"),
        np.datetime64("3000-01-01"),
    ],
)
def test_a_stamp_that_no_message_holds_is_refused(stamp):
    with pytest.raises(ValueError, match=r"expected stamp in seconds, .*: nanoseconds\?|sec must be below 2\*\*31"):
        export.to_ros_points(np.ones((60, 80)), CAMERA, "camera", stamp)


def test_each_message_has_a_header_of_its_own(tiles):
    planes, polygons = export.to_ros_planes(tiles, "camera", 1.0), export.to_ros_polygons(tiles, "camera", 1.0)
    for message, parts in ((planes, planes["coefficients"]), (polygons, polygons["polygons"])):
        parts[0]["header"]["frame_id"], parts[0]["header"]["stamp"]["sec"] = "other", 2
        assert message["header"] == parts[1]["header"] == {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "camera"}


def test_a_path_with_the_suffix_of_another_format_is_refused(tiles, depth, tmp_path):
    """Nothing is written, whatever was there; a suffix that names no format is the user's."""
    points = tiles.camera.points(depth)
    for write, wrong, own in (
        (tiles.save, "a.json", "npz"),
        (tiles.camera.save, "a.yaml", "json"),
        (lambda path: rp.export.write_json(path, tiles), "a.npz", "json"),
        (lambda path: rp.export.write_ply(path, points), "a.obj", "ply"),
        (lambda path: rp.segmentation_export.write_json(path, rp.segment(depth, tiles.camera)), "a.CSV", "json"),
    ):
        with pytest.raises(
            ValueError, match=rf"{wrong}: expected a path that ends in .{own}, which is what is written"
        ):
            write(tmp_path / wrong)
        assert not list(tmp_path.iterdir())
    for name in ("a", "a.tiles", "a.JSON"):
        tiles.camera.save(tmp_path / name)
        assert rp.Camera.load(tmp_path / name) == tiles.camera


def test_what_is_no_tiles_is_refused(tmp_path, tiles):
    for write in (lambda: export.write_tiles_ply(tiles, tmp_path / "t.ply"), lambda: export.to_open3d(None)):
        with pytest.raises((TypeError, ImportError), match=r"expected TilePlanes, got|open3d"):
            write()
    masked = np.ma.array([[0, 1, 2]], mask=[[True, False, False]])
    with pytest.raises(TypeError, match="faces"):
        export.write_ply(tmp_path / "p.ply", np.ones((3, 3)), faces=masked)
    assert not list(tmp_path.iterdir())


def test_ros_messages_survive_serialisation(tiles, depth):
    pytest.importorskip("rosbags")
    chosen = exported(tiles)
    about = ("camera_depth_optical_frame", 12.345678901)
    planes = round_trip("jsk_recognition_msgs/msg/ModelCoefficientsArray", export.to_ros_planes(tiles, *about))
    assert planes.header.frame_id == about[0]
    assert (planes.header.stamp.sec, planes.header.stamp.nanosec) == (12, 345678901)
    read = np.array([one.values for one in planes.coefficients])
    np.testing.assert_allclose(read, tiles.planes[chosen], rtol=1e-6, atol=1e-7)
    polygons = round_trip("jsk_recognition_msgs/msg/PolygonArray", export.to_ros_polygons(tiles, *about))
    read = np.array([[(p.x, p.y, p.z) for p in one.polygon.points] for one in polygons.polygons])
    np.testing.assert_allclose(read, export.tile_polygons(tiles), rtol=1e-6)
    assert list(polygons.labels) == list(range(1, chosen.sum() + 1))
    cloud = round_trip("sensor_msgs/msg/PointCloud2", export.to_ros_points(depth, CAMERA, "camera", float("nan")))
    assert (cloud.height, cloud.width, cloud.is_dense) == (60, 80, False)
    assert (cloud.row_step, cloud.is_bigendian) == (len(cloud.data) // 60, False)
    assert [field.count for field in cloud.fields] == [1, 1, 1]
    dtype = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "formats": [{7: "<f4"}[field.datatype] for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    read = np.frombuffer(cloud.data, dtype).reshape(60, 80)
    expected = CAMERA.points(depth).astype(np.float32)
    for i, name in enumerate("xyz"):
        np.testing.assert_array_equal(read[name], expected[..., i])


def test_rerun_recording_holds_every_frame(depth, tiles, tmp_path):
    pytest.importorskip("rerun")

    for i in range(3):
        images.write_png(tmp_path / f"{i}.png", depth)
    sequence = FrameSequence(
        (FrameEntry(str(i), 100.5 + i, CAMERA, tmp_path / f"{i}.png") for i in range(3)), images.read_depth
    )
    recording.record(sequence, tmp_path / "planes.rrd", (12, 16), max_error=0.02)
    columns = columns_of(tmp_path / "planes.rrd")
    strips = columns["/planes/outlines", "LineStrips3D:strips"]
    assert len(strips) == 3
    polygons = export.tile_polygons(tiles)
    closed = np.concatenate([polygons, polygons[:, :1]], axis=1)
    np.testing.assert_allclose(np.array(strips[1]), closed, rtol=1e-6)
    fitted = columns["/fitted", "Scalars:scalars"]
    assert fitted == [[float(tiles.fitted.sum())]] * 3
    assert columns["/fitted", "frame"] == [0, 1, 2]
    assert len(columns["/camera/depth", "DepthImage:buffer"]) == 3
    image = np.array(columns["/camera/depth", "DepthImage:buffer"][0][0], np.uint8).view(np.float32)
    np.testing.assert_array_equal(image, (depth.ravel() / 1000).astype(np.float32))


def test_frames_that_cannot_be_recorded_are_skipped_and_named(depth, tmp_path):
    pytest.importorskip("rerun")
    for i, image in enumerate([depth, depth[::2], depth, depth[:, 1:], depth[::2]]):
        images.write_png(tmp_path / f"{i}.png", image)
    (tmp_path / "2.png").write_bytes(b"")
    entries = [FrameEntry(f"{i}.png", float(i), CAMERA, tmp_path / f"{i}.png") for i in range(5)]
    with pytest.warns(UserWarning, match="skipped") as warned:
        recording.record(FrameSequence(entries, images.read_depth), tmp_path / "planes.rrd", (12, 16))
    assert {warning.filename for warning in warned} == {__file__}
    # Without the hint that a frame of another size may be a part of one.
    messages = [str(warning.message).replace("(height, width) = ", "").split(": was it")[0] for warning in warned]
    assert messages == [
        "skipped 2 frames, 1, 4: expected a depth frame of shape (60, 80), as the camera's, got (30, 80)",
        "skipped frame 2, 2.png: not a PNG image, or damaged",
        "skipped frame 3, 3.png: expected a depth frame of shape (60, 80), as the camera's, got (60, 79)",
    ]
    assert columns_of(tmp_path / "planes.rrd")["/fitted", "frame"] == [0]

    def fail(location):
        raise MemoryError

    for record in (recording.record, recording.record_segments):
        with pytest.raises(MemoryError):
            record(FrameSequence(entries, fail), tmp_path / "none.rrd")


def test_rerun_shows_a_mirrored_camera_as_its_picture_is(depth, tmp_path):
    """A frame is the same picture whatever its camera's signs; rerun has no pinhole with negative ones."""
    pytest.importorskip("rerun")
    recorded = []
    for sign in (1.0, -1.0):
        camera = rp.Camera(80, 60, sign * 65.0, sign * 66.0, 39.5, 29.5, depth_scale=1000.0)
        sequence = FrameSequence([FrameEntry("0", 0.0, camera, 0)], [depth].__getitem__)
        recording.record(sequence, tmp_path / "planes.rrd", (12, 16))
        recorded.append(columns_of(tmp_path / "planes.rrd"))
    plain, mirrored = recorded
    shown = ("/planes/outlines", "LineStrips3D:strips"), ("/planes/normals", "Arrows3D:vectors")
    for key in (*shown, ("/camera", "Pinhole:image_from_camera")):
        np.testing.assert_allclose(mirrored[key], plain[key], rtol=1e-4, atol=1e-5)
    colours = [one["/planes/normals", "Arrows3D:colors"] for one in recorded]
    levels = [np.array(one, np.uint32).view(np.uint8).astype(int) for one in colours]
    np.testing.assert_allclose(levels[1], levels[0], atol=1)


def test_rerun_shows_the_points_of_a_fisheye(tmp_path):
    """It would draw the depth as if the camera were a pinhole, far beside the planes."""
    pytest.importorskip("rerun")
    camera = rp.Camera(80, 60, 40.0, -40.0, 39.5, 29.5, distortion_model="fisheye")
    depth = rp.scenes.room().render(camera).depth
    sequence = FrameSequence([FrameEntry("0", 0.0, camera, 0)], [depth].__getitem__)
    recording.record(sequence, tmp_path / "planes.rrd", (12, 16))
    columns = columns_of(tmp_path / "planes.rrd")
    points = camera.points(depth)[np.isfinite(depth)] * [1.0, -1.0, 1.0]
    np.testing.assert_allclose(columns["/points", "Points3D:positions"][0], points, rtol=1e-6)
    assert not any(entity == "/camera" for entity, _ in columns)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no disk that is always full")
def test_a_recording_that_a_full_disk_cannot_hold(depth):
    pytest.importorskip("rerun")
    sequence = FrameSequence([FrameEntry("0", 0.0, CAMERA, 0)], [depth].__getitem__)
    with pytest.raises(OSError, match=r"^cannot write /dev/full: .*No space left on device"):
        recording.record(sequence, "/dev/full")


def test_an_error_of_a_frame_is_no_error_of_the_recording(tmp_path):
    pytest.importorskip("rerun")

    def fail(location):
        raise RuntimeError(location)

    sequence = FrameSequence([FrameEntry("0", 0.0, CAMERA, "the frame")], fail)
    with pytest.raises(ValueError, match=r"^expected a frame .*, got none: frame 0, 0: the frame$"):
        recording.record(sequence, tmp_path / "planes.rrd")
    with pytest.raises(ValueError, match="tile"):
        recording.record(sequence, tmp_path / "planes.rrd", tile=1000)
    assert not any(tmp_path.iterdir())


def test_what_cannot_be_exported(tiles, depth, tmp_path, monkeypatch):
    batch = rp.TileFitter(CAMERA).fit_batch([depth, depth])
    with pytest.raises(ValueError, match=r"got a batch of shape \(2, 4, 5\): take tiles\[i\]"):
        export.to_dict(batch)
    with pytest.raises(TypeError, match="expected TilePlanes, got ndarray"):
        export.tile_polygons(depth)
    for name in ("open3d", "rerun"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError, match="this needs open3d: pip install open3d"):
        export.to_open3d(tiles)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "rgbd-planes\[viewer\]"'):
        recording.record([], tmp_path / "a.rrd")


@pytest.mark.parametrize("error", [ImportError, OSError])
def test_a_library_that_is_installed_and_broken(tiles, tmp_path, monkeypatch, error):
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "open3d.py").write_text(f"raise {error.__name__}('libusb-1.0.so.0: cannot open')")
    with pytest.raises(ImportError, match=r"needs open3d, which cannot be imported: libusb-1.0.so.0: cannot open$"):
        export.to_open3d(tiles)


def test_rerun_recording_has_each_frames_camera_time_and_settings(tmp_path):
    """A phone refocuses: each frame has a camera of its own."""
    pytest.importorskip("rerun")
    cameras = [rp.Camera(80, 60, fx, 66.0, 38.0, 31.0, depth_scale=1000.0) for fx in (65.0, 60.0)]
    depths = [scenes.room().render(camera).measure(holes=0.2, seed=2) for camera in cameras]
    entries = [FrameEntry(str(i), 100.5 + i, cameras[i], i) for i in range(2)]
    options = {"method": "standard_pca", "max_missing": 0.2, "max_error": 0.02}
    recording.record(FrameSequence(entries, depths.__getitem__), tmp_path / "planes.rrd", (12, 16), **options)
    columns = columns_of(tmp_path / "planes.rrd")
    assert [time.timestamp() for time in columns["/fitted", "time"]] == [100.5, 101.5]
    assert columns["/camera/depth", "DepthImage:meter"] == [[1.0], [1.0]]
    for i, camera in enumerate(cameras):
        matrix = np.reshape(columns["/camera", "Pinhole:image_from_camera"][i], (3, 3)).T  # column by column
        np.testing.assert_allclose(matrix, [[camera.fx, 0, 38], [0, 66, 31], [0, 0, 1]])
        tiles = rp.fit_tiles(depths[i], camera, (12, 16), **options)
        assert columns["/fitted", "Scalars:scalars"][i] == [np.count_nonzero(tiles.fitted)]
        polygons = export.tile_polygons(tiles)
        strips = np.array(columns["/planes/outlines", "LineStrips3D:strips"][i])
        np.testing.assert_allclose(strips[:, :4], polygons, rtol=1e-5)
        origins = columns["/planes/normals", "Arrows3D:origins"][i]
        np.testing.assert_allclose(origins, polygons.mean(axis=1), rtol=1e-4, atol=1e-6)
        vectors = np.array(columns["/planes/normals", "Arrows3D:vectors"][i])
        normals = tiles.planes[exported(tiles)][:, :3]
        np.testing.assert_allclose(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), normals, atol=1e-5)


@pytest.mark.parametrize(
    ("stamp", "sec", "nanosec"),
    [
        (1.9999999999, 2, 0),
        (-0.25, -1, 750_000_000),
        (8.2, 8, 200_000_000),
        (1_700_000_000.1, 1_700_000_000, 99_999_905),  # as much as a float tells
        (np.datetime64("1969-12-31T23:59:59.75"), -1, 750_000_000),
        (np.datetime64("2001-09-09"), 999_993_600, 0),
        (np.datetime64(1_999, "ps"), 0, 1),
        (np.datetime64("NaT", "ns"), 0, 0),
        (math.nan, 0, 0),
    ],
)
def test_stamps_are_whole_nanoseconds(stamp, sec, nanosec):
    header = export.to_ros_points(np.ones((60, 80)), CAMERA, "camera", stamp)["header"]
    assert header["stamp"] == {"sec": sec, "nanosec": nanosec}


def test_points_without_holes_are_dense():
    depth = np.ones((60, 80))
    assert export.to_ros_points(depth, CAMERA)["is_dense"] is True
    with np.errstate(all="raise"), pytest.warns(UserWarning, match="beyond 50 m"):
        export.to_ros_points(np.full((60, 80), 3.3e38), replace(CAMERA, fx=20.0, fy=20.0, distortion=()))
    depth[2, 3] = 0.0
    assert export.to_ros_points(depth, CAMERA)["is_dense"] is False


def test_a_normal_of_which_a_number_is_missing_is_none(tmp_path):
    plyfile = pytest.importorskip("plyfile")
    normals = [[0.0, np.nan, -1.0], [np.inf, 0.0, 0.0], [0.0, 0.6, -0.8]]
    export.write_ply(tmp_path / "points.ply", np.ones((3, 3)), normals=normals)
    vertex = plyfile.PlyData.read(tmp_path / "points.ply")["vertex"]
    read = np.stack([vertex["n" + name] for name in "xyz"], axis=-1)
    np.testing.assert_allclose(read, [[0.0] * 3, [0.0] * 3, [0.0, 0.6, -0.8]], rtol=1e-6)


def test_rerun_has_no_time_of_a_frame_without_one(depth, tmp_path):
    pytest.importorskip("rerun")
    entries = [FrameEntry(str(time), time, CAMERA, 0) for time in (math.nan, 100.5, math.nan, 102.5)]
    recording.record(FrameSequence(entries, [depth].__getitem__), tmp_path / "planes.rrd")
    columns = columns_of(tmp_path / "planes.rrd")
    assert sorted(columns["/fitted", "frame"]) == [0, 1, 2, 3]
    assert [time.timestamp() for time in columns["/fitted", "time"]] == [100.5, 102.5]
