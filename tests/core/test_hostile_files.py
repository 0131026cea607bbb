"""Files made to take memory or time, or to command a terminal: answered soon, in one line, in little memory."""

import bz2
import functools
import io
import json
import os
import sqlite3
import struct
import subprocess
import sys
import zipfile
import zlib
from contextlib import closing, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bags import messages, type_store, write_bag
from matroska import write_recording

import rgbd_planes as rp
from rgbd_planes import sequences
from rgbd_planes._core import files
from rgbd_planes._core.text import shown
from rgbd_planes._core.user_warnings import warn_caller
from rgbd_planes.cli import main as cli
from rgbd_planes.sequences import images
from rgbd_planes.sequences.unpacking import MOST_UNPACKED, check_chunk, unpacked

CAMERA = rp.Camera(8, 6, 7.0, 7.5, 3.5, 2.5, depth_scale=1000.0)
MOST = 2**30  # bytes of a process

READ = """
import pathlib, re, resource, sys, time
sys.path[:0] = sys.argv[3:]
import numpy as np
import rgbd_planes as rp
from rgbd_planes.sequences import images
begin = time.monotonic()
try:
    {"depth": images.read_depth, "camera": rp.Camera.load, "planes": rp.TilePlanes.load,
     "sequence": lambda path: [len(frame.depth) for frame in rp.open_sequence(path)]}[sys.argv[1]](sys.argv[2])
except ValueError as error:
    print(type(error).__name__, str(error).splitlines()[0][-300:])
else:
    print("read")
status = pathlib.Path("/proc/self/status")
if status.exists():  # of Linux, whose ru_maxrss begins with that of the process that started this one
    peak = int(re.search(r"VmHWM:\\s*(\\d+) kB", status.read_text())[1])
else:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(peak * 1024, time.monotonic() - begin)
"""


def answer(kind, path):
    """What reading says, in a process of its own; the limits of memory and time hold."""
    done = subprocess.run(
        [sys.executable, "-c", READ, kind, str(path), *sys.path], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    *said, numbers = done.stdout.splitlines()
    memory, seconds = map(float, numbers.split())
    assert memory < MOST, f"{memory / 2**20:.0f} MiB"
    assert seconds < 10.0  # not a measurement: the slowest takes two on a busy machine
    return "\n".join(said)


def sens(path, width, height, content):
    matrix = np.diag([7.0, 7.0, 1.0, 1.0]).astype("<f4").tobytes()
    head = struct.pack("<IQ", 4, 0) + 4 * matrix + struct.pack("<iiIIIIfQ", 2, 1, 16, 12, width, height, 1000.0, 1)
    path.write_bytes(head + bytes(64) + struct.pack("<QQQQ", 0, 1, 0, len(content)) + content)


@functools.cache
def long():
    """2 MB for two gigabytes of zeros: equal pieces after the first, since to compress all would take seconds."""
    packer, zeros, pieces = zlib.compressobj(9), bytes(2**24), 2**7
    first, again = (packer.compress(zeros) + packer.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    check_sum = (pieces * len(zeros) % 65521) << 16 | 1  # Adler's, of zeros
    return first + (pieces - 1) * again + b"\3\0" + struct.pack(">I", check_sum)


def array_header(shape, dtype="<u2"):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def bomb(path):
    """A file of the kind that its name says, small, but large once unpacked or believed."""
    name, size = path.name, 2**30
    if path.suffix == ".sens":
        sens(path, *((2**15, 2**15) if name == "bomb.sens" else (2**32 - 1, 2**32 - 1)), long())
    elif name == "comments.pgm":
        path.write_bytes(b"P5" + b"#\n" * 3_000_000 + b"8 6 255\n" + bytes(48))
    elif path.suffix in (".pgm", ".pfm"):
        header = {"sparse.pgm": b"P5 30000 30000 65535\n", "text.pgm": b"P2 30000 30000 255\n"}
        path.write_bytes(header.get(name, b"Pf 30000 30000 -1\n"))
        os.truncate(path, 2 * size)
    elif path.suffix == ".npz":
        with (
            zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
            archive.open("depth.npy", "w", force_zip64=True) as member,
        ):
            member.write(array_header((2**15, 2**15)))
            for _ in range(2**7):
                member.write(bytes(2**24))
    elif path.suffix == ".npy":
        path.write_bytes(array_header((2**15, 2**15)))
        os.truncate(path, len(array_header((2**15, 2**15))) + 2 * size)
    elif path.suffix == ".png":
        chunk = b"IDAT" + long()
        head = b"IHDR" + struct.pack(">IIBBBBB", 2**13, 2**13, 16, 0, 0, 0, 0)
        parts = [head, chunk, b"IEND"]
        path.write_bytes(
            b"\x89PNG\r\n\x1a\n"
            + b"".join(struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in parts)
        )
    elif path.suffix == ".tif":
        entries = [(256, 4, 2**13), (257, 4, 2**13), (258, 3, 16), (259, 3, 8), (262, 3, 1), (273, 4, 200)]
        entries += [(278, 4, 2**13), (279, 4, len(long()))]
        directory = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", t, k, 1, v) for t, k, v in entries)
        path.write_bytes((b"II*\0" + struct.pack("<I", 8) + directory).ljust(200, b"\0") + long())
    return path


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("comments.pgm", "not a PGM image"),
        ("sparse.pgm", "at most 33554432 pixels in a file, got 30000 x 30000"),
        ("text.pgm", "at most 33554432 pixels"),
        ("sparse.pfm", "at most 33554432 pixels"),
        ("bomb.npz", "at most 33554432 pixels"),
        ("sparse.npy", "at most 33554432 pixels"),
        ("bomb.png", "at most 33554432 pixels in a file, got 8192 x 8192"),
        ("bomb.tif", "at most 33554432 pixels in a file, got 8192 x 8192"),
    ],
)
@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_an_image_is_not_believed_about_memory(tmp_path, name, message):
    said = answer("depth", bomb(tmp_path / name))
    assert said.startswith("ValueError")
    assert message in said


