"""Spheres and cylinders for other tools: JSON, PLY, markers, pictures and the command line."""

import json
import struct

import numpy as np
import pytest
from recordings import columns_of

import rgbd_planes as rp
from rgbd_planes import primitive_export, scenes
from rgbd_planes._core.status import Primitive
from rgbd_planes.cli import main as cli
from rgbd_planes.plotting.colours import label_colours
from rgbd_planes.sequences import FrameEntry, FrameSequence, images

CAMERA = rp.Camera(320, 240, 262.5, 262.5, 159.5, 119.5, depth_scale=5000.0, noise=rp.noise.NoiseModel((1e-3,)))
BALL, PIPE = ((-0.3, 0.0, 1.3), 0.15), ((0.3, 0.0, 1.3), 0.1)


@pytest.fixture(scope="module")
def depth():
    wall = scenes.polygon("wall", [(-9, -9, 2), (9, -9, 2), (9, 9, 2), (-9, 9, 2)])
    cushion = scenes.ellipsoid("cushion", (0.0, 0.4, 1.3), (0.2, 0.06, 0.06))
    things = scenes.ellipsoid("ball", BALL[0], [BALL[1]] * 3), *scenes.cylinder("pipe", *PIPE, 0.5, turn=0.0), cushion
    return scenes.Scene((wall, *things), np.eye(4)).render(CAMERA).measure(noise=1e-3, seed=2)


@pytest.fixture(scope="module")
def found(depth):
    return rp.segment(depth, CAMERA)


@pytest.fixture(scope="module")
def fits(depth, found):
    """Ball, pipe and cushion, and the wall, a plane."""
    labels = np.where(found.labels == 1, 4, found.curved_labels)
    fits = rp.fit_primitives(depth, CAMERA, labels)
    assert sorted(fits.kind) == [Primitive.NONE, Primitive.PLANE, Primitive.SPHERE, Primitive.CYLINDER]
    return fits


def of_kind(fits, kind):
    return int(np.flatnonzero(fits.kind == kind)[0])


def test_json_holds_what_has_a_kind(fits, tmp_path):
    primitive_export.write_json(tmp_path / "fits.json", fits)
    content = json.loads((tmp_path / "fits.json").read_text())
    assert content == json.loads(json.dumps(primitive_export.to_dict(fits)))
    assert rp.Camera.from_dict(content["camera"]) == CAMERA
    rows = {row["kind"]: row for row in content["primitives"]}
    assert set(rows) == {"PLANE", "SPHERE", "CYLINDER"}
    assert rows["PLANE"]["radius"] is rows["PLANE"]["radius_std"] is rows["SPHERE"]["axis"] is None
    k = of_kind(fits, Primitive.SPHERE)
    assert rows["SPHERE"]["label"] == k + 1
    assert rows["SPHERE"]["size"] == np.count_nonzero(fits.labels == k + 1)
    assert rows["SPHERE"]["radius"] == fits.radius[k] == pytest.approx(BALL[1], abs=0.003)
    assert rows["SPHERE"]["radius_std"] == fits.radius_std[k]
    assert rows["SPHERE"]["convex"] is True
    np.testing.assert_array_equal(rows["CYLINDER"]["covariance"], fits.covariance[of_kind(fits, Primitive.CYLINDER)])


