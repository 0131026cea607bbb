"""Batches: the table is what fit_tiles gives, whatever is bad, interrupted, killed or shared."""

import errno
import functools
import io
import itertools
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
import warnings
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes._core import files
from rgbd_planes.batch import fit_sequence as batch
from rgbd_planes.batch import table
from rgbd_planes.batch.fingerprint import stamps
from rgbd_planes.batch.seal import is_sealed
from rgbd_planes.batch.table import Columns, empty_rows
from rgbd_planes.batch.worker import FitSettings, Part, fit_part
from rgbd_planes.camera import presets
from rgbd_planes.cli import main as cli
from rgbd_planes.evaluation import scenes
from rgbd_planes.sequences import FrameEntry, FrameSequence, images

parquet = pytest.importorskip("pyarrow.parquet")

CAMERA = rp.Camera(width=80, height=60, fx=65.0, fy=65.0, cx=39.5, cy=29.5, depth_scale=1000.0)


@pytest.fixture
def recording(tmp_path):
    """A folder of 30 frames with times."""
    root = tmp_path / "recording"
    (root / "depth").mkdir(parents=True)
    CAMERA.save(root / "camera.json")
    rendering = scenes.room().render(CAMERA)
    lines = []
    for i in range(30):
        images.write_png(root / "depth" / f"{i}.png", rendering.measure(holes=0.2, patches=0.2, seed=i))
        lines.append(f"{100 + i / 30:.6f} depth/{i}.png")
    (root / "depth.txt").write_text("\n".join(lines))
    return root


def rows_of(out):
    """The table in the order of frames and tiles."""
    table = parquet.read_table(out)
    columns = {name: table[name].to_numpy() for name in table.column_names}
    order = np.lexsort((columns["column"], columns["row"], columns["frame"]))
    return {name: values[order] for name, values in columns.items()}


def narrow(column):
    """Of floats the table has single precision."""
    return column.astype(np.float32) if column.dtype == np.float64 else column


def check_rows(out, sequence, bad=(), **options):
    """Whether the table has each row that fit_tiles gives, once."""
    rows = rows_of(out)
    expected = [rp.fit_tiles(sequence[i].depth, sequence[i].camera, **options) for i in good(sequence, bad)]
    tables = [tiles.to_table() for tiles in expected]
    for name in set(tables[0]) - {"angle_std", "offset_std"}:  # the covariances say those
        column = narrow(np.concatenate([table[name] for table in tables]))
        assert np.array_equal(rows[name], column, equal_nan=column.dtype.kind == "f"), name
    count = [len(table["row"]) for table in tables]
    assert np.array_equal(rows["frame"], np.repeat(good(sequence, bad), count))
    assert list(rows["name"]) == list(np.repeat([sequence.names[i] for i in good(sequence, bad)], count))
    times = np.repeat(sequence.timestamps[good(sequence, bad)], count)
    assert np.array_equal(rows["timestamp"], times, equal_nan=True)


def good(sequence, bad):
    return [i for i in range(len(sequence)) if i not in bad]


@pytest.mark.parametrize("threads", [1, 3])
def test_the_table_is_what_fit_tiles_gives(recording, tmp_path, threads):
    sequence = rp.open_sequence(recording)
    options = {"tile": (12, 16), "method": "standard_pca", "max_missing": 0.3, "max_error": 0.02}
    seen = []
    report = rp.fit_sequence(
        sequence, tmp_path / "out", FitSettings(**options), num_threads=threads, progress=seen.append
    )
    check_rows(tmp_path / "out", sequence, **options)
    statuses, counts = np.unique(rows_of(tmp_path / "out")["status"].astype(str), return_counts=True)
    assert dict(report.status) == dict(zip(statuses, counts, strict=True))
    assert len(statuses) == 3
    assert (report.frames, report.resumed, report.rows, report.problems) == (30, 0, 30 * 25, [])
    assert sum(done.frames for done in seen) == 30
    assert all(report.seconds[work] > 0 for work in ("read", "fit", "write"))


def test_pandas_reads_the_table(recording, tmp_path):
    pandas = pytest.importorskip("pandas")
    rp.fit_sequence(rp.open_sequence(recording), tmp_path / "out")
    frame = pandas.read_parquet(tmp_path / "out")
    assert len(frame) == 30 * 20
    assert frame.query("status == 'OK'").nx.notna().all()
    assert frame.query("status == 'TOO_FEW'").nx.isna().all()


def test_a_name_that_is_no_unicode_is_in_the_table(tmp_path):
    """As a file has it that comes from a system of another encoding."""
    root = tmp_path / "recording"
    root.mkdir()
    depth = scenes.room().render(CAMERA).measure(seed=1)
    images.write_png(root / "1.png", depth)
    try:
        images.write_png(root / os.fsdecode(b"2 T\xfcr.png"), depth)
    except (OSError, UnicodeError):
        pytest.skip("no such names on this file system")
    report = rp.fit_sequence(rp.open_sequence(root, CAMERA), tmp_path / "out")
    assert report.problems == []
    assert set(rows_of(tmp_path / "out")["name"]) == {"1.png", r"2 T\udcfcr.png"}
    assert rp.fit_sequence(rp.open_sequence(root, CAMERA), tmp_path / "out").resumed == 2
    out = tmp_path / os.fsdecode(b"T\xfcr")
    assert cli.main(["batch", str(root), "--camera", str(_saved_camera(tmp_path)), "--out", str(out)]) == 0
    with open(out / "part-000000.parquet", "rb") as file:
        assert parquet.read_table(file).num_rows > 0
    assert rp.fit_sequence(rp.open_sequence(root, CAMERA), out).resumed == 2


def _saved_camera(folder):
    CAMERA.save(folder / "camera.json")
    return folder / "camera.json"


def test_a_disk_that_is_taken_away_is_no_fault_of_its_frames(recording, tmp_path):
    """Otherwise they would be left out for good."""
    sequence, away = rp.open_sequence(recording), recording.with_name("away")

    def take_away(done):
        if recording.exists():
            recording.rename(away)

    with pytest.raises(FileNotFoundError, match=r"\d+\.png: there is no such file"):
        rp.fit_sequence(sequence, tmp_path / "out", num_threads=1, progress=take_away)
    assert not recording.exists()
    away.rename(recording)
    assert rp.fit_sequence(sequence, tmp_path / "out").problems == []
    check_rows(tmp_path / "out", sequence)


def test_a_time_that_is_not_known_is_null(recording, tmp_path):
    (recording / "depth.txt").unlink()
    rp.fit_sequence(rp.open_sequence(recording), tmp_path / "out")
    times = parquet.read_table(tmp_path / "out")["timestamp"]
    assert times.null_count == len(times) > 0


def test_some_times_may_be_known_and_others_not(recording, tmp_path):
    plain = rp.open_sequence(recording)
    known = [e if e.location.stem > "2" else FrameEntry(e.name, np.nan, e.camera, e.location) for e in plain.entries]
    sequence = FrameSequence(known, images.read_depth)
    rp.fit_sequence(sequence, tmp_path / "out", num_threads=1)
    check_rows(tmp_path / "out", sequence)
    rows = rows_of(tmp_path / "out")
    assert 0 < np.isnan(rows["timestamp"]).sum() < len(rows["timestamp"])
    times = parquet.read_table(tmp_path / "out")["timestamp"]
    assert times.null_count == np.isnan(rows["timestamp"]).sum()