@pytest.mark.parametrize("name", ["bomb.sens", "wide.sens"])
def test_a_recording_is_not_believed_about_memory(tmp_path, name):
    assert "at most 33554432 pixels in a file" in answer("sequence", bomb(tmp_path / name))


def test_a_frame_of_the_right_size_that_unpacks_to_more_is_damaged(tmp_path):
    sens(tmp_path / "a.sens", 8, 6, long())
    assert "expected 96 bytes of 8 x 6 pixels, got more" in answer("sequence", tmp_path / "a.sens")


@pytest.mark.parametrize("about", [True, False])
def test_a_saved_result_is_not_believed_about_memory(tmp_path, about):
    """Nor are arrays read that no result has."""
    whole = tmp_path / "whole.npz"
    rp.fit_tiles(np.full((6, 8), 1000, np.uint16), CAMERA, 3).save(whole)
    path = tmp_path / "planes.npz"
    with zipfile.ZipFile(whole) as original, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in original.namelist():
            if about or name != "about.npy":
                archive.writestr(name, original.read(name))
        with archive.open("more.npy", "w", force_zip64=True) as member:
            member.write(array_header((2**30,), "|u1"))
            for _ in range(2**6):
                member.write(bytes(2**24))
    said = answer("planes", path)
    assert "planes.npz: expected at most 256 MiB from" in said