@pytest.mark.parametrize("step", [1, 2])
def test_patches_lie_on_primitives_and_face_the_camera(fits, step):
    points, triangles, labels = primitive_export.patches(fits, step)
    assert set(labels) == set(np.flatnonzero(fits.kind != Primitive.NONE) + 1)
    v, u = np.indices(CAMERA.shape)[:, ::step, ::step]
    expected = fits.surface_depth()[::step, ::step]
    there = np.isfinite(expected)
    np.testing.assert_allclose(points[:, 2], expected[there])
    np.testing.assert_allclose(points[:, 0] / points[:, 2], CAMERA.tan_x[0, u[there]])
    np.testing.assert_allclose(points[:, 1] / points[:, 2], CAMERA.tan_y[v[there], 0])
    assert (labels[triangles] == labels[triangles[:, :1]]).all()
    corners = points[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((across * corners[:, 0]).sum(axis=1) < 0.0).all()
    k = of_kind(fits, Primitive.SPHERE)
    of_ball = np.linalg.norm(across[labels[triangles[:, 0]] == k + 1], axis=1).sum() / 2.0
    assert 1.2 * np.pi * BALL[1] ** 2 < of_ball < 2.0 * np.pi * BALL[1] ** 2  # nearly the half of it that is seen


def test_a_mesh_has_normals_and_colours(fits, tmp_path):
    primitive_export.write_mesh_ply(tmp_path / "fits.ply", fits)
    header, body = (tmp_path / "fits.ply").read_bytes().split(b"end_header\n")
    points, triangles, labels = primitive_export.patches(fits)
    assert f"element vertex {len(points)}\n".encode() in header
    assert f"element face {len(triangles)}\n".encode() in header
    vertices = np.array([struct.unpack_from("<6f3B", body, 27 * i) for i in range(len(points))])
    np.testing.assert_allclose(vertices[:, :3], points, rtol=1e-6)
    normals = vertices[:, 3:6]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-5)
    assert ((normals * points).sum(axis=1) < 0.0).all()
    for kind, turned in ((Primitive.SPHERE, [1, 1, 1]), (Primitive.CYLINDER, [1, 0, 1])):
        k = of_kind(fits, kind)
        own = labels == k + 1
        away = (points[own] - fits.centre[k]) * turned  # the pipe is upright
        np.testing.assert_allclose(normals[own], away / np.linalg.norm(away, axis=1, keepdims=True), atol=0.03)
        np.testing.assert_array_equal(vertices[own][0, 6:], np.rint(255.0 * label_colours(len(fits))[k]))


def test_markers_are_where_the_primitives_are(fits):
    markers = primitive_export.to_ros_markers(fits, "camera", stamp=1.5)["markers"]
    by_type = {marker["type"]: marker for marker in markers}
    assert len(markers) == 2
    ball, pipe = by_type[2], by_type[3]
    assert pipe["header"] == {"stamp": {"sec": 1, "nanosec": 500_000_000}, "frame_id": "camera"}
    assert list(ball["pose"]["position"].values()) == pytest.approx(BALL[0], abs=0.01)
    assert list(pipe["pose"]["position"].values()) == pytest.approx(PIPE[0], abs=0.02)
    assert ball["scale"]["x"] == ball["scale"]["z"] == pytest.approx(2.0 * BALL[1], abs=0.006)
    assert (pipe["scale"]["x"], pipe["scale"]["z"]) == (pytest.approx(0.2, abs=0.01), pytest.approx(0.5, abs=0.03))
    x, y, z, w = pipe["pose"]["orientation"].values()
    along = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]  # of the turned z axis
    assert abs(along[1]) == pytest.approx(1.0, abs=1e-3)
    json.dumps(markers)


def test_a_frame_without_surfaces(tmp_path):
    none = rp.fit_primitives(np.zeros(CAMERA.shape), CAMERA, np.zeros(CAMERA.shape, int))
    assert primitive_export.to_dict(none)["primitives"] == []
    assert primitive_export.to_ros_markers(none) == {"markers": []}
    primitive_export.write_mesh_ply(tmp_path / "none.ply", none)
    assert b"element face 0\n" in (tmp_path / "none.ply").read_bytes()


def test_what_is_no_fit_is_refused(found, fits):
    with pytest.raises(TypeError, match=r"expected PrimitiveFits, got Segmentation: rp\.fit_primitives makes them"):
        primitive_export.to_dict(found)
    with pytest.raises(TypeError, match="expected primitives as PrimitiveFits, got Segmentation"):
        found.plot(primitives=found)
    small = rp.Camera(20, 10, 20.0, 20.0, 9.5, 4.5, depth_scale=1000.0)
    with pytest.raises(ValueError, match=r"primitives of a frame of shape \(10, 20\), got \(240, 320\)"):
        rp.segment(np.zeros((10, 20)), small).plot(primitives=fits)


