"""Segmentations as files, and the command that writes them."""

import json

import numpy as np
import pytest
from PIL import Image

from rgbd_planes import Camera, cli, images, scenes, segment
from rgbd_planes.segmentation_export import write_points_ply, write_polygons_ply

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
    for label in range(len(found) + 1):
        own = vertices[seen == label]
        assert len(np.unique(own[["red", "green", "blue", "nx", "ny", "nz"]])) <= 1
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
    assert len(faces) == len(vertices) // 3 * (1 + 3 * 4)
    write_polygons_ply(tmp_path / "none.ply", [])
    assert len(read_ply(tmp_path / "none.ply")[0]) == 0


def test_command_writes_everything(folder, capsys, depth):
    pytest.importorskip("shapely")
    names = {"out": "planes.json", "labels": "labels.png", "figure": "planes.png"}
    names |= {"points": "points.ply", "mesh": "mesh.ply"}
    options = [word for name, file in names.items() for word in (f"--{name}", file)]
    assert cli.main(["segment", "depth.png", "--camera", "camera.json", "--polygons", *options]) == 0
    out = capsys.readouterr().out
    found = segment(depth, CAMERA)
    assert f"{len(found)} planes on" in out
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


def test_command_passes_its_options_on(folder, capsys):
    arguments = ["segment", "depth.png", "--camera", "camera.json"]
    assert cli.main([*arguments, "--min-size", "2000"]) == 0
    few = int(capsys.readouterr().out.split()[0])
    assert cli.main(arguments) == 0
    assert int(capsys.readouterr().out.split()[0]) > few > 0
    assert cli.main([*arguments, "--noise", "1.0"]) == 0
    assert int(capsys.readouterr().out.split()[0]) <= 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--polygons"], "give --out"),
        (["--out", "planes.txt"], "ends in .json"),
        (["--noise", "-1"], "noise must be a positive"),
        (["--min-size", "1"], "min_size must be at least 3"),
    ],
)
def test_command_fails_in_one_line(folder, capsys, options, message):
    assert cli.main(["segment", "depth.png", "--camera", "camera.json", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