def test_arrays_that_no_result_has_are_not_read(tmp_path):
    path = tmp_path / "planes.npz"
    tiles = rp.fit_tiles(np.full((6, 8), 1000, np.uint16), CAMERA, 3)
    tiles.save(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("more.npy", b"nonsense")
    assert np.array_equal(rp.TilePlanes.load(path).planes, tiles.planes)


@pytest.mark.parametrize(
    "text",
    ["[" + "{}," * 5_000_001 + "{}]", "[" * 100_000, '{"width": ' + "9" * 100_000 + "}"],
    ids=["many", "deep", "long"],  # of their own pytest would make them for seconds
)
def test_a_camera_is_not_believed_about_memory(tmp_path, text):
    (tmp_path / "camera.json").write_text(text)
    assert answer("camera", tmp_path / "camera.json").startswith("ValueError")


def test_a_text_has_an_end(tmp_path):
    path = tmp_path / "camera.json"
    path.write_bytes(b"{")
    os.truncate(path, 2**33)
    assert "expected a text of at most 256 MiB" in answer("camera", path)


@pytest.mark.parametrize("load", [rp.Camera.load, rp.TilePlanes.load, rp.Segmentation.load, images.read_depth])
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_pipes_and_devices_are_not_waited_for(tmp_path, load):
    pipe = tmp_path / "a.npy"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        with pytest.raises(ValueError, match="expected a file, got a device or a pipe"):
            load(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_no_file_of_a_data_set_is_a_pipe(tmp_path):
    for root, pipe, needed in (
        (tmp_path / "freiburg1", "depth.txt", []),
        (tmp_path / "scannet", "_info.txt", ["frame-000000.depth.pgm"]),
        (tmp_path / "plain", "camera.json", ["0.png"]),
        (tmp_path / "bag", "metadata.yaml", []),
    ):
        root.mkdir()
        os.mkfifo(root / pipe)
        for name in needed:
            (root / name).touch()
        with pytest.raises((ValueError, OSError), match=r"expected|no known format"):
            rp.open_sequence(root)


def test_chunks_of_bags_are_unpacked_up_to_a_limit(tmp_path):
    pytest.importorskip("rosbags")
    zstd = pytest.importorskip("rosbags.rosbag2.reader").zstd
    frame = np.random.default_rng(1).integers(0, 2**16, (40, 40), np.uint16)
    path = tmp_path / "a.bag"
    depth, _ = messages(type_store(path)[0], [frame])
    write_bag(path, {"/depth": [(1, depth[0])]})
    content = path.read_bytes()
    start = content.index(b"BZh")
    (size,) = struct.unpack("<I", content[start - 4 : start])
    long = 16 * bz2.compress(bytes(2**26))
    assert len(long) < size
    path.write_bytes(content[:start] + long.ljust(size, b"\0") + content[start + size :])
    with pytest.raises(ValueError, match="more than 256 MiB in one piece"):
        sequences.rosbag(path, CAMERA)
    assert unpacked(bz2.compress(b"a") + bz2.compress(b"b"), bz2.BZ2Decompressor) == b"ab"
    with pytest.raises(ValueError, match="end early"):
        unpacked(bz2.compress(b"a" * 1000)[:-4], bz2.BZ2Decompressor)
    piece = zstd.compress(np.random.default_rng(1).bytes(10**5) + bytes(10**6))
    check_chunk(5 * piece, "zstd")
    with pytest.raises(ValueError, match="more than 256 MiB"):
        check_chunk(zstd.compress(bytes(MOST_UNPACKED + 1)), "zstd")
    with pytest.raises(ValueError, match="more than 256 MiB"):
        check_chunk(300 * piece, "zstd")


def packed_bag(path, harm=""):
    """A ROS 2 bag whose file is compressed, as `ros2 bag record --compression-mode file` leaves it."""
    zstd = pytest.importorskip("rosbags.rosbag2.reader").zstd
    frame = np.random.default_rng(1).integers(0, 2**16, CAMERA.shape, np.uint16)
    depth, _ = messages(type_store(path)[0], [frame])
    write_bag(path, {"/depth": [(1, depth[0])]})
    (file,) = path.glob("*.db3")
    if harm:
        with closing(sqlite3.connect(file)) as database:
            database.execute(harm)
            database.commit()
    packed = file.with_name(file.name + ".zstd")
    packed.write_bytes(zstd.compress(file.read_bytes()))
    file.unlink()
    about = (path / "metadata.yaml").read_text().replace(file.name, packed.name)
    about = about.replace("compression_format: ''", "compression_format: zstd")
    (path / "metadata.yaml").write_text(about.replace("compression_mode: ''", "compression_mode: file"))
    return frame, packed, zstd


def test_files_of_bags_are_unpacked_up_to_a_limit(tmp_path, monkeypatch):
    pytest.importorskip("rosbags")
    frame, packed, zstd = packed_bag(tmp_path / "whole")
    np.testing.assert_array_equal(sequences.rosbag(tmp_path / "whole", CAMERA)[0].depth, frame)
    whole = packed.read_bytes()
    packed.write_bytes(whole + 5 * zstd.compress(bytes(2**26)))
    with pytest.raises(ValueError, match=r"may be up to \d+ MiB once unpacked"):
        sequences.rosbag(tmp_path / "whole", CAMERA)
    packed.write_bytes(whole)
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=1000))
    with pytest.raises(ValueError, match="there is room for 0 MiB"):
        sequences.rosbag(tmp_path / "whole", CAMERA)


