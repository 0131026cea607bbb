"""The folder of a batch's table, read as the documentation of each tool has it."""

import numpy as np
import pytest

import rgbd_planes as rp
from rgbd_planes.sequences import FrameEntry, FrameSequence

CAMERA = rp.Camera(64, 48, 52.0, 52.0, 31.5, 23.5, depth_scale=1000.0)


def read(index):
    return np.random.default_rng(index).integers(900, 1100, CAMERA.shape).astype(np.uint16)


@pytest.fixture(scope="module", params=["tiles", "segments", "with noise"])
def table(request, tmp_path_factory):
    """The folder, and the number of its rows."""
    pytest.importorskip("pyarrow")
    out = tmp_path_factory.mktemp("table") / "planes.parquet"
    sequence = FrameSequence([FrameEntry(f"{i}", float(i), CAMERA, i) for i in range(6)], read)
    if request.param == "with noise":
        sequence = sequence.with_noise(rp.noise.kinect_v1())
    report = rp.fit_sequence(sequence, out, rp.FitSettings(segments=request.param == "segments"))
    again = rp.fit_sequence(sequence, out, rp.FitSettings(segments=request.param == "segments"))
    assert again.resumed == 6
    return out, report.rows


def test_polars(table):
    polars = pytest.importorskip("polars")
    out, rows = table
    read = polars.read_parquet(out)
    assert len(read) == rows
    assert len(polars.scan_parquet(out).collect()) == rows
    assert len(polars.read_parquet(out / "*.parquet")) == rows
    assert {"frame", "name", "nx", "d", "status"} <= set(read.columns)


def test_duckdb(table):
    duckdb = pytest.importorskip("duckdb")
    out, rows = table
    assert duckdb.sql(f"SELECT count(*) FROM '{out}/*.parquet'").fetchall() == [(rows,)]
    assert (
        duckdb.sql(f"SELECT count(*) FROM read_parquet('{out}/*.parquet') WHERE status = 'OK'").fetchall()[0][0] <= rows
    )


def test_pandas_and_arrow(table):
    pandas = pytest.importorskip("pandas")
    dataset = pytest.importorskip("pyarrow.dataset")
    out, rows = table
    assert len(pandas.read_parquet(out)) == rows
    assert dataset.dataset(out).count_rows() == rows
    assert dataset.dataset(out, format="parquet", exclude_invalid_files=False).to_table().num_rows == rows


def test_every_file_is_parquet(table):
    parquet = pytest.importorskip("pyarrow.parquet")
    out, rows = table
    files = list(out.iterdir())
    assert all(file.suffix == ".parquet" for file in files)
    assert sum(parquet.read_metadata(file).num_rows for file in files) == rows