def test_each_frame_may_have_its_own_camera(recording, tmp_path):
    other = rp.Camera(width=80, height=60, fx=60.0, fy=65.0, cx=39.5, cy=29.5, depth_scale=900.0)
    sequence = rp.open_sequence(recording)
    entries = [
        FrameEntry(e.name, e.timestamp, [CAMERA, other][i % 2], e.location) for i, e in enumerate(sequence.entries)
    ]
    mixed = FrameSequence(entries, images.read_depth)
    rp.fit_sequence(mixed, tmp_path / "out")
    check_rows(tmp_path / "out", mixed)


def test_frames_of_several_sizes_are_one_table(recording, tmp_path):
    """Tiles at the lower and right border are cut where each frame ends."""
    sequence = rp.open_sequence(recording)
    entries = [
        FrameEntry(e.name, e.timestamp, replace(CAMERA, width=80 - 9 * (i % 3), height=60 - 7 * (i % 2)), e.location)
        for i, e in enumerate(sequence.entries)
    ]
    cameras = {entry.location: entry.camera for entry in entries}

    def read(location):
        height, width = cameras[location].shape
        return images.read_depth(location)[:height, :width]

    mixed = FrameSequence(entries, read)
    report = rp.fit_sequence(mixed, tmp_path / "out", num_threads=1)
    assert report.problems == []
    check_rows(tmp_path / "out", mixed)


def test_a_camera_that_cannot_be_used_is_a_problem_of_each_of_its_frames(recording, tmp_path):
    bad = 1, 2
    folded = replace(CAMERA, depth_scale=5000.0, distortion=(-5.0, 0.0, 0.0, 0.0, 0.0))
    sequence = rp.open_sequence(recording)[:4]
    entries = [replace(e, camera=folded if i in bad else CAMERA) for i, e in enumerate(sequence.entries)]
    mixed = FrameSequence(entries, images.read_depth)
    report = rp.fit_sequence(mixed, tmp_path / "out")
    assert [problem.frame for problem in report.problems] == list(bad)
    assert len({problem.reason for problem in report.problems}) == 1
    check_rows(tmp_path / "out", mixed, bad=bad)


def test_a_noise_model_adds_covariances_and_p_values(recording, tmp_path):
    plain = rp.open_sequence(recording)
    sequence = plain.with_noise(rp.noise.kinect_v1())
    rp.fit_sequence(sequence, tmp_path / "out", FitSettings(significance=0.01))
    rows = rows_of(tmp_path / "out")
    tiles = [rp.fit_tiles(f.depth, f.camera, significance=0.01) for f in sequence]
    assert {"OK", "ROUGH"} <= set(rows["status"])
    check_rows(tmp_path / "out", sequence, significance=0.01)
    expected = np.concatenate([t.plane_covariance.reshape(-1, 4, 4) for t in tiles])
    for i, a in enumerate(("nx", "ny", "nz", "d")):
        for j, b in enumerate(("nx", "ny", "nz", "d")[i:], start=i):
            assert np.array_equal(rows[f"cov_{a}_{b}"], narrow(expected[:, i, j]), equal_nan=True)
    p_values = narrow(np.concatenate([t.p_value.ravel() for t in tiles]))
    assert np.array_equal(rows["p_value"], p_values, equal_nan=True)
    mixed = FrameSequence([plain.entries[0], sequence.entries[1]], images.read_depth)
    with pytest.raises(ValueError, match="noise model in all cameras or in none"):
        rp.fit_sequence(mixed, tmp_path / "mixed")
    arguments = ["batch", str(recording), "--out", str(tmp_path / "c"), "--noise", "kinect_v1"]
    assert cli.main(arguments) == 0
    assert "cov_d_d" in rows_of(tmp_path / "c")


def test_one_row_a_segment(recording, tmp_path):
    pytest.importorskip("pandas")
    sequence = rp.open_sequence(recording)[:6]
    (recording / "depth" / "2.png").write_bytes(b"")
    report = rp.fit_sequence(sequence, tmp_path / "out", FitSettings(segments=True), num_threads=2)
    table = parquet.read_table(tmp_path / "out").to_pandas()
    assert report.rows == len(table) > 10
    for i in good(sequence, (2,)):
        rows = table[table.frame == i]
        expected = rp.segment(sequence[i].depth, CAMERA)
        assert list(rows.label) == list(range(1, len(expected) + 1))
        assert np.array_equal(rows[["nx", "ny", "nz", "d"]], narrow(expected.planes))
        assert np.array_equal(rows.valid_count, expected.sizes)
        assert np.array_equal(rows.rmse, narrow(expected.rmse))
        assert np.array_equal(rows.rmse_metric, narrow(expected.rmse_metric))
        for (i, a), (j, b) in itertools.combinations_with_replacement(enumerate(("nx", "ny", "nz", "d")), 2):
            assert np.array_equal(rows[f"cov_{a}_{b}"], narrow(expected.plane_covariance[:, i, j]))
        assert set(rows.status) == {"OK"}
        for row in rows.itertuples():
            y, x = np.nonzero(expected.labels == row.label)
            assert (row.top, row.left) == (y.min(), x.min())
            assert (row.height, row.width) == (np.ptp(y) + 1, np.ptp(x) + 1)
    assert [problem.frame for problem in report.problems] == [2]
    arguments = ["batch", str(recording), "--out", str(tmp_path / "c"), "--segments", "--min-size", "300"]
    assert cli.main(arguments) == 1
    large = parquet.read_table(tmp_path / "c").to_pandas()
    expected = rp.segment(sequence[0].depth, CAMERA, min_size=300)
    assert 0 < len(expected) < (table.frame == 0).sum()
    assert np.array_equal(large.valid_count[large.frame == 0], expected.sizes)


def test_bad_frames_are_skipped_and_reported(recording, tmp_path):
    images.write_png(recording / "depth" / "0.png", np.ones((60, 81), np.uint16))
    (recording / "depth" / "7.png").write_bytes((recording / "depth" / "7.png").read_bytes()[:200])
    (recording / "depth" / "29.png").unlink()
    sequence = rp.open_sequence(recording)
    report = rp.fit_sequence(sequence, tmp_path / "out")
    assert [(p.frame, p.name) for p in report.problems] == [
        (0, "depth/0.png"), (7, "depth/7.png"), (29, "depth/29.png"),
    ]  # fmt: skip
    for problem, words in zip(report.problems, ("(60, 80)", "truncated PNG", "no such file"), strict=True):
        assert words in problem.reason
        assert str(recording) not in problem.reason  # the name says which
    check_rows(tmp_path / "out", sequence, bad=(0, 7, 29))
    assert repr(report).startswith(
        f"<BatchReport: 27 of 30 frames, {report.rows} rows in {tmp_path / 'out'}; skipped f"
    )
    # An interrupted table has them, too.
    again = rp.fit_sequence(sequence, tmp_path / "out")
    assert (again.problems, again.rows, again.resumed) == (report.problems, report.rows, 30)
    (tmp_path / "out" / "part-000000.parquet").unlink()
    again = rp.fit_sequence(sequence, tmp_path / "out")
    assert (again.problems, again.rows) == (report.problems, report.rows)
    assert 0 < again.resumed < 30


