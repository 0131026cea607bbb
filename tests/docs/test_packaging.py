"""What is said about the package in several places is the same everywhere."""

import importlib
import itertools
import re
import tomllib
from pathlib import Path

import rgbd_planes as rp

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_version_is_the_same_everywhere():
    assert PROJECT["version"] == rp.__version__
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    version, date = re.search(r"^## (\S+) \((\d{4}-\d\d-\d\d)\)$", changelog, re.MULTILINE).groups()
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    if "\n## Unreleased\n" in changelog:  # then it is on the way from the last release to the next
        release, _, dev = rp.__version__.partition(".dev")
        assert dev.isdigit()
        assert tuple(map(int, release.split("."))) > tuple(map(int, version.split(".")))
    else:
        assert version == rp.__version__
    assert re.search(r"^version: (\S+)$", citation, re.MULTILINE)[1] == version
    assert re.search(r'^date-released: "(\S+)"$', citation, re.MULTILINE)[1] == date


def test_every_folder_is_a_package():
    """Setuptools finds packages, and passes over folders that are none."""
    for top in ("rgbd_planes", "kernels"):
        for folder in {file.parent for file in (ROOT / top).rglob("*.py")}:
            assert (folder / "__init__.py").is_file(), folder


def test_every_extra_that_is_spoken_of_exists():
    extras = set(PROJECT["optional-dependencies"])
    for file in [*(ROOT / "rgbd_planes").rglob("*.py"), *(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]:
        text = file.read_text(encoding="utf-8")
        spoken = re.findall(r"rgbd-planes\[(\w+)\]", text) + re.findall(r'needs\("[\w-]+", "(\w+)"\)', text)
        assert set(spoken) <= extras, file


def test_what_a_user_installs_is_little():
    names = {re.split(r"[<>=]", requirement)[0] for requirement in PROJECT["dependencies"]}
    assert names == {"matplotlib", "numba", "numpy", "pillow", "scipy"}


def test_each_library_has_one_lower_bound():
    """With two, no environment has the oldest of all."""
    bounds: dict[str, set[str]] = {}
    for requirement in itertools.chain(PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()):
        name, bound, version = requirement.partition(";")[0].strip().partition(">=")
        if bound:
            bounds.setdefault(name, set()).add(version)
    assert {name: found for name, found in bounds.items() if len(found) > 1} == {}


def test_the_command_is_a_function():
    """What an installation runs as ``rgbd-planes``."""
    module, _, name = PROJECT["scripts"]["rgbd-planes"].partition(":")
    assert callable(getattr(importlib.import_module(module), name))
