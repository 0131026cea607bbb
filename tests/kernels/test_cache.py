"""Compiled kernels on disk: what one process saves, another loads, whatever happened in between."""

import ast
import errno
import importlib.util
import os
import shutil
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import config
from numba.core.caching import FunctionCache
from processes import printed_by

from rgbd_planes.kernels._jit import disk_cache
from rgbd_planes.kernels._jit import kernel as jit

SOURCE = "from rgbd_planes.kernels._jit.kernel import kernel\n@kernel()\ndef twice(x): return x + x\n"


@pytest.fixture
def of_a_process(tmp_path, monkeypatch):
    """A kernel as another process would have it: nothing compiled, the same files."""
    monkeypatch.setattr(config, "CACHE_DIR", "")  # which the environment may have set
    (tmp_path / "doubling.py").write_text(SOURCE)

    def load(name: str = "doubling") -> Any:
        spec = importlib.util.spec_from_file_location(name, tmp_path / "doubling.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.twice

    return load


@pytest.fixture
def files(of_a_process) -> list[Path]:
    """Where a kernel for integers has been saved."""
    twice = of_a_process()
    assert twice(3) == 6
    return list(Path(twice._cache.cache_path).glob("*.nbc"))


def loaded(kernel: Any) -> tuple[int, int]:
    """How often a kernel was found on disk, and how often not."""
    return sum(kernel.stats.cache_hits.values()), sum(kernel.stats.cache_misses.values())


def test_under_another_name_a_module_loads_nothing(of_a_process, files):
    """What was compiled imports its module by the name of then, as after a folder of kernels has moved."""
    moved = of_a_process("moved.doubling")
    assert moved(3) == 6
    assert loaded(moved) == (0, 1)


def test_processes_of_one_test_run_compile_a_kernel_once(tmp_path):
    """Both begin at the same moment."""
    (tmp_path / "doubling.py").write_text(SOURCE)
    code = """
import pathlib, sys, time
folder, number = pathlib.Path(sys.argv[1]), int(sys.argv[2])
sys.path[:0] = [str(folder), sys.argv[3]]
import compiled_once, doubling
compiled_once.share(folder.name)
(folder / f"ready{number}").touch()
while not (folder / f"ready{1 - number}").exists():
    time.sleep(0.001)
doubling.twice(3)
print(sum(doubling.twice.stats.cache_misses.values()))
"""
    tests = str(Path(__file__).resolve().parents[1])
    with ThreadPoolExecutor(2) as threads:
        missed = list(threads.map(lambda number: printed_by(code, str(tmp_path), str(number), tests), range(2)))
    assert sorted(map(int, missed)) == [0, 1]


def test_what_one_process_compiles_another_loads(of_a_process, files):
    assert len(files) == 1
    twice = of_a_process()
    assert twice(4) == 8
    assert loaded(twice) == (1, 0)
    assert twice(0.25) == 0.5
    assert loaded(twice) == (1, 1)


def test_a_kernel_elsewhere_is_another_one_if_its_file_changes(of_a_process, files, tmp_path):
    path = tmp_path / "doubling.py"
    path.write_text(path.read_text().replace("def twice(x): return x + x", "def twice(x): return 2 + 1 * x"))
    jit._digest.cache_clear()  # as in another process
    assert of_a_process()(3) == 5


def test_a_change_gives_new_files_to_all_kernels_that_may_call_it(tmp_path, monkeypatch):
    """Those that import the changed file, however many files lie between; and no others."""
    copied = tmp_path / "kernels"
    shutil.copytree(jit.KERNELS, copied, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(jit, "KERNELS", copied)
    paths = sorted(copied.glob("**/*.py"))

    def digests() -> dict[str, str]:
        jit._digest.cache_clear()
        return {path.relative_to(copied).as_posix(): jit._digest(str(path)) for path in paths}

    for changed, calls, does_not in (
        ("solvers/eigen3.py", "fits/tiles.py", "moments/summed_area.py"),
        ("common/union_find.py", "segmentation/curved/curved.py", "fits/tiles.py"),
        ("_jit/array_lowering.py", "segmentation/curved/curved.py", "_jit/disk_cache.py"),
    ):
        before = digests()
        (copied / changed).write_text((copied / changed).read_text() + "# changed\n")
        after = digests()
        assert {name: before[name] != after[name] for name in (changed, calls, does_not)} == {
            changed: True, calls: True, does_not: False
        }  # fmt: skip
    jit._digest.cache_clear()


def test_all_imports_between_kernels_are_seen():
    """What Python imports from other kernels' files, and what the digest looks for."""
    for path in sorted(jit.KERNELS.glob("**/*.py")):
        source = path.read_text()
        expected = set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom) and node.level:
                place = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
                inside = place.is_dir()
                expected |= {place / f"{name.name}.py" for name in node.names} if inside else {place.with_suffix(".py")}
            if isinstance(node, ast.ImportFrom | ast.Import):
                names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [each.name for each in node.names]
                assert not any(name.startswith("rgbd_planes") for name in names), path
        assert set(jit._imported(path, source)) == expected
        assert all(each.is_file() for each in expected)


def test_kernels_of_other_sources_are_removed_after_a_while(of_a_process, files, tmp_path):
    others = files[0].with_name(files[0].name.replace("twice_", "twice_again_"))
    others.write_bytes(files[0].read_bytes())
    path = tmp_path / "doubling.py"
    for changed, remain in (("x * 2", True), ("2 * x", False)):
        path.write_text(path.read_text().partition("def twice")[0] + f"def twice(x): return {changed}\n")
        jit._digest.cache_clear()
        assert of_a_process()(3) == 6
        assert files[0].exists() == remain
        for each in (files[0], others):
            if each.exists():
                os.utime(each, (0.0, time.time() - disk_cache.OUTDATED - 1.0))
    assert others.exists()
    assert len(list(files[0].parent.glob("doubling.twice_*"))) == 3  # the last two, and that of another kernel


@pytest.mark.parametrize(("option", "value"), [("BOUNDSCHECK", 0 if config.BOUNDSCHECK else 1), ("OPT", 1)])
def test_what_was_compiled_otherwise_is_not_loaded(of_a_process, files, monkeypatch, option, value):
    monkeypatch.setattr(config, option, value)
    twice = of_a_process()
    assert twice(3) == 6
    assert loaded(twice) == (0, 1)


@pytest.mark.parametrize("damage", ["empty", "cut short", "a bit", "zeros at the end"])
def test_a_damaged_file_is_compiled_anew(of_a_process, files, damage):
    content = bytearray(files[0].read_bytes())
    if damage == "a bit":
        content[len(content) // 2] ^= 16
    elif damage == "zeros at the end":
        content[-2000:] = bytes(2000)
    files[0].write_bytes(b"" if damage == "empty" else content[:-100] if damage == "cut short" else content)
    for found in ((0, 1), (1, 0)):
        twice = of_a_process()
        assert twice(3) == 6
        assert loaded(twice) == found


def test_processes_that_compile_at_a_time_lose_nothing(of_a_process, monkeypatch):
    """Another one saves a kernel for other types just when this one's file is about to appear."""
    replace = os.replace

    def interrupted(*names: Any) -> None:
        monkeypatch.setattr(os, "replace", replace)
        assert of_a_process()(0.25) == 0.5
        replace(*names)

    monkeypatch.setattr(os, "replace", interrupted)
    assert of_a_process()(3) == 6
    assert os.replace is replace
    twice = of_a_process()
    assert (twice(3), twice(0.25)) == (6, 0.5)
    assert loaded(twice) == (2, 0)


@pytest.mark.parametrize("elsewhere", [True, False])
def test_who_cannot_write_reads_what_the_installation_has(of_a_process, files, tmp_path, monkeypatch, elsewhere):
    """As of a container's image, whose kernels its administrator has compiled."""
    monkeypatch.setattr(jit, "has_cache", True)
    if elsewhere:
        monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "own"))
    else:  # neither here nor there: Numba knows no place
        monkeypatch.setattr(disk_cache.Compiled, "_locator_classes", (disk_cache.Installed,))
    twice = of_a_process()
    assert twice(3) == 6
    assert twice(0.25) == 0.5
    assert loaded(twice) == (1, 1)
    assert jit.has_cache == elsewhere
    assert len(list(files[0].parent.glob("doubling.twice*"))) == 1
    again = of_a_process()
    assert again(0.25) == 0.5
    assert loaded(again) == ((1, 0) if elsewhere else (0, 1))