def test_integers_without_a_unit_are_refused_before_a_table_is_begun(recording, tmp_path, capsys):
    replace(CAMERA, depth_scale=None).save(recording / "camera.json")
    assert cli.main(["batch", str(recording), "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.startswith("rgbd-planes batch: depth/0.png: expected a camera with --depth-scale")
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    (recording / "depth" / "0.png").write_bytes(b"")  # a damaged one does not tell
    assert len(rp.fit_sequence(rp.open_sequence(recording), tmp_path / "out").problems) == 30


def test_a_frame_that_may_not_be_read_is_said_in_words(recording, tmp_path):
    def read(path):
        raise PermissionError(13, "Permission denied", str(path))

    sequence = FrameSequence(rp.open_sequence(recording).entries[:1], read)
    (problem,) = rp.fit_sequence(sequence, tmp_path / "out").problems
    assert problem.reason == "Permission denied"


def test_too_many_open_files_are_no_fault_of_a_frame(recording, tmp_path, monkeypatch, capsys):
    """Neither where the reader says so, nor where it says that the file is damaged."""
    from PIL import Image

    out = tmp_path / "out"
    refused = OSError(errno.EMFILE, os.strerror(errno.EMFILE), "7.png")
    read, opened = images.read_depth, Image.open

    def fail(path, *arguments, **options):
        if path.name == "7.png":
            raise refused
        return (read if not options else opened)(path, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Image, "open", fail)
        assert cli.main(["batch", str(recording), "--out", str(out)]) == 2
    assert capsys.readouterr().err == "rgbd-planes batch: 7.png: Too many open files\n"
    sequence = rp.open_sequence(recording)
    with pytest.raises(OSError, match="Too many open files"):
        rp.fit_sequence(FrameSequence(sequence.entries, fail), tmp_path / "other")
    assert rp.fit_sequence(sequence, out).problems == []
    check_rows(out, sequence)


@pytest.mark.parametrize("most", [0, 1, 2])
def test_where_no_more_threads_can_be_started_those_that_there_are_do_it(recording, tmp_path, monkeypatch, most):
    started, start = [], threading.Thread.start

    def start_some(thread):
        if len(started) == most:
            raise RuntimeError("can't start new thread")
        started.append(thread)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", start_some)
    rp.fit_sequence(rp.open_sequence(recording), tmp_path / "out", num_threads=3)
    assert len(started) == most
    assert not any(thread.is_alive() for thread in started)
    monkeypatch.undo()
    check_rows(tmp_path / "out", rp.open_sequence(recording))


def test_nothing_goes_on_once_the_caller_has_an_error(recording, tmp_path):
    """Not even while that error, and with it the call, is still looked at."""
    before, out = set(threading.enumerate()), tmp_path / "out"

    def interrupt(done):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rp.fit_sequence(rp.open_sequence(recording), out, num_threads=2, progress=interrupt)
    assert set(threading.enumerate()) <= before
    parts = len(list(out.glob("part-*")))
    rp.fit_sequence(rp.open_sequence(recording), out, num_threads=2)
    assert parts < len(list(out.glob("part-*")))
    check_rows(out, rp.open_sequence(recording))


def replace_unseen(file, content):
    """Write as many other bytes into a file, which keeps its time."""
    times = file.stat().st_atime_ns, file.stat().st_mtime_ns
    file.write_bytes(content)
    os.utime(file, ns=times)


def test_frames_that_were_skipped_are_tried_again_where_asked_for(recording, tmp_path):
    sequence, out = rp.open_sequence(recording), tmp_path / "out"
    bad = [recording / "depth" / f"{i}.png" for i in (3, 20)]
    contents = [file.read_bytes() for file in bad]
    for file, content in zip(bad, contents, strict=True):
        replace_unseen(file, bytes(len(content)))
    assert len(rp.fit_sequence(sequence, out, num_threads=1).problems) == 2
    replace_unseen(bad[0], contents[0])
    assert len(rp.fit_sequence(sequence, out).problems) == 2
    check_rows(out, sequence, bad=(3, 20))
    parts = {file: file.stat().st_mtime_ns for file in out.iterdir()}
    report = rp.fit_sequence(sequence, out, retry=True)
    assert ([problem.frame for problem in report.problems], report.resumed) == ([20], 18)
    check_rows(out, sequence, bad=(20,))
    rewritten = {file.name for file in parts if file.stat().st_mtime_ns != parts[file]}
    assert rewritten == {"part-000000.parquet", "part-000003.parquet"}


@pytest.mark.skipif(sys.platform == "win32", reason="there nobody is kept out")
def test_a_folder_that_another_call_writes_into_is_refused(recording, tmp_path):
    sequence, out = rp.open_sequence(recording), tmp_path / "out"
    with files.alone_in(out):
        (out / ".part-000000.123-456.parquet").write_bytes(b"what it writes just now")
        with pytest.raises(BlockingIOError, match=r"out: another call is writing there"):
            rp.fit_sequence(sequence, out)
        assert [file.name for file in out.iterdir()] == [".part-000000.123-456.parquet"]
    next(out.iterdir()).unlink()
    rp.fit_sequence(sequence, out)
    check_rows(out, sequence)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_child_keeps_nobody_out(tmp_path):
    """It has the folder open, too, for as long as it lives."""
    code = (
        "import os, sys, time\n"
        "from pathlib import Path\n"
        "from rgbd_planes._core.files import alone_in\n"
        "folder = Path(sys.argv[1])\n"
        "with alone_in(folder):\n"
        "    child = os.fork()\n"
        "    if child == 0:\n"
        "        time.sleep(60)\n"
        "        os._exit(0)\n"
        "try:\n"
        "    with alone_in(folder):\n"
        "        print('entered')\n"
        "finally:\n"
        "    os.kill(child, 9)\n"
    )
    ran = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    assert (ran.stdout, ran.stderr) == ("entered\n", "")


def test_a_table_of_bad_frames_alone_has_its_columns(recording, tmp_path, capsys):
    sequence = rp.open_sequence(recording)
    rp.fit_sequence(sequence, tmp_path / "good")
    for file in (recording / "depth").iterdir():
        file.write_bytes(b"")
    report = rp.fit_sequence(sequence, tmp_path / "bad")
    assert len(report.problems) == 30
    said = "skipped 30 frames, 0 to 29: not a PNG image, or damaged"
    assert repr(report) == f"<BatchReport: 0 of 30 frames, 0 rows in {tmp_path / 'bad'}; {said}>"
    assert cli.main(["batch", str(recording), "--out", str(tmp_path / "again")]) == 1
    assert "0 of 30 frames, 0 rows.\n" in capsys.readouterr().out
    good_table, bad_table = (parquet.read_table(tmp_path / name) for name in ("good", "bad"))
    assert bad_table.num_rows == 0
    assert bad_table.schema.equals(good_table.schema)


def test_what_is_missing_is_done_and_what_is_there_is_left(recording, tmp_path):
    sequence, out = rp.open_sequence(recording), tmp_path / "out"
    rp.fit_sequence(sequence, out, num_threads=1)
    parts = sorted(out.glob("part-*.parquet"))
    assert len(parts) == 5  # of 6 frames each
    contents = [part.read_bytes() for part in parts]
    kept = {part: part.stat().st_mtime_ns for part in parts[2:4]}
    parts[0].unlink()
    parts[1].write_bytes(contents[1][:-100])  # a machine that lost power
    parts[4].write_bytes(b"")
    (out / ".part-000000.123-456.parquet").write_bytes(b"half")
    # With another number of threads, and the tile said in another way, the parts stay what they were.
    report = rp.fit_sequence(sequence, out, FitSettings(tile=(16, 16)), num_threads=3)
    assert report.resumed == 12
    assert [part.read_bytes() for part in parts] == contents
    assert {part: part.stat().st_mtime_ns for part in kept} == kept
    assert sorted(path.name for path in out.iterdir()) == ["_about.parquet", *(part.name for part in parts)]


def test_a_part_with_a_flipped_bit_is_done_again(recording, tmp_path):
    """Each single bit of the file counts, of its rows, its footer and the digest in it."""
    sequence = rp.open_sequence(recording)[:4]
    out = tmp_path / "planes"
    rp.fit_sequence(sequence, out)
    file = out / "part-000000.parquet"
    written = file.read_bytes()
    assert Part.read(file) is not None
    rng = np.random.default_rng(3)
    for bit in [*rng.integers(8 * len(written), size=200), 0, 8 * len(written) - 1]:
        damaged = bytearray(written)
        damaged[bit // 8] ^= 1 << (bit % 8)
        file.write_bytes(damaged)
        assert Part.read(file) is None, bit
    report = rp.fit_sequence(sequence, out)
    assert 0 < report.resumed < 4
    assert file.read_bytes() == written
    for length in (0, 7, 8, len(written) // 2, len(written) - 1):
        file.write_bytes(written[:length])
        assert Part.read(file) is None, length
    file.write_bytes(written + b"x")
    assert Part.read(file) is None


def test_a_pipe_in_place_of_a_part_is_not_waited_for(recording, tmp_path):
    sequence = rp.open_sequence(recording)[:4]
    out = tmp_path / "planes"
    rp.fit_sequence(sequence, out, num_threads=1)
    (out / "part-000000.parquet").unlink()
    os.mkfifo(out / "part-000000.parquet")
    assert Part.read(out / "part-000000.parquet") is None


def test_what_a_worker_sends_is_sealed_too(recording):
    sequence = rp.open_sequence(recording)[:4]
    part = fit_part(sequence, 0, FitSettings(), Columns(False, False, True))
    assert is_sealed(io.BytesIO(part.content))
    assert not is_sealed(io.BytesIO(part.content.replace(b"depth/1", b"depth/2")))


@pytest.mark.parametrize(
    ("given", "plain"),
    [
        ({"tile": np.int64(8)}, {"tile": 8}),
        ({"tile": np.uint8(20)}, {"tile": 20}),
        ({"tile": [12, 16]}, {"tile": (12, 16)}),
        ({"tile": np.array([12, 16])}, {"tile": (12, np.int16(16))}),
        ({"max_error": np.float32(0.5), "max_missing": np.float16(0.5)}, {"max_error": 0.5}),
        ({"max_error": Fraction(1, 50), "max_missing": 1}, {"max_error": 0.02, "max_missing": np.array(1.0)}),
        ({"significance": np.float32(0.25), "segments": np.False_}, {"significance": 0.25}),
    ],
)
def test_settings_take_the_numbers_that_fit_tiles_takes(recording, tmp_path, given, plain):
    sequence = rp.open_sequence(recording)[:3].with_noise(rp.noise.kinect_v1())
    assert FitSettings(**given) == FitSettings(**plain)
    rp.fit_sequence(sequence, tmp_path / "out", FitSettings(**given))
    assert rp.fit_sequence(sequence, tmp_path / "out", FitSettings(**plain)).resumed == 3
    given.pop("segments", None)
    check_rows(tmp_path / "out", sequence, **given)


def test_another_table_is_not_mixed_in(recording, tmp_path):
    sequence, out = rp.open_sequence(recording), tmp_path / "out"
    rp.fit_sequence(sequence, out)
    camera = rp.Camera(**{**CAMERA.to_dict(), "depth_scale": 999.0})
    for other, settings, word in (
        (sequence, FitSettings(tile=20), "settings"),
        (sequence[:29], None, "frames, sequence, locations, cameras"),
        (sequence[::-1], None, "sequence, locations"),
        (rp.open_sequence(recording, camera), None, "cameras"),
    ):
        with pytest.raises(ValueError, match=rf"another sequence, camera, settings or version \({word} differ\)"):
            rp.fit_sequence(other, out, settings)
    check_rows(out, sequence)
    (out / ".hidden").touch()
    for stranger in ("part-999999.parquet", "planes.txt"):
        shutil.copy(next(out.glob("part-*")), out / stranger)
        with pytest.raises(ValueError, match=f"{stranger}: not part of this table"):
            rp.fit_sequence(sequence, out)
        (out / stranger).unlink()
    rp.fit_sequence(sequence, out)
    about = json.loads(table.read_about(out / "_about.parquet"))
    columns = table.Columns(False, False, False)
    for damaged in ({}, [], *({**about, "frames_per_part": size} for size in (0, None, 2.5, True, np.inf))):
        table.write_about(out / "_about.parquet", columns, json.dumps(damaged))
        with pytest.raises(ValueError, match="damaged; remove"):
            rp.fit_sequence(sequence, out)
    table.write_about(out / "_about.parquet", columns, "[" * 100_000)
    with pytest.raises(ValueError, match="damaged; remove"):
        rp.fit_sequence(sequence, out)
    (out / "_about.parquet").write_bytes(b"PAR1")
    with pytest.raises(ValueError, match="damaged; remove"):
        rp.fit_sequence(sequence, out)
    (out / "_about.parquet").unlink()
    with pytest.raises(ValueError, match="expected an empty folder"):
        rp.fit_sequence(sequence, out)


def test_frames_whose_files_have_changed_are_fitted_again(recording, tmp_path):
    sequence, out = rp.open_sequence(recording), tmp_path / "out"
    (recording / "depth" / "20.png").write_bytes(b"nonsense")
    assert [problem.frame for problem in rp.fit_sequence(sequence, out, num_threads=1).problems] == [20]
    rendering = scenes.room().render(CAMERA)
    for name, seed in (("3.png", 99), ("20.png", 77)):  # the second mends what was skipped
        images.write_png(recording / "depth" / name, rendering.measure(holes=0.1, seed=seed))
        report = rp.fit_sequence(sequence, out, num_threads=1)
        assert 15 < report.resumed < 30
        assert [problem.frame for problem in report.problems] == ([20] if name == "3.png" else [])
    check_rows(out, sequence)


def test_a_file_that_was_written_again_has_another_stamp(tmp_path):
    """Also of the same size. Folders and what is not there have none."""
    path = tmp_path / "frame"
    path.write_bytes(b"one")
    first = stamps(path)
    assert stamps((path, 3, tmp_path, tmp_path / "none")) == first != ""
    path.write_bytes(b"two")
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 1_000_000))
    assert stamps(path) != first
    stamp = path.stat()
    earlier = stamps(path)
    path.write_bytes(b"three")  # a copy that kept its time
    os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert stamps(path) != earlier


def test_rows_are_used_again_for_the_same_columns_only():
    columns = Columns(segments=False, noise=True, timed=True)
    rows = empty_rows(columns, 10)
    assert empty_rows(columns, 20) is rows
    for other in ({"segments": True}, {"noise": False}, {"timed": False}):
        assert empty_rows(columns._replace(**other), 10) is not rows


def test_a_table_of_another_version_is_not_resumed(recording, tmp_path, monkeypatch):
    sequence = rp.open_sequence(recording)[:3]
    rp.fit_sequence(sequence, tmp_path / "out")
    monkeypatch.setattr(batch, "__version__", "0.1.0")
    with pytest.raises(ValueError, match=r"or version \(version differ\)"):
        rp.fit_sequence(sequence, tmp_path / "out")


def test_another_recording_of_the_same_names_is_another_table(tmp_path, monkeypatch, link):
    depth = scenes.room().render(presets.seven_scenes()).measure(seed=1)
    for name in ("seq-01", "seq-02"):
        (tmp_path / name).mkdir()
        images.write_png(tmp_path / name / "frame-000000.depth.png", depth)
    first, second = (rp.open_sequence(tmp_path / name) for name in ("seq-01", "seq-02"))
    rp.fit_sequence(first, tmp_path / "out")
    with pytest.raises(ValueError, match=r"another sequence, camera, settings or version \(locations differ\)"):
        rp.fit_sequence(second, tmp_path / "out")
    # The same folder from elsewhere, or over a link, is the same.
    monkeypatch.chdir(tmp_path)
    link(tmp_path / "link", "seq-01")
    for path in ("seq-01", "seq-02/../seq-01", "link"):
        assert rp.fit_sequence(rp.open_sequence(path), "out").resumed == 1
    shutil.move("seq-01", "moved")
    with pytest.raises(ValueError, match="locations differ"):
        rp.fit_sequence(rp.open_sequence("moved"), "out")


def test_the_same_places_are_the_same_whether_or_not_they_are_one_object(tmp_path):
    """As in a process that lists the frames one by one, and in one that was handed the list."""
    shared, own = ("".join(("a", "b")) for _ in range(2))  # made, since literals would be one
    assert shared is not own
    for i, pair in enumerate(([shared, shared], [shared, own])):
        entries = [FrameEntry(str(j), np.nan, CAMERA, (place, j)) for j, place in enumerate(pair)]
        sequence = FrameSequence(entries, one_frame)
        assert rp.fit_sequence(sequence, tmp_path / "table").resumed == 2 * i


def test_locations_of_any_kind_tell_recordings_apart(tmp_path, link):
    """The file may be in a tuple, or the function's own; a location may be the frame itself."""
    frames = np.full((2, 60, 80), 1000, np.uint16)
    frames[1, 30, 40] = 1001

    def sequence(location, read):
        return FrameSequence([FrameEntry("0", np.nan, CAMERA, location)], read)

    pairs = {
        "tuple": [sequence((tmp_path / name, 0), one_frame) for name in "ab"],
        "function": [sequence(0, functools.partial(one_frame, name)) for name in "ab"],
        "array": [sequence(frame, np.asarray) for frame in frames],
    }
    for name, (one, other) in pairs.items():
        rp.fit_sequence(one, tmp_path / name)
        assert rp.fit_sequence(pickle.loads(pickle.dumps(one)), tmp_path / name).resumed == 1
        with pytest.raises(ValueError, match=r"\(locations differ\)"):
            rp.fit_sequence(other, tmp_path / name)
    latest = tmp_path / "latest"
    link(latest, "a")
    rp.fit_sequence(sequence((latest, 0), one_frame), tmp_path / "linked")
    latest.unlink()
    link(latest, "b")
    with pytest.raises(ValueError, match=r"\(locations differ\)"):
        rp.fit_sequence(sequence((latest, 0), one_frame), tmp_path / "linked")
    unknown = sequence(0, lambda _: frames[0])
    rp.fit_sequence(unknown, tmp_path / "unknown")
    with pytest.raises(ValueError, match="where they are, cannot be pickled; remove it"):
        rp.fit_sequence(unknown, tmp_path / "unknown")


def one_frame(*_):
    return np.full((60, 80), 1000, np.uint16)


def test_another_camera_is_another_table(recording, tmp_path):
    plain, out = rp.open_sequence(recording)[:3], tmp_path / "out"

    def with_cameras(*cameras):
        entries = [replace(e, camera=c) for e, c in zip(plain.entries, cameras, strict=True)]
        return FrameSequence(entries, images.read_depth)

    # All that a camera shows of its noise is two digits.
    noises = [rp.noise.axial(quadratic=factor * 1e-3) for factor in (1.0, 1.0001)]
    one, other = (replace(CAMERA, noise=noise) for noise in noises)
    assert repr(one) == repr(other)
    rp.fit_sequence(with_cameras(one, other, one), out)
    assert rp.fit_sequence(with_cameras(replace(one), other, one), out).resumed == 3
    for cameras in ((one, one, one), (one, other, other)):
        with pytest.raises(ValueError, match=r"\(cameras differ\)"):
            rp.fit_sequence(with_cameras(*cameras), out)


@pytest.mark.parametrize(
    "other",
    [
        {"segments": True},
        {"tile": (16, 17)},
        {"method": "standard_pca"},
        {"max_missing": 0.4},
        {"max_error": 0.02},
        {"significance": 0.02},
    ],
    ids=lambda other: next(iter(other)),
)
def test_any_other_setting_is_another_table(recording, tmp_path, other):
    sequence = rp.open_sequence(recording)[:2].with_noise(rp.noise.kinect_v1())
    rp.fit_sequence(sequence, tmp_path / "out")
    with pytest.raises(ValueError, match=r"\(settings differ\)"):
        rp.fit_sequence(sequence, tmp_path / "out", FitSettings(**other))


def test_segments_of_another_least_size_are_another_table(recording, tmp_path):
    sequence = rp.open_sequence(recording)[:1]
    rp.fit_sequence(sequence, tmp_path / "out", FitSettings(segments=True))
    with pytest.raises(ValueError, match=r"\(settings differ\)"):
        rp.fit_sequence(sequence, tmp_path / "out", FitSettings(segments=True, min_size=200))


@pytest.mark.parametrize("other", [{"name": "b"}, {"timestamp": 2.0}], ids=lambda other: next(iter(other)))
def test_frames_of_other_names_or_times_are_another_table(tmp_path, other):
    entry = FrameEntry("a", 1.0, CAMERA, 0)
    rp.fit_sequence(FrameSequence([entry], one_frame), tmp_path / "out")
    with pytest.raises(ValueError, match=r"\(sequence differ\)"):
        rp.fit_sequence(FrameSequence([replace(entry, **other)], one_frame), tmp_path / "out")


def test_a_noise_in_other_units_draws_a_warning(recording, tmp_path):
    sequence = rp.open_sequence(recording)[:2].with_noise(rp.noise.NoiseModel((1.0,)))
    for out in ("out", "again"):  # with the same fitter
        with pytest.warns(UserWarning, match="most likely it is not in 1/m, .* nothing is ROUGH") as warned:
            rp.fit_sequence(sequence, tmp_path / out)
        assert len(warned) == 1


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"tile": 1}, ValueError, "tile must be at least 2 x 2 pixels, got 1"),
        ({"tile": 1.5}, TypeError, "tile must be a whole number of pixels or .height, width., got 1.5"),
        ({"tile": "16"}, TypeError, "tile must be a whole number"),
        ({"tile": [[8, 8]]}, TypeError, "tile must be a whole number"),
        ({"tile": [[8], 8]}, TypeError, "tile must be a whole number"),
        ({"tile": np.array([8.0, 8.0])}, TypeError, "tile must be a whole number"),
        ({"tile": None}, TypeError, "tile must be a whole number"),
        ({"method": "magic"}, ValueError, "method must be"),
        ({"max_missing": 2.0}, ValueError, "max_missing must be between 0 and 1"),
        ({"max_error": -1.0}, ValueError, "max_error must be a positive length"),
        ({"max_error": "1 cm"}, TypeError, "expected max_error as a number, got '1 cm'"),
        ({"significance": 2.0}, ValueError, "significance must be at least 0 and below 1, got 2.0"),
    ],
)
def test_settings_for_no_camera_are_refused_when_they_are_made(options, error, message):
    with pytest.raises(error, match=message):
        FitSettings(**options)