def test_the_picture_says_how_large_they_are(found, fits, depth):
    k = of_kind(fits, Primitive.SPHERE)
    plain, figure = found.plot(depth), found.plot(depth, primitives=fits)
    texts = {text.get_text() for text in figure.axes[0].texts}
    assert {text.get_text() for text in plain.axes[0].texts} < texts
    ball = next(text for text in texts if text.startswith("sphere"))
    radius, std = ball.removeprefix("sphere\n").removesuffix(" mm").split(" ± ")
    assert float(radius) == pytest.approx(1e3 * fits.radius[k], abs=0.06)
    assert float(std) == pytest.approx(1e3 * fits.radius_std[k], rel=0.06)
    before, after = (panel.axes[0].images[0].get_array() for panel in (plain, figure))
    changed = (before != after).any(axis=2)
    round_ones = np.isin(fits.labels, np.flatnonzero(fits.kind >= Primitive.SPHERE) + 1)
    assert not changed[~round_ones].any()
    assert changed[round_ones & (found.labels == 0)].mean() > 0.95


def test_the_command_line_finds_them(depth, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    images.write_png("depth.png", depth)
    CAMERA.save("camera.json")
    command = ["segment", "depth.png", "--camera", "camera.json", "--primitives", "--out", "found.json"]
    assert cli.main([*command, "--figure", "found.png"]) == 0
    printed = capsys.readouterr().out
    assert "3 curved surfaces, 2 of them spheres and cylinders." in printed
    row = next(line for line in printed.splitlines() if " sphere " in line).split()
    content = json.loads((tmp_path / "found.json").read_text())
    ball = next(row for row in content["primitives"] if row["kind"] == "SPHERE")
    assert int(row[0]) == ball["label"]
    assert float(row[6]) == pytest.approx(1e3 * ball["radius"], abs=0.01)
    assert len(content["planes"]) >= 1
    assert (tmp_path / "found.png").stat().st_size > 1000


def test_a_recording_shows_what_is_round_by_its_ids(depth, tmp_path):
    pytest.importorskip("rerun")
    pytest.importorskip("shapely")
    small = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=5000.0)
    frames = [(depth, CAMERA), (depth, CAMERA), (np.full(small.shape, 10_000, np.uint16), small)]
    entries = [FrameEntry(str(i), float(i), camera, i) for i, (_, camera) in enumerate(frames)]
    sequence = FrameSequence(entries, lambda i: frames[i][0])
    rp.recording.record_segments(sequence, tmp_path / "round.rrd", primitives=True)
    columns = columns_of(tmp_path / "round.rrd")
    corners = columns["/planes/primitives", "Mesh3D:vertex_positions"]
    triangles = columns["/planes/primitives", "Mesh3D:triangle_indices"]
    found = rp.segment(depth, CAMERA)
    fits = rp.fit_primitives(depth, CAMERA, found.curved_labels)
    points, expected, labels = primitive_export.patches(fits)
    np.testing.assert_allclose(np.array(corners[0]), points, rtol=1e-5, atol=1e-6)
    is_round = fits.kind[labels[expected[:, 0]] - 1] >= Primitive.SPHERE
    np.testing.assert_array_equal(np.array(triangles[1]), expected[is_round])
    colours = columns["/planes/primitives", "Mesh3D:vertex_colors"]
    assert colours[0] == colours[1]
    assert len(set(colours[0])) >= 2
    assert not corners[2]
    rp.recording.record_segments(sequence, tmp_path / "flat.rrd")
    assert not any(entity == "/planes/primitives" for entity, _ in columns_of(tmp_path / "flat.rrd"))
    with pytest.raises(TypeError, match="primitives"):
        rp.recording.record_segments(sequence, tmp_path / "none.rrd", primitives=1)
