"""Segmentations as files, and the command that writes them."""

import base64
import importlib
import io
import json
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from recordings import columns_of
from ros_messages import round_trip

from rgbd_planes import (
    Camera,
    Segmentation,
    TileStatus,
    fit_labels,
    fit_tiles,
    recording,
    segment,
    segment_sequence,
    segmentation_export,
)
from rgbd_planes._core.status import Reason
from rgbd_planes.cli import main as cli
from rgbd_planes.evaluation import scenes
from rgbd_planes.export.segments import write_points_ply, write_polygons_ply
from rgbd_planes.noise import kinect_v1
from rgbd_planes.plotting.colours import NO_PLANE, label_colours
from rgbd_planes.plotting.segments import label_image
from rgbd_planes.sequences import FrameEntry, FrameSequence, images

CAMERA = Camera(width=160, height=120, fx=131.0, fy=131.0, cx=79.5, cy=59.5, depth_scale=1000.0)


@pytest.fixture
def depth():
    return scenes.room().render(CAMERA).measure(holes=0.05, seed=1)


@pytest.fixture
def folder(tmp_path, monkeypatch, depth):
    monkeypatch.chdir(tmp_path)
    images.write_png("depth.png", depth)
    CAMERA.save("camera.json")
    return tmp_path


def read_ply(path):
    """Vertices as a structured array, and the bytes after them."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    count = int(next(line.split()[2] for line in lines if line.startswith("element vertex")))
    types = {"float": "<f4", "uchar": "u1"}
    fields = [line.split()[1:] for line in lines if line.startswith("property") and "list" not in line]
    vertices = np.frombuffer(body, [(name, types[kind]) for kind, name in fields], count)
    return vertices, body[vertices.nbytes :]


def test_points_have_the_colours_of_their_planes(tmp_path, depth):
    found = segment(depth, CAMERA)
    write_points_ply(tmp_path / "points.ply", found, depth)
    vertices, _ = read_ply(tmp_path / "points.ply")
    assert len(vertices) == np.count_nonzero(depth)
    seen = found.labels[depth > 0]
    points = CAMERA.points(depth)[depth > 0]
    assert np.column_stack([vertices["x"], vertices["y"], vertices["z"]]) == pytest.approx(points, rel=1e-6)
    colours = np.rint(255.0 * np.vstack([[NO_PLANE], label_colours(len(found))]))
    for label in range(len(found) + 1):
        own = vertices[seen == label]
        assert len(np.unique(own[["red", "green", "blue", "nx", "ny", "nz"]])) == 1
        assert own[["red", "green", "blue"]][0].tolist() == tuple(colours[label])
    assert [vertices[seen == 0][name].any() for name in ("nx", "ny", "nz")] == [False] * 3
    largest = 1 + int(found.sizes.argmax())
    normal = [float(vertices[seen == largest][name][0]) for name in ("nx", "ny", "nz")]
    assert normal == pytest.approx(found.planes[largest - 1, :3], rel=1e-6)


def test_mesh_lies_on_the_planes(tmp_path, depth):
    pytest.importorskip("shapely")
    from rgbd_planes import plane_polygons

    found = segment(depth, CAMERA)
    polygons = plane_polygons(found)
    write_polygons_ply(tmp_path / "mesh.ply", polygons)
    vertices, faces = read_ply(tmp_path / "mesh.ply")
    points = np.column_stack([vertices[name] for name in "xyz"]).astype(float)
    normals = np.column_stack([vertices[name] for name in ("nx", "ny", "nz")]).astype(float)
    distance = np.abs((points * normals).sum(axis=1))
    assert np.abs(distance[:, None] - found.planes[:, 3]).min(axis=1).max() < 1e-4
    assert ((points * normals).sum(axis=1) < 0.0).all()  # they point towards the camera
    assert len(faces) == len(vertices) // 3 * (1 + 3 * 4)
    write_polygons_ply(tmp_path / "none.ply", [])
    assert len(read_ply(tmp_path / "none.ply")[0]) == 0


def test_some_of_the_polygons_have_the_colours_of_their_labels(tmp_path, depth):
    pytest.importorskip("shapely")
    from rgbd_planes import plane_polygons

    third = plane_polygons(segment(depth, CAMERA))[2]
    write_polygons_ply(tmp_path / "mesh.ply", [third])
    vertices, _ = read_ply(tmp_path / "mesh.ply")
    (colour,) = np.unique(vertices[["red", "green", "blue"]]).tolist()
    assert colour == pytest.approx(255 * label_colours(3)[2], abs=0.5)


def test_a_dictionary_has_each_planes_own_numbers(depth):
    found = segment(depth, CAMERA)
    made = segmentation_export.to_dict(found)
    assert made["sigma"] == found.sigma
    assert [plane["label"] for plane in made["planes"]] == list(range(1, len(found) + 1))
    columns = {"plane": found.planes, "covariance": found.plane_covariance, "size": found.sizes}
    columns |= {"rmse": found.rmse, "rmse_metric": found.rmse_metric}
    for name, values in columns.items():
        assert [plane[name] for plane in made["planes"]] == values.tolist(), name


def test_some_of_the_polygons_keep_their_labels_in_a_message(depth):
    pytest.importorskip("shapely")
    from rgbd_planes import plane_polygons

    some = plane_polygons(segment(depth, CAMERA))[:0:-2]
    message = segmentation_export.to_ros_polygons(some)
    assert message["labels"] == [polygon.label for polygon in some for _ in polygon.rings()]


def test_polygons_go_with_their_planes_in_any_order(depth):
    pytest.importorskip("shapely")
    from rgbd_planes import plane_polygons

    found = segment(depth, CAMERA)
    polygons = plane_polygons(found)
    by_area = sorted(polygons, key=lambda polygon: polygon.area)
    assert by_area != polygons
    assert segmentation_export.to_dict(found, by_area) == segmentation_export.to_dict(found, polygons)
    with pytest.raises(ValueError, match=rf"polygon of each of the {len(found)} planes .* got 2 polygons"):
        segmentation_export.to_dict(found, polygons[:2])
    moved = replace(found, planes=found.planes + 1e-3)
    with pytest.raises(ValueError, match=rf"got {len(found)} polygons of other planes"):
        segmentation_export.to_dict(moved, polygons)


def test_a_plane_without_pixels(tmp_path, depth):
    pytest.importorskip("shapely")
    from rgbd_planes import plane_polygons

    found = segment(depth, CAMERA)
    cut = replace(found, labels=np.where(found.labels == 2, 0, found.labels).astype(np.int32))
    polygons = plane_polygons(cut)
    segmentation_export.write_json(tmp_path / "planes.json", cut, polygons)
    planes = json.loads((tmp_path / "planes.json").read_text())["planes"]
    none = {"label": 2, "rmse_metric": None, "area": 0.0, "rectangle": [], "hull": [], "outline": []}
    assert planes[1] | none == planes[1]
    assert all(plane["rmse_metric"] > 0.0 for plane in planes if plane["label"] != 2)
    segmentation_export.write_polygons_ply(tmp_path / "mesh.ply", polygons)
    ros = segmentation_export.to_ros_polygons(polygons)
    assert 2 not in ros["labels"]


@pytest.mark.parametrize("noise", [None, kinect_v1()], ids=["without", "with"])
def test_planes_of_ones_own_labels(tmp_path, depth, noise):
    """As those of a segmentation; a label without a plane is left out."""
    pytest.importorskip("shapely")
    from rgbd_planes import plane_polygons

    camera = CAMERA.with_noise(noise)
    found = segment(depth, camera)
    labels = np.where(found.labels == 2, 0, found.labels)
    labels[:2, :1] = 2  # too few pixels
    made = fit_labels(depth, camera, labels)
    there = np.flatnonzero(made.fitted)
    assert 1 not in there
    polygons = plane_polygons(made)
    segmentation_export.write_json(tmp_path / "planes.json", made, polygons)
    read = json.loads((tmp_path / "planes.json").read_text())
    assert read["camera"] == json.loads(json.dumps(camera.to_dict()))
    assert read["method"] == made.method
    assert [plane["label"] for plane in read["planes"]] == (there + 1).tolist()
    for i, plane in zip(there, read["planes"], strict=True):
        assert plane["plane"] == made.planes[i].tolist()
        assert (plane["size"], plane["status"]) == (made.valid_count[i], TileStatus(made.status[i]).name)
        assert (plane["rmse"], plane["rmse_metric"]) == (made.rmse[i], made.rmse_metric[i])
        assert plane["area"] > 0.0
        assert ("covariance" in plane) == ("p_value" in plane) == (noise is not None)
        if noise is not None:
            assert (plane["covariance"], plane["p_value"]) == (made.plane_covariance[i].tolist(), made.p_value[i])
    planes = segmentation_export.to_ros_planes(made)["coefficients"]
    assert [plane["values"] for plane in planes] == made.planes[there].tolist()
    assert segmentation_export.to_ros_labels(made)["data"] == labels.astype("<i4").tobytes()
    segmentation_export.write_labels(tmp_path / "labels.png", made)
    np.testing.assert_array_equal(images.read_depth(tmp_path / "labels.png"), labels)
    write_points_ply(tmp_path / "points.ply", made, depth)
    vertices, _ = read_ply(tmp_path / "points.ply")
    seen = labels[depth > 0]
    normals = np.vstack([np.zeros(3), np.nan_to_num(made.planes[:, :3])])[seen]
    np.testing.assert_allclose(np.stack([vertices[f"n{axis}"] for axis in "xyz"], axis=1), normals, atol=1e-6)
    with pytest.raises(ValueError, match=rf"each of the {len(there)} planes of this .* got {len(there) - 1} polygons"):
        segmentation_export.to_dict(made, polygons[1:])


def test_the_size_of_ones_own_label_counts_what_is_measured(depth):
    made = fit_labels(depth, CAMERA, np.ones(CAMERA.shape, int))
    (plane,) = segmentation_export.to_dict(made)["planes"]
    assert plane["size"] == np.count_nonzero(depth) < depth.size


def test_what_is_no_segmentation(tmp_path, depth):
    tiles = fit_tiles(depth, CAMERA)
    message = "expected a Segmentation or LabelPlanes, got TilePlanes; rp.export is for tiles"
    with pytest.raises(TypeError, match=message):
        segmentation_export.write_json(tmp_path / "planes.json", tiles)
    with pytest.raises(TypeError, match=message):
        segmentation_export.write_labels(tmp_path / "labels.png", tiles)
    with pytest.raises(TypeError, match=message):
        write_points_ply(tmp_path / "points.ply", tiles, depth)
    for to_ros in (segmentation_export.to_ros_planes, segmentation_export.to_ros_labels):
        with pytest.raises(TypeError, match=message):
            to_ros(tiles)
    (tracked,) = segment_sequence([depth], CAMERA)
    with pytest.raises(TypeError, match=r"got TrackedSegmentation: its \.segmentation is one"):
        segmentation_export.write_json(tmp_path / "planes.json", tracked)
    with pytest.raises(TypeError, match=r"of PlanePolygon, got <Segmentation: .*>: rp\.plane_polygons makes them"):
        write_polygons_ply(tmp_path / "mesh.ply", tracked.segmentation)
    assert not any(tmp_path.iterdir())


def test_command_writes_everything(folder, capsys, depth):
    pytest.importorskip("shapely")
    names = {"out": "planes.json", "labels": "labels.png", "figure": "planes.png"}
    names |= {"points": "points.ply", "mesh": "mesh.ply"}
    options = [word for name, file in names.items() for word in (f"--{name}", file)]
    assert cli.main(["segment", "depth.png", "--camera", "camera.json", "--polygons", *options]) == 0
    out = capsys.readouterr().out
    found = segment(depth, CAMERA)
    assert f"{len(found)} planes, " in out
    assert all(f"Wrote {file}" in out for file in names.values())
    with Image.open("labels.png") as labels:
        assert (np.asarray(labels) == found.labels).all()
    with Image.open("planes.png") as picture:
        assert picture.width > 400
    read = json.loads((folder / "planes.json").read_text())
    assert Camera.from_dict(read["camera"]) == CAMERA
    assert np.array([plane["plane"] for plane in read["planes"]]) == pytest.approx(found.planes)
    assert np.array([plane["covariance"] for plane in read["planes"]]).shape == (len(found), 4, 4)
    assert all(plane["area"] > 0 and plane["outline"] for plane in read["planes"])
    assert cli.main(["segment", "depth.png", "--camera", "camera.json", "--out", "planes.npz"]) == 0
    np.testing.assert_array_equal(Segmentation.load("planes.npz").labels, found.labels)


def test_command_shows_the_largest_planes(folder, capsys, depth):
    assert cli.main(["segment", "depth.png", "--camera", "camera.json"]) == 0
    _, _, header, *lines = capsys.readouterr().out.splitlines()
    found = segment(depth, CAMERA)
    shown = np.array([line.split() for line in lines], float)
    own = shown[:, 0].astype(int) - 1
    assert sorted(found.sizes[own]) == sorted(found.sizes)[-5:]
    assert (np.diff(shown[:, 1]) <= 0.0).all()
    expected = np.column_stack([found.sizes, found.planes, found.angle_std, 1e3 * found.offset_std])[own]
    np.testing.assert_allclose(shown[:, 1:], expected, rtol=0.051, atol=5.1e-4)
    np.testing.assert_allclose(shown[:, 1:6], expected[:, :5], atol=5.1e-4)
    assert all(len(line) == len(header) < 80 for line in lines)
    assert cli.main(["segment", "depth.png", "--camera", "camera.json", "--min-size", "100000"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_command_draws_planes_over_the_relief_of_the_depth(folder, depth, monkeypatch):
    figures = []
    command = importlib.import_module("rgbd_planes.cli.segment")
    monkeypatch.setattr(command, "write_figure", lambda figure, path: figures.append(figure))
    assert cli.main(["segment", "depth.png", "--camera", "camera.json", "--figure", "planes.png"]) == 0
    (image,) = figures[0].axes[0].get_images()
    found = segment(depth, CAMERA)
    np.testing.assert_allclose(image.get_array(), label_image(found, depth))
    assert (label_image(found, depth) != label_image(found)).any()


@pytest.mark.filterwarnings("default:the noise that is given")
def test_command_passes_its_options_on(folder, capsys):
    arguments = ["segment", "depth.png", "--camera", "camera.json"]
    assert cli.main([*arguments, "--min-size", "2000"]) == 0
    few = int(capsys.readouterr().out.split()[0])
    assert cli.main(arguments) == 0
    assert int(capsys.readouterr().out.split()[0]) > few > 0
    assert cli.main([*arguments, "--noise", "1.0"]) == 0
    out, err = capsys.readouterr()
    assert int(out.split()[0]) <= 2
    assert "most likely it is not in 1/m" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--polygons"], "give --out"),
        (["--polygons", "--out", "planes.npz"], "give --out with a name that ends in .json"),
        (["--out", "planes.txt"], "ends in .json or .npz"),
        (["--min-size", "1"], "--min-size must be at least 3"),
        (["--labels", "a.png", "--figure", "a.png"], "a.png: --figure would write over another file"),
        (["--points", "a.ply", "--mesh", "./a.ply"], "a.ply: --mesh would write over another file"),
        (["--labels", "depth.png"], "depth.png: --labels would write over another file"),
    ],
)
def test_command_fails_in_one_line(folder, capsys, options, message):
    assert cli.main(["segment", "depth.png", "--camera", "camera.json", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("options", [["--out", "planes.json", "--polygons"], ["--mesh", "planes.ply"]])
def test_command_asks_for_shapely_before_the_work(folder, capsys, monkeypatch, options):
    monkeypatch.setitem(sys.modules, "shapely", None)
    assert cli.main(["segment", "depth.png", "--camera", "camera.json", *options]) == 2
    shown = capsys.readouterr()
    assert 'pip install "rgbd-planes[polygons]"' in shown.err
    assert shown.out == ""


def test_a_segmentation_shows_itself(depth):
    found = segment(depth, CAMERA)
    text = found._repr_html_()
    assert f"{len(found)} planes, " in text
    (content,) = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(content))))
    assert picture.shape == (120, 160, 3)
    for label, colour in enumerate(label_colours(len(found)), start=1):
        assert (picture[found.labels == label] == np.rint(255 * colour)).all()
    assert (picture[found.reason == Reason.MISSING] == 255).all()
    largest = int(found.sizes.argmax())
    listed = f"{largest + 1}:&nbsp;{found.sizes[largest]}&nbsp;pixels,&nbsp;d&nbsp;=&nbsp;"
    assert listed + f"{found.planes[largest, 3]:.3f}" in text
    assert len(text) < 20_000
    nothing = segment(np.zeros(CAMERA.shape, np.uint16), CAMERA)._repr_html_()
    assert "0 planes" in nothing


def test_open3d_mesh(depth, tmp_path):
    pytest.importorskip("shapely")
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    from rgbd_planes import plane_polygons

    polygons = plane_polygons(segment(depth, CAMERA))
    mesh = segmentation_export.to_open3d(polygons)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    expected = np.concatenate([polygon.triangles() for polygon in polygons])
    np.testing.assert_allclose(corners, expected)
    assert mesh.get_surface_area() == pytest.approx(sum(polygon.area for polygon in polygons), rel=1e-6)
    write_polygons_ply(tmp_path / "mesh.ply", polygons)
    read = open3d.io.read_triangle_mesh(str(tmp_path / "mesh.ply"))
    assert len(read.triangles) == len(expected)


def test_open3d_is_asked_for_by_name(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(ModuleNotFoundError, match="this needs open3d: pip install open3d"):
        segmentation_export.to_open3d([])


def test_ros_messages_survive_serialisation(depth):
    pytest.importorskip("shapely")
    pytest.importorskip("rosbags")
    from rgbd_planes import plane_polygons

    depth = depth.copy()
    depth[:60] = 2000
    depth[20:40, 70:90] = 0  # a hole, which a message has no place for
    found = segment(depth, CAMERA)
    polygons = plane_polygons(found)
    assert any(len(part) > 1 for polygon in polygons for part in polygon.rings())
    about = ("camera_depth_optical_frame", 12.345678901)
    planes = round_trip(
        "jsk_recognition_msgs/msg/ModelCoefficientsArray", segmentation_export.to_ros_planes(found, *about)
    )
    read = np.array([one.values for one in planes.coefficients])
    np.testing.assert_allclose(read, found.planes, rtol=1e-6, atol=1e-7)
    assert (planes.header.stamp.sec, planes.header.frame_id) == (12, about[0])
    outlines = round_trip(
        "jsk_recognition_msgs/msg/PolygonArray", segmentation_export.to_ros_polygons(polygons, *about)
    )
    parts = [(polygon.label, part[0]) for polygon in polygons for part in polygon.rings()]
    assert list(outlines.labels) == [label for label, _ in parts]
    for message, (_, ring) in zip(outlines.polygons, parts, strict=True):
        read = np.array([(point.x, point.y, point.z) for point in message.polygon.points])
        np.testing.assert_allclose(read, ring, rtol=1e-6, atol=1e-6)
    image = round_trip("sensor_msgs/msg/Image", segmentation_export.to_ros_labels(found, *about))
    assert (image.encoding, image.is_bigendian) == ("32SC1", 0)
    read = np.asarray(image.data, np.uint8).view("<i4").reshape(image.height, image.step // 4)
    assert np.array_equal(read, found.labels)


def test_rerun_recording_holds_every_frame(tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    pytest.importorskip("shapely")
    rendering = scenes.room().render(CAMERA)
    frames = [rendering.measure(holes=0.05, seed=seed) for seed in range(3)]
    frames[0][:, :80] = 0  # so that ids are not labels
    frames[2][:, :80] = 0  # and the last frame has not the largest
    entries = [FrameEntry(str(i), 100.5 + i, CAMERA, i) for i in range(3)]
    recording.record_segments(FrameSequence(entries, frames.__getitem__), tmp_path / "planes.rrd")
    columns = columns_of(tmp_path / "planes.rrd")
    tracked = list(segment_sequence(frames, CAMERA))
    assert not np.array_equal(tracked[1].labels, tracked[1].segmentation.labels)
    assert tracked[2].ids.max() < tracked[1].ids.max()
    assert columns["/found", "Scalars:scalars"] == [[float(len(one.ids))] for one in tracked]
    images_read = columns["/camera/planes", "SegmentationImage:buffer"]
    for read, one in zip(images_read, tracked, strict=True):
        assert np.array_equal(np.array(read[0], np.uint8).view(np.uint16), one.labels.ravel())
    from rgbd_planes import plane_polygons

    expected = [ring for p in plane_polygons(tracked[1].segmentation) for part in p.rings() for ring in part]
    strips = columns["/planes/outlines", "LineStrips3D:strips"][1]
    assert len(strips) == len(expected)
    for strip, ring in zip(strips, expected, strict=True):
        np.testing.assert_allclose(np.array(strip), [*ring, ring[0]], rtol=1e-5, atol=1e-6)
    (classes,) = columns["/", "AnnotationContext:context"]
    assert len(classes[0]) == 1 + max(one.ids.max() for one in tracked)  # 0 is none
    recording.record_segments(FrameSequence(entries, frames.__getitem__), tmp_path / "large.rrd", min_size=600)
    large = [float(len(one.ids)) for one in segment_sequence(frames, CAMERA, min_size=600)]
    assert large != [float(len(one.ids)) for one in tracked]
    assert columns_of(tmp_path / "large.rrd")["/found", "Scalars:scalars"] == [[count] for count in large]
    # What is left of many ids in the 16 bits of a class: none of them is none.
    monkeypatch.setattr("rgbd_planes.export.rerun_scene._MOST_CLASSES", 3)
    recording.record_segments(FrameSequence(entries, frames.__getitem__), tmp_path / "few.rrd")
    columns = columns_of(tmp_path / "few.rrd")
    for read, one in zip(columns["/camera/planes", "SegmentationImage:buffer"], tracked, strict=True):
        expected = np.where(one.labels, (one.labels - 1) % 3 + 1, 0)
        assert np.array_equal(np.array(read[0], np.uint8).view(np.uint16), expected.ravel())


@pytest.mark.parametrize("is_given", [False, True])
def test_a_recording_has_the_path_of_the_camera(depth, tmp_path, is_given):
    """Of the frames themselves, or as an odometry found it; one pose is not known."""
    pytest.importorskip("rerun")
    pytest.importorskip("shapely")
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = [(0.0, 0.0, 0.0), (np.nan, 0.0, 0.0), (0.1, -0.2, 0.3)]
    poses[2, :3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    stated = [None if is_given or i == 1 else pose for i, pose in enumerate(poses)]
    entries = [FrameEntry(f"{i}.png", float(i), CAMERA, i, pose) for i, pose in enumerate(stated)]
    sequence = FrameSequence(entries, [depth, depth, depth].__getitem__)
    for write in (recording.record, recording.record_segments):
        write(sequence, tmp_path / "path.rrd", poses=poses if is_given else None)
        columns = columns_of(tmp_path / "path.rrd")
        first, last = columns["/path", "LineStrips3D:strips"]
        np.testing.assert_allclose(first, [[poses[0, :3, 3]]])
        np.testing.assert_allclose(last, [[poses[0, :3, 3], poses[2, :3, 3]]], rtol=1e-6)
        for entity in ("/camera", "/planes"):
            turn = np.reshape(columns[entity, "Transform3D:mat3x3"][-1], (3, 3)).T  # by columns
            np.testing.assert_allclose(turn, poses[2, :3, :3])
        with pytest.raises(ValueError, match="expected 3 poses"):
            write(sequence, tmp_path / "path.rrd", poses=poses[:2])


def test_frames_that_cannot_be_recorded_are_skipped_and_named(depth, tmp_path):
    pytest.importorskip("rerun")
    pytest.importorskip("shapely")
    frames = [depth, depth[1:], depth]
    sequence = FrameSequence([FrameEntry(f"{i}.png", float(i), CAMERA, i) for i in range(3)], frames.__getitem__)
    with pytest.warns(UserWarning, match=r"^skipped frame 1, 1\.png: expected a depth frame of shape"):
        recording.record_segments(sequence, tmp_path / "planes.rrd")
    assert columns_of(tmp_path / "planes.rrd")["/found", "frame"] == [0, 2]
    with pytest.raises(TypeError, match="min_size"):
        recording.record_segments(sequence, tmp_path / "planes.rrd", min_size="60")


def test_rerun_shows_a_mirrored_camera_as_its_picture_is(depth, tmp_path):
    pytest.importorskip("rerun")
    pytest.importorskip("shapely")
    recorded = []
    for sign in (1.0, -1.0):
        camera = replace(CAMERA, fx=sign * 131.0, fy=sign * 131.0)
        sequence = FrameSequence([FrameEntry("0", 0.0, camera, 0)], [depth].__getitem__)
        recording.record_segments(sequence, tmp_path / "planes.rrd")
        recorded.append(columns_of(tmp_path / "planes.rrd")["/planes/outlines", "LineStrips3D:strips"][0])
    assert len(recorded[0]) >= 3
    for plain, mirrored in zip(*recorded, strict=True):
        np.testing.assert_allclose(mirrored, plain, rtol=1e-4, atol=1e-5)


def test_labels_of_more_than_8_bits_are_written(tmp_path):
    labels = np.arange(CAMERA.width * CAMERA.height).reshape(CAMERA.shape) % 700
    segmentation_export.write_labels(tmp_path / "labels.png", fit_labels(np.ones(CAMERA.shape), CAMERA, labels))
    np.testing.assert_array_equal(images.read_depth(tmp_path / "labels.png"), labels)


def test_labels_that_16_bits_cannot_hold(depth, tmp_path):
    many = replace(segment(depth, CAMERA), planes=np.zeros((65536, 4)))
    with pytest.raises(ValueError, match="at most 65535 planes, which 16 bits can tell apart, got 65536"):
        segmentation_export.write_labels(tmp_path / "labels.png", many)
    assert not any(tmp_path.iterdir())


def test_command_adds_outlines_only_where_they_are_asked_for(folder):
    pytest.importorskip("shapely")
    arguments = ["segment", "depth.png", "--camera", "camera.json", "--mesh", "planes.ply", "--out", "planes.json"]
    for more in ([], ["--polygons"]):
        assert cli.main([*arguments, *more]) == 0
        planes = json.loads((folder / "planes.json").read_text())["planes"]
        assert [("outline" in plane) for plane in planes] == [bool(more)] * len(planes)