def test_a_noise_that_is_a_function_is_not_resumed(recording, tmp_path):
    sequence = rp.open_sequence(recording)[:2].with_noise(rp.noise.function(lambda q: 1e-3 + 0.0 * q))
    assert rp.fit_sequence(sequence, tmp_path / "out").rows == 40
    with pytest.raises(ValueError, match=r"the noise model is a function, not numbers: .* remove it"):
        rp.fit_sequence(sequence, tmp_path / "out")


def test_arguments_that_cannot_be_used_are_refused(recording, tmp_path):
    sequence, out = rp.open_sequence(recording), tmp_path / "out"
    with pytest.raises(ValueError, match="tile must fit into the frame"):
        rp.fit_sequence(sequence, out, FitSettings(tile=10_000))
    with pytest.raises(ValueError, match="num_threads must be at least 1"):
        rp.fit_sequence(sequence, out, num_threads=0)
    with pytest.raises(TypeError, match="expected a FrameSequence, which open_sequence makes, got list"):
        rp.fit_sequence([sequence[0].depth], out)
    with pytest.raises(ValueError, match="expected a sequence with frames"):
        rp.fit_sequence(sequence[:0], out)
    assert not out.exists()
    out.write_text("mine")
    with pytest.raises(NotADirectoryError, match="expected a folder for the table, got a file; choose another"):
        rp.fit_sequence(sequence, out)
    assert out.read_text() == "mine"
    with pytest.raises(ValueError, match=r"expected the name of a folder for the table, got one that ends in \.csv"):
        rp.fit_sequence(sequence, tmp_path / "planes.csv")
    assert not (tmp_path / "planes.csv").exists()