def test_a_full_disk_is_no_error(of_a_process, monkeypatch):
    def full(*names: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        twice = of_a_process()
        assert twice(3) == 6
    assert list(Path(twice._cache.cache_path).glob("doubling.twice*")) == []
    assert twice(np.float32(0.25)) == 0.5


def test_a_kernel_that_is_recompiled_forgets_its_files(of_a_process, files):
    twice = of_a_process()
    assert twice(0.25) == 0.5
    twice.recompile()
    again = of_a_process()
    assert again(0.25) == 0.5
    assert loaded(again) == (1, 0)
    assert again(3) == 6
    assert loaded(again) == (1, 1)


def test_kernels_in_a_zip_are_those_of_the_zip(tmp_path):
    """A kernel has those that it calls in itself: it is another one if these change."""
    found = []
    for factor in (2, 30):
        with zipfile.ZipFile(tmp_path / "app.zip", "w") as archive:
            archive.writestr("app/__init__.py", "")
            for path in Path(jit.__file__).parent.glob("*.py"):
                archive.write(path, f"app/_jit/{path.name}")
            called = f"from ._jit.kernel import kernel\n@kernel()\ndef called(x): return {factor} * x\n"
            archive.writestr("app/two.py", called)
            calls = (
                "from ._jit.kernel import kernel\nfrom .two import called\n@kernel()\ndef calls(x): return called(x)\n"
            )
            archive.writestr("app/one.py", calls)
        places = {"PYTHONPATH": str(tmp_path / "app.zip"), "XDG_CACHE_HOME": str(tmp_path)}
        found.append(int(printed_by("from app.one import calls; print(calls(3))", **places)))
    assert found == [6, 90]


def test_a_later_numba_keeps_its_own_files(of_a_process, monkeypatch):
    """Where those are, and how they are named, is known by names that are not public."""
    begin = FunctionCache.__init__

    def begin_otherwise(self: Any, function: Any) -> None:
        begin(self, function)
        del self._impl._filename_base

    monkeypatch.setattr(FunctionCache, "__init__", begin_otherwise)
    assert of_a_process()(3) == 6
    twice = of_a_process()
    assert twice(3) == 6
    assert loaded(twice) == (1, 0)


@pytest.mark.skipif(os.name == "nt", reason="Windows has other permissions")
@pytest.mark.parametrize("mode", [0o666, 0o646, 0o664])
def test_a_kernel_that_others_can_write_is_not_loaded(of_a_process, files, mode, monkeypatch):
    """Loading it would run it. Where they can write the sources, too, there is nothing to protect."""
    sources = os.stat(disk_cache.__file__).st_mode
    files[0].chmod(mode)
    twice = of_a_process()
    assert twice(3) == 6
    trusted = not mode & ~sources & 0o022
    assert loaded(twice) == ((1, 0) if trusted else (0, 1))
    if not trusted:
        assert files[0].stat().st_mode & 0o022 == 0  # written anew
    monkeypatch.setattr(os, "geteuid", lambda: 4321)
    monkeypatch.setattr(disk_cache.os, "stat", lambda path: os.stat_result((0o100644, 0, 0, 1, 4321, 0, 0, 0, 0, 0)))
    status = os.stat_result((0o100644, 0, 0, 1, 1234, 0, 0, 0, 0, 0))
    assert not disk_cache._is_trusted(status)  # another user's
    assert disk_cache._is_trusted(os.stat_result((0o100644, 0, 0, 1, 0, 0, 0, 0, 0, 0)))  # the administrator's


def test_a_kernel_under_the_name_of_another_is_not_loaded(of_a_process, files):
    twice = of_a_process()
    assert twice(0.25) == 0.5
    (other,) = {*files[0].parent.glob(f"{twice._cache._impl.filename_base}*.nbc")} - set(files)
    other.write_bytes(files[0].read_bytes())  # an intact file, of integers
    twice = of_a_process()
    assert twice(0.25) == 0.5
    assert loaded(twice) == (0, 1)
