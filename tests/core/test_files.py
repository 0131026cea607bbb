"""Files: whole or not at all, whatever stops the work; and the one door that files are opened by."""

import os
from pathlib import Path

import pytest

from rgbd_planes._core import files


def test_what_takes_a_place_is_on_the_disk_before_and_the_name_after(tmp_path, monkeypatch):
    """Else a power cut could leave the name of a file without its content."""
    path, done = tmp_path / "planes.json", []
    fsync, replace = os.fsync, Path.replace

    def synced(handle: int) -> None:
        done.append(Path(os.readlink(f"/proc/self/fd/{handle}")))
        fsync(handle)

    def replaced(self: Path, target: Path) -> Path:
        done.append("replaced")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", replaced)
    with files.write_beside(path) as beside:
        beside.write_text("{}")
    assert done == [beside, "replaced", tmp_path]
    assert path.read_text() == "{}"


def test_a_file_system_that_cannot_wait_for_its_disk_is_no_error(tmp_path, monkeypatch):
    def refused(handle: int) -> None:
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(os, "fsync", refused)
    with files.write_beside(tmp_path / "a.txt") as beside:
        beside.write_text("a")
    assert (tmp_path / "a.txt").read_text() == "a"


def test_a_disk_that_fails_is_an_error_and_the_old_file_stays(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def failed(handle: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", failed)
    with pytest.raises(OSError, match="Input/output error"), files.write_beside(path) as beside:
        beside.write_text("new")
    assert path.read_text() == "old"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]