@pytest.mark.parametrize("name", ["pyarrow", "pyarrow.parquet"])
def test_without_pyarrow_the_extra_is_named(recording, tmp_path, monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "rgbd-planes\[batch\]"'):
        rp.fit_sequence(rp.open_sequence(recording), tmp_path / "out")
    with pytest.raises(ModuleNotFoundError, match=r'pip install "rgbd-planes\[dask\]"'):  # which has both
        rp.fit_sequence(rp.open_sequence(recording), tmp_path / "out", scheduler="tcp://127.0.0.1:9")


def many(path):
    """A frame that exists without a file, and whose rows cannot be compressed."""
    return np.random.default_rng(path).integers(900, 1100, (60, 80)).astype(np.uint16)


def test_memory_does_not_grow_with_the_sequence(tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "MOST_ROWS", 30_000)  # 100 frames

    def peak(frames):
        sequence = FrameSequence((FrameEntry(str(i), i, CAMERA, i) for i in range(frames)), many)
        tracemalloc.start()
        rp.fit_sequence(sequence, tmp_path / str(frames), FitSettings(tile=4), num_threads=2)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    peak(810)  # what is made once
    # 800 frames' rows are 15 MB. How many parts are there at a time depends on the threads.
    assert peak(3200) < peak(800) + 5e6


@pytest.mark.parametrize(("segments", "most"), [(False, 512), (True, 64)])
def test_an_interruption_loses_small_parts(segments, most):
    sizes = [batch._frames_of_part(n, FitSettings(segments), CAMERA, 2) for n in (1, 7, 100, 1000, 100_000)]
    assert sizes == sorted(sizes)
    assert sizes[0] == 1
    assert 0.9 * most < sizes[-1] <= most


def test_progress_shows_before_the_first_part_is_done(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "PROGRESS_SECONDS", 0.01)
    monkeypatch.setattr(batch, "_frames_of_part", lambda *whatever: 30)
    went_on = threading.Event()

    def read(path):
        if path.stem == "20":
            assert went_on.wait(60)
        return images.read_depth(path)

    seen = []

    def progress(done):
        assert not list((tmp_path / "out").glob("part-*")) or went_on.is_set()
        seen.append(done.frames)
        if sum(seen) == 20:
            went_on.set()

    sequence = FrameSequence(rp.open_sequence(recording).entries, read)
    rp.fit_sequence(sequence, tmp_path / "out", num_threads=1, progress=progress)
    assert sum(seen) == 30
    check_rows(tmp_path / "out", rp.open_sequence(recording))


# After three parts nothing more is done until the process is told to stop.
SLOW = """
import signal, sys, time
from rgbd_planes.cli import main as cli
from rgbd_planes.batch import worker as batch_parts, fit_sequence as batch_sequence
# Where the tests run in the background of a shell, SIGINT is ignored, and so it would be here.
signal.signal(signal.SIGINT, signal.default_int_handler)
fit_part = batch_parts.fit_part
parts = []
def slowly(sequence, first, settings, columns, where, stopped, fitted):
    while len(parts) == 3 and not stopped():
        time.sleep(0.01)
    parts.append(first)
    return fit_part(sequence, first, settings, columns, where, stopped, fitted)
batch_sequence.fit_part = slowly
sys.exit(cli.main(sys.argv[1:]))
"""


ONLY_POSIX = pytest.mark.skipif(os.name != "posix", reason="this system sends no signals to one process")


@pytest.mark.parametrize("how", ["killed", pytest.param("interrupted", marks=ONLY_POSIX)])
def test_a_process_that_is_stopped_is_resumed(recording, tmp_path, how, capsys):
    out = tmp_path / "out"
    arguments = ["batch", str(recording), "--out", str(out), "--threads", "1"]
    process = subprocess.Popen([sys.executable, "-c", SLOW, *arguments], stderr=subprocess.PIPE, text=True)
    until(lambda: len(list(out.glob("part-*.parquet"))) >= 2)
    process.kill() if how == "killed" else process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    done = len(list(out.glob("part-*.parquet")))
    assert 2 <= done < 5
    if how == "interrupted":
        assert process.returncode == 130
        assert err.endswith("rgbd-planes batch: stopped; the same command does the rest\n")
        assert "Traceback" not in err
    assert cli.main(arguments) == 0
    assert f"{6 * done} frames had been done before." in capsys.readouterr().out
    check_rows(out, rp.open_sequence(recording))


AFTER_THE_MAIN_THREAD = """
import sys, threading
import rgbd_planes as rp

sequence, fit_sequence = rp.open_sequence(sys.argv[1]), rp.fit_sequence

def go_on():
    threading.main_thread().join()
    print(fit_sequence(sequence, sys.argv[2], num_threads=3).rows)

threading.Thread(target=go_on).start()
"""


def test_a_thread_that_goes_on_when_the_main_thread_has_ended(recording, tmp_path):
    command = [sys.executable, "-c", AFTER_THE_MAIN_THREAD, str(recording), str(tmp_path / "out")]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert ran.stdout == f"{30 * 20}\n", ran.stderr
    check_rows(tmp_path / "out", rp.open_sequence(recording))


def until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.01)