def test_a_compressed_database_that_computes_is_no_bag(tmp_path):
    pytest.importorskip("rosbags")
    packed_bag(tmp_path / "computed", "CREATE VIEW more AS SELECT 1")
    with pytest.raises(ValueError, match="more is computed, not stored"):
        sequences.rosbag(tmp_path / "computed", CAMERA)


@pytest.mark.parametrize(
    "harm",
    [
        "CREATE VIEW more AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n",
        "ALTER TABLE messages ADD COLUMN more BLOB AS (zeroblob(1000000000)) VIRTUAL",
    ],
)
def test_a_database_that_computes_is_no_bag(tmp_path, harm):
    pytest.importorskip("rosbags")
    path = tmp_path / "bag"
    depth, info = messages(type_store(path)[0], [np.arange(48, dtype=np.uint16).reshape(6, 8)])
    write_bag(path, {"/depth": [(1, depth[0])], "/camera_info": [(1, info)]})
    assert len(rp.open_sequence(path)) == 1
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as database:
        database.execute(harm)
        database.commit()
    with pytest.raises(ValueError, match="is computed, not stored"):
        rp.open_sequence(path)


def test_only_matroska_is_opened_as_such(tmp_path):
    """Other formats that the library knows may be lists of files and of places in the net."""
    pytest.importorskip("av")
    path = tmp_path / "a.mkv"
    path.write_text("#EXTM3U\n#EXTINF:1,\nhttp://localhost:1/a.ts\n")
    with pytest.raises(ValueError, match=r"a\.mkv: not a Matroska recording, or damaged \(another format\)"):
        rp.open_sequence(path)
    write_recording(path, {"DEPTH": [(0, np.zeros((4, 6), np.uint16))]}, {})
    assert sequences.mkv(path, CAMERA)[0].depth.shape == (4, 6)
    write_recording(path, {"DEPTH": [(0, np.zeros((6000, 6000), np.uint16))]}, {})
    with pytest.raises(ValueError, match=r"a\.mkv: expected at most 33554432 pixels in a file, got 6000 x 6000"):
        sequences.mkv(path, CAMERA)


@pytest.mark.parametrize(
    "name", ["../secret.png", "/etc/secret.png", "depth/../../secret.png", "..\\a.png", "C:\\a.png"]
)
def test_a_list_names_no_files_outside_its_folder(tmp_path, name, capsys):
    frame = np.full((6, 8), 1000, np.uint16)
    root = tmp_path / "freiburg1"
    root.mkdir()
    images.write_png(tmp_path / "secret.png", frame)
    CAMERA.save(root / "camera.json")
    (root / "depth.txt").write_text(f"1.0 {name}\n")
    for opened in (rp.open_sequence, sequences.tum, sequences.folder):
        with pytest.raises(ValueError, match=r"depth\.txt, line 1: expected a file in the folder of the list, got "):
            opened(root)
        assert len(opened(root, allow_outside=True)) == 1
    if name == "../secret.png":
        assert np.array_equal(rp.open_sequence(root, allow_outside=True)[0].depth, frame)
        batch = ["batch", str(root), "--out", str(tmp_path / "planes"), "--tile", "3"]
        assert cli.main(batch) == 2
        assert "line 1: expected a file in the folder" in capsys.readouterr().err
        assert cli.main([*batch, "--allow-outside"]) == 0
    with pytest.raises(TypeError, match="expected allow_outside as True or False"):
        rp.open_sequence(root, allow_outside="yes")


