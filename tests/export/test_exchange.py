"""PCD, CSV, normals as images, messages for JSON, and arrays of other libraries."""

import base64
import csv
import json

import numpy as np
import pytest
from PIL import Image

import rgbd_planes as rp
from rgbd_planes import export
from rgbd_planes.cli import main as cli

CAMERA = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_scale=1000.0)


@pytest.fixture(scope="module")
def depth():
    made = rp.scenes.room().render(CAMERA).measure(seed=1)
    made[:5, :7] = 0
    return made


def read_pcd(path):
    header, _, body = path.read_bytes().partition(b"DATA binary\n")
    about = dict(line.split(" ", 1) for line in header.decode().splitlines() if not line.startswith("#"))
    names = about["FIELDS"].split()
    return about, np.frombuffer(body, [(name, "<f4") for name in names])


def test_pcd(tmp_path, depth):
    points, normals = CAMERA.points(depth), rp.normals(depth, CAMERA)
    export.write_pcd(tmp_path / "a.pcd", points, normals=normals)
    about, values = read_pcd(tmp_path / "a.pcd")
    assert (about["WIDTH"], about["HEIGHT"], about["POINTS"]) == ("64", "48", str(64 * 48))
    for i, name in enumerate("xyz"):
        np.testing.assert_array_equal(values[name].reshape(48, 64), points[..., i].astype(np.float32))
        np.testing.assert_array_equal(values[f"normal_{name}"].reshape(48, 64), normals[..., i])
    export.write_pcd(tmp_path / "b.pcd", points.reshape(-1, 3))
    about, values = read_pcd(tmp_path / "b.pcd")
    assert (about["WIDTH"], about["HEIGHT"], len(values)) == (str(64 * 48 - 35), "1", 64 * 48 - 35)
    for wrong in (points[..., :2], points[0, 0]):
        with pytest.raises(ValueError, match="expected points of shape"):
            export.write_pcd(tmp_path / "c.pcd", wrong)
    with pytest.raises(ValueError, match=r"ends in \.pcd"):
        export.write_pcd(tmp_path / "c.ply", points)
    assert not (tmp_path / "c.pcd").exists()


def test_pcd_by_open3d(tmp_path, depth):
    open3d = pytest.importorskip("open3d")
    export.write_pcd(tmp_path / "a.pcd", CAMERA.points(depth).reshape(-1, 3))
    assert len(open3d.io.read_point_cloud(str(tmp_path / "a.pcd")).points) == 64 * 48 - 35


def test_csv(tmp_path, depth):
    table = rp.fit_tiles(depth, CAMERA, 8).to_table()
    export.write_csv(tmp_path / "a.csv", table)
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 48
    for name, values in table.items():
        if np.asarray(values).dtype.kind == "f":
            read = [float(row[name] or "nan") for row in rows]
            np.testing.assert_array_equal(read, np.asarray(values, np.float64))
    with pytest.raises(ValueError, match="columns of one length, got 1, 2"):
        export.write_csv(tmp_path / "b.csv", {"a": [1], "b": [1, 2]})


def test_normals_as_images(tmp_path, depth):
    normals = rp.normals(depth, CAMERA)
    for name in ("n.png", "n.tif", "n.npy"):
        export.write_normals(tmp_path / name, normals)
    np.testing.assert_array_equal(np.load(tmp_path / "n.npy"), normals)
    shown = np.asarray(Image.open(tmp_path / "n.png")).astype(float) / 127.5 - 1.0
    there = np.isfinite(normals).all(axis=-1)
    np.testing.assert_allclose(shown[there], normals[there], atol=0.005)
    assert (shown[~there] == -1.0).all()
    cv2 = pytest.importorskip("cv2")
    read = cv2.imread(str(tmp_path / "n.tif"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read[..., ::-1], normals)  # OpenCV has blue first
    with pytest.raises(ValueError, match=r"expected a path that ends in \.png"):
        export.write_normals(tmp_path / "n.exr", normals)
    with pytest.raises(ValueError, match=r"expected normals of shape \(H, W, 3\)"):
        export.write_normals(tmp_path / "n.png", depth)


@pytest.mark.filterwarnings("default")
def test_commands_write_them(tmp_path, monkeypatch, depth):
    monkeypatch.chdir(tmp_path)
    rp.images.write_png("depth.png", depth)
    CAMERA.save("camera.json")
    assert cli.main(["normals", "depth.png", "--camera", "camera.json", "--out", "n.png"]) == 0
    assert cli.main(["fit", "depth.png", "--camera", "camera.json", "--tile", "8", "--out", "p.csv"]) == 0
    assert len((tmp_path / "p.csv").read_text().splitlines()) == 49


def test_messages_for_json(depth):
    message = export.to_ros_points(depth, CAMERA)
    read = json.loads(json.dumps(export.json_ready(message), allow_nan=False))
    assert base64.b64decode(read["data"]) == message["data"]
    assert {**read, "data": 0} == {**message, "data": 0}
    found = rp.segment(depth, CAMERA)
    labels = rp.segmentation_export.to_ros_labels(found)
    assert base64.b64decode(export.json_ready(labels)["data"]) == labels["data"]
    assert export.json_ready({"a": np.float32(np.nan), "b": (1, np.arange(2))}) == {"a": None, "b": [1, [0, 1]]}


class Elsewhere:
    """An array with nothing but DLPack, of a device."""

    def __init__(self, array, device=1):
        self.array, self.device = array, device

    def __dlpack__(self, **options):
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.device, 0


def test_arrays_of_other_libraries(depth):
    from rgbd_planes._core.checks import plain_array

    metres = depth / 1000.0
    assert np.shares_memory(plain_array("depth", Elsewhere(metres)), metres)
    expected = rp.fit_tiles(metres, CAMERA, 8).planes
    np.testing.assert_array_equal(rp.fit_tiles(Elsewhere(metres), CAMERA, 8).planes, expected)
    with pytest.raises(TypeError, match=r"expected depth in the CPU's memory, got a .*Elsewhere on another device"):
        rp.fit_tiles(Elsewhere(metres, device=2), CAMERA, 8)


def test_torch(depth):
    torch = pytest.importorskip("torch")
    metres = torch.from_numpy(depth / 1000.0)
    expected = rp.fit_tiles(metres.numpy(), CAMERA, 8).planes
    np.testing.assert_array_equal(rp.fit_tiles(metres, CAMERA, 8).planes, expected)
    with pytest.raises(TypeError, match="detach"):
        rp.fit_tiles(metres.clone().requires_grad_(), CAMERA, 8)