def test_command_writes_the_table_and_says_what_it_did(recording, tmp_path, capsys):
    out = tmp_path / "planes.parquet"
    arguments = ["batch", str(recording), "--out", str(out), "--tile", "12x16", "--max-error", "0.02"]
    assert cli.main(arguments) == 0
    written, err = capsys.readouterr()
    assert written.startswith("30 of 30 frames, 750 rows: ")
    assert "Of the work: read " in written
    assert err == ""
    check_rows(out, rp.open_sequence(recording), tile=(12, 16), max_error=0.02)
    (recording / "depth" / "3.png").write_bytes(b"")
    for part in out.glob("part-*.parquet"):
        part.unlink()
    assert cli.main(arguments) == 1
    written, err = capsys.readouterr()
    assert written.startswith("29 of 30 frames, 725 rows: ")
    first, last = err.splitlines()
    assert first.startswith("rgbd-planes batch: skipped frame 3, depth/3.png: ")
    assert last == "Skipped 1 of 30 frames."
    assert cli.main(arguments) == 1
    written, err = capsys.readouterr()
    assert "\n30 frames had been tried before.\n" in written
    assert err.splitlines()[-1] == "What was skipped before is tried again with --retry."
    assert cli.main([*arguments, "--retry"]) == 1
    written, err = capsys.readouterr()
    assert written.startswith("29 of 30 frames, 725 rows: ")
    assert err.splitlines() == [first, last]
    assert cli.main([*arguments, "--tile", "20"]) == 2
    assert "another sequence, camera, settings or version" in capsys.readouterr().err
    assert cli.main(["batch", str(tmp_path / "gone"), "--out", str(out)]) == 2
    assert "no such file or folder" in capsys.readouterr().err
    CAMERA.save(tmp_path / "c.json")
    with_camera = ["--camera", str(tmp_path / "c.json"), "--format", "tum"]
    assert cli.main(["batch", str(recording), "--out", str(tmp_path / "t"), *with_camera]) == 1
    capsys.readouterr()
    topic = ["batch", str(recording), "--out", str(tmp_path / "u"), "--topic", "/depth"]
    assert cli.main(topic) == 2
    assert "expected a ROS bag" in capsys.readouterr().err
    assert cli.main([*topic, "--format", "tum"]) == 2
    assert "--topic is for ROS bags, got it with --format tum" in capsys.readouterr().err