HARM = "\x1b]0;title\x07\r\n\x9b2J\u202egnp"  # sets a title, breaks the line, clears the screen, turns the direction


def test_names_are_safe_to_print():
    assert shown("a\x1b[2J\n\u202e\udc80é \\x") == "a\\x1b[2J\\n\\u202e\\udc80é \\x"
    assert shown(Path("é b.png")) == "é b.png"
    with pytest.warns(UserWarning, match=r"^a\\x1b\[2Jb$"):
        warn_caller("a\x1b[2Jb")


@pytest.mark.skipif(os.name == "nt", reason="no such names there")
def test_no_name_commands_the_terminal(tmp_path, capsys, monkeypatch):
    """Whatever the command, and whether it goes well or not; nor do the library's own errors and summaries."""
    monkeypatch.chdir(tmp_path)
    good, bad, camera = f"{HARM}.png", f"bad{HARM}.png", f"camera{HARM}.json"
    images.write_png(good, np.full((6, 8), 1000, np.uint16))
    Path(bad).write_bytes(b"nonsense")
    CAMERA.save(camera)
    root = Path(f"set{HARM}")
    root.mkdir()
    CAMERA.save(root / "camera.json")
    (root / f"1{HARM}.png").write_bytes(b"nonsense")
    images.write_png(root / f"2{HARM}.png", np.full((6, 8), 1000, np.uint16))
    out, figure = f"out{HARM}.npz", f"out{HARM}.svg"
    commands = (
        ["fit", good, "--camera", camera, "--tile", "3", "--out", out, "--figure", figure],
        ["fit", bad, "--camera", camera],
        ["fit", f"missing{HARM}.png", "--camera", camera],
        ["fit", good, "--camera", bad],
        ["fit", good, "--camera", camera, "--out", f"nowhere{HARM}/a.npz"],
        ["normals", good, "--camera", camera, "--window", "3", "--out", out],
        ["batch", str(root), "--out", f"planes{HARM}"],
        ["batch", str(root), "--out", good],
        ["noise", bad, good, "--camera", camera],
        ["fit", good, HARM],
        [HARM],
    )
    for arguments in commands:
        with suppress(SystemExit):  # argparse's, of what is no argument
            cli.main(arguments)
        said = capsys.readouterr()
        for text in (said.out, said.err):
            assert all(c.isprintable() or c == "\n" for c in text), (arguments, text)
    sequence = rp.open_sequence(root)
    assert repr(sequence).isprintable()
    assert repr(sequence[1]).isprintable()
    for use in (
        lambda: images.read_depth(bad),
        lambda: sequence[0],
        lambda: rp.Camera.load(bad),
        lambda: rp.TilePlanes.load(bad),
        lambda: sequences.scannet_sens(bad),
        lambda: rp.open_sequence(HARM),
        lambda: rp.open_sequence(good),
        lambda: sequences.tum(root),
        lambda: files.existing_file(root),
    ):
        with pytest.raises((ValueError, OSError)) as error:
            use()
        assert str(error.value).isprintable(), use


def test_names_inside_files_are_safe_to_print(tmp_path):
    np.savez(tmp_path / "a.npz", **{HARM: np.zeros(3), "b": np.zeros(3)})
    with pytest.raises(ValueError, match="expected an NPZ file with one array") as error:
        images.read_depth(tmp_path / "a.npz")
    assert str(error.value).isprintable()
    about = np.array(json.dumps({"class": HARM, "camera": {HARM: 1}}))
    np.savez(tmp_path / "b.npz", about=about)
    with pytest.raises(ValueError, match=r"b\.npz: expected a file") as error:
        rp.TilePlanes.load(tmp_path / "b.npz")
    assert str(error.value).isprintable()
