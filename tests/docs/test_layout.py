"""The house stays one that can be walked through: few folders, few files in each, and each says what it is for."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FACE, KERNELS = ROOT / "rgbd_planes", ROOT / "kernels"
FOLDERS = [
    path.parent
    for top in (FACE, KERNELS)
    for path in sorted(top.rglob("__init__.py"))
    if top == KERNELS or FACE / "kernels" not in path.parents
]


@pytest.mark.parametrize(("top", "most"), [(FACE, 19), (KERNELS, 10)])
def test_at_the_top_there_are_few_folders_and_files(top, most):
    entries = [path.name for path in top.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()]
    assert len(entries) <= most, sorted(entries)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_a_folder_has_few_files_and_says_what_it_is_for(folder):
    files = [path.name for path in folder.glob("*.py") if path.name != "__init__.py"]
    assert len(files) <= 13, sorted(files)
    assert ast.get_docstring(ast.parse((folder / "__init__.py").read_text()))


def test_no_two_files_of_tests_have_one_name():
    """Or pytest would take one for the other, where both are collected."""
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))