def test_what_is_wrong_with_many_frames_is_said_once(recording, tmp_path, capsys):
    replace(CAMERA, width=60, height=80).save(tmp_path / "swapped.json")
    (recording / "depth" / "12.png").write_bytes(b"")
    images.write_png(recording / "depth" / "0.png", np.full((80, 60), 1000, np.uint16))  # or it would be an error
    camera = str(tmp_path / "swapped.json")
    arguments = ["batch", str(recording), "--out", str(tmp_path / "t"), "--camera", camera]
    for again in range(2):  # the second time from what is written, which is said in a line more
        assert cli.main(arguments) == 1
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 4 + again
        transposed = "got (60, 80): is it transposed, or are the camera's width and height swapped?"
        assert sum(line.startswith("rgbd-planes batch: skipped frame ") for line in lines[:2]) == 2
        assert sum(line.endswith(transposed) for line in lines) == 2
        assert lines[2].startswith("28 frames, 1 to 11, 13 to 29: expected a depth frame of shape")
        assert lines[3] == "Skipped 29 of 30 frames."


def test_frames_of_another_size_are_an_error_before_a_table_is_begun(recording, tmp_path, capsys):
    CAMERA.resized(40, 30).save(tmp_path / "half.json")
    out = tmp_path / "t"
    arguments = ["batch", str(recording), "--out", str(out)]
    assert cli.main([*arguments, "--camera", str(tmp_path / "half.json")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(
        "rgbd-planes batch: depth/29.png: expected a depth frame of shape (height, width) = (30, 40)"
    )
    assert not out.exists()
    assert cli.main(arguments) == 0


@pytest.fixture
def cluster(tmp_path):
    """A scheduler and three workers, each a process of its own."""
    pytest.importorskip("distributed")
    environment = os.environ | {"DASK_DISTRIBUTED__ADMIN__TICK__LIMIT": "1h", "PYTHONPATH": os.pathsep.join(sys.path)}
    started = []

    def start(*arguments):
        command = [sys.executable, "-m", "distributed.cli." + arguments[0], *arguments[1:]]
        process = subprocess.Popen(
            command, env=environment, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        started.append(process)
        return process

    about = tmp_path / "scheduler.json"
    start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(about))
    until(lambda: about.exists() and about.read_text().endswith("}"))
    address = json.loads(about.read_text())["address"]
    workers = [
        start(
            "dask_worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny", "--host", "127.0.0.1",
            "--local-directory", str(tmp_path),
        )
        for _ in range(3)
    ]  # fmt: skip
    yield address, workers
    for process in started:
        process.kill()
    for process in started:
        process.wait()


def slow_frame(location):
    """Read a frame so slowly that a worker can be killed meanwhile; note which process did."""
    path, notes = location
    (notes / f"{path.stem}-{os.getpid()}-{time.monotonic_ns()}").touch()
    time.sleep(0.05)
    return images.read_depth(path)


@pytest.mark.parametrize("segments", [False, True])
def test_a_warning_is_said_once_where_the_batch_was_called(tmp_path, segments):
    """Whichever thread has read the frame, and whatever filters are set."""
    camera = replace(CAMERA, depth_scale=None)
    camera.save(tmp_path / "camera.json")
    for i in range(6):  # millimetres, for metres
        np.save(tmp_path / f"{i}.npy", np.full(camera.shape, 2000.0 + i))
    sequence = rp.open_sequence(tmp_path)
    with pytest.warns(UserWarning, match="of this frame is") as caught:
        rp.fit_sequence(sequence, tmp_path / "out", FitSettings(segments=segments), num_threads=2)
    assert [warning.filename for warning in caught] == [__file__]
    assert str(caught[0].message).split(": ")[0] in sequence.names
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UserWarning, match="of this frame is"):
            rp.fit_sequence(sequence, tmp_path / "other", FitSettings(segments=segments), num_threads=2)
        warnings.simplefilter("ignore")  # the parts that were not begun say so again
        report = rp.fit_sequence(sequence, tmp_path / "other", FitSettings(segments=segments))
    assert report.resumed > 0
    assert report.problems == []


def test_a_cluster_loses_a_worker_and_no_row(recording, tmp_path, cluster):
    address, workers = cluster
    notes = tmp_path / "notes"
    notes.mkdir()
    (recording / "depth" / "5.png").unlink()
    plain = rp.open_sequence(recording)
    sequence = FrameSequence(
        (FrameEntry(e.name, e.timestamp, e.camera, (e.location, notes)) for e in plain.entries), slow_frame
    )
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(3, timeout=60)
    seen = []

    def kill_one_at_work(done):
        if not seen:  # the first part has come back: others are under way
            victims = {worker.pid: worker for worker in workers}
            before = set(notes.iterdir())
            until(lambda: set(notes.iterdir()) > before)  # someone has just begun a frame
            latest = max(notes.iterdir(), key=lambda note: int(note.name.split("-")[2]))
            pid = int(latest.name.split("-")[1])
            victims[pid].kill()
        seen.append(done)

    report = rp.fit_sequence(sequence, tmp_path / "out", scheduler=address, progress=kill_one_at_work)
    assert sum(worker.poll() is not None for worker in workers) == 1
    # Some frames were read twice, by the worker that died and by another; their rows are there once.
    read = [note.name.split("-")[0] for note in notes.iterdir()]
    assert len(read) > len(set(read)) == 30
    assert len({note.name.split("-")[1] for note in notes.iterdir()}) == 3
    assert [problem.frame for problem in report.problems] == [5]
    assert sum(done.frames for done in seen) == 30
    check_rows(tmp_path / "out", plain, bad=(5,))
    # What threads here write is the same to the byte.
    batch.fit_sequence(plain, tmp_path / "threads", num_threads=3)
    for part in sorted((tmp_path / "out").glob("part-*")):
        assert part.read_bytes() == (tmp_path / "threads" / part.name).read_bytes()


def test_a_cluster_from_the_command_line(recording, tmp_path, cluster, capsys):
    address, _ = cluster
    arguments = ["batch", str(recording), "--out", str(tmp_path / "out"), "--scheduler", address]
    assert cli.main(arguments) == 0
    check_rows(tmp_path / "out", rp.open_sequence(recording))
    assert cli.main(arguments) == 0
    assert "30 frames had been done before" in capsys.readouterr().out


def test_no_cluster_at_the_address(recording, tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    monkeypatch.setattr(batch, "CONNECT_SECONDS", 0.5)
    arguments = ["batch", str(recording), "--out", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:9"]
    assert cli.main(arguments) == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err
    assert cli.main([*arguments[:-1], "127.0.0.1"]) == 2
    assert "address as tcp://host:port, got '127.0.0.1'" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert cli.main(arguments) == 2
    assert 'pip install "rgbd-planes[dask]"' in capsys.readouterr().err


def test_presets_do_for_a_benchmark_sequence(tmp_path):
    root = tmp_path / "rgbd_dataset_freiburg3_x"
    (root / "depth").mkdir(parents=True)
    camera = presets.tum_freiburg3()
    images.write_png(root / "depth" / "1.5.png", scenes.room().render(camera).measure(seed=1))
    (root / "depth.txt").write_text("# timestamp filename\n1.5 depth/1.5.png\n")
    assert cli.main(["batch", str(root), "--out", str(tmp_path / "out")]) == 0
    check_rows(tmp_path / "out", rp.open_sequence(root))


def test_command_passes_its_options_on(recording, tmp_path):
    options = {"tile": (12, 16), "method": "standard_pca", "max_missing": 0.3, "max_error": 0.02}
    words = ["--tile=12x16", "--method=standard_pca", "--max-missing=0.3", "--max-error=0.02"]
    assert cli.main(["batch", str(recording), "--out", str(tmp_path / "out"), *words]) == 0
    check_rows(tmp_path / "out", rp.open_sequence(recording), **options)
    words = ["--noise=kinect_v1", "--significance=0.5"]
    assert cli.main(["batch", str(recording), "--out", str(tmp_path / "noisy"), *words]) == 0
    check_rows(tmp_path / "noisy", rp.open_sequence(recording).with_noise(rp.noise.kinect_v1()), significance=0.5)


def test_command_tries_again_what_was_skipped(recording, tmp_path, capsys):
    frame = recording / "depth" / "3.png"
    content = frame.read_bytes()
    replace_unseen(frame, bytes(len(content)))
    arguments = ["batch", str(recording), "--out", str(tmp_path / "out")]
    assert cli.main(arguments) == 1
    replace_unseen(frame, content)
    assert cli.main(arguments) == 1
    capsys.readouterr()
    assert cli.main([*arguments, "--retry"]) == 0
    assert capsys.readouterr().out.startswith("30 of 30 frames, ")
    check_rows(tmp_path / "out", rp.open_sequence(recording))


def test_planes_that_are_all_rough_are_planes(recording, tmp_path, capsys):
    arguments = ["batch", str(recording), "--out", str(tmp_path / "out"), "--max-error", "1e-9"]
    assert cli.main(arguments) == 0
    out, err = capsys.readouterr()
    assert " ROUGH" in out
    assert " OK" not in out
    assert err == ""


@pytest.mark.parametrize(
    "error",
    [MemoryError(), ImportError("no libpng")]
    + [OSError(number, os.strerror(number)) for number in (errno.ENFILE, errno.EIO, errno.ETIMEDOUT, errno.ENOTCONN)]
    + [TimeoutError("no answer")],
)
def test_what_the_machine_lacks_is_no_fault_of_a_frame(recording, tmp_path, error):
    """Otherwise the frame would be left out for good; where the system names no file, the frame is named."""

    def read(path):
        raise error

    sequence = FrameSequence(rp.open_sequence(recording).entries, read)
    with pytest.raises(type(error), match=r"depth/\d+\.png" if isinstance(error, OSError) else None):
        rp.fit_sequence(sequence, tmp_path / "out")
    assert not list((tmp_path / "out").glob("part-*"))


@pytest.mark.parametrize("noise", [None, rp.noise.kinect_v1()])
def test_curvatures_are_in_the_table_if_asked_for(recording, tmp_path, noise):
    sequence = rp.open_sequence(recording)
    if noise is not None:
        sequence = sequence.with_noise(noise)
    rp.fit_sequence(sequence, tmp_path / "bent", rp.FitSettings(tile=8, curvature=True), num_threads=2)
    columns = rows_of(tmp_path / "bent")
    found = rp.fit_surfaces(sequence[1].depth, sequence.camera, 8)
    rows = columns["frame"] == 1
    for name in ("mean_curvature", "gaussian_curvature", *(("p_flat", "mean_curvature_std") if noise else ())):
        np.testing.assert_array_equal(columns[name][rows], getattr(found, name).ravel().astype(np.float32))
    kappas = np.stack([columns[name][rows] for name in ("kappa_1", "kappa_2")], axis=1)
    np.testing.assert_array_equal(kappas, found.principal_curvatures.reshape(-1, 2).astype(np.float32))
    assert ("p_flat" in columns) == (noise is not None)
    with pytest.raises(ValueError, match="take no options of tiles"):
        rp.fit_sequence(sequence, tmp_path / "planes", rp.FitSettings(segments=True, curvature=True))
    with pytest.raises(ValueError, match="at least 3 x 3"):
        rp.fit_sequence(sequence, tmp_path / "planes", rp.FitSettings(tile=2, curvature=True))
