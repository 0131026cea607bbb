"""Pages and docstrings are in short sentences, and state what they say instead of referring elsewhere."""

import inspect
import re
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import rgbd_planes as rp

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
MOST_WORDS = 15  # of the mean sentence
REFERRAL = re.compile(r"(?:see|as|as in|as for|like|of) `+[\w.]+`+(?:\([^)]*\))?\.?", re.IGNORECASE)


def sentences(text):
    """How many words each sentence has, without code, tables, formulas, headings, and what `bench.measured` writes."""
    for what, word in (
        (
            r"(?s)^```.*?^```$|<!-- bench.*?<!-- /bench -->|\$\$.*?\$\$|^\.\. math::.*?\n(?=\S)|!\[[^]]*\]\([^)]*\)",
            "\n\n",
        ),
        (r"\[([^]]*)\]\([^)]*\)", r"\1"),  # of links their text
        (r"\$[^$]*\$|``?[^`]+``?", "x"),
        (r"^#.*$|^\|.*\|$|^.*\n-{3,}$", "\n"),
        (r"^ *(?:[-*]|\d+\.) ", "\n\n"),
    ):
        text = re.sub(what, word, text, flags=re.MULTILINE)
    found = []
    for paragraph in re.split(r"\n\s*\n", text):
        parts = re.split(r"(?<=[.!?])[)\"*]*\s+(?=[^a-z])", paragraph)
        found += [len(re.findall(r"\S*\w\S*", part)) for part in parts]
    return [words for words in found if words > 2]  # less is a word under a heading


def test_sentences_are_counted():
    text = "# A title of words\n\nIt is `one thing`, [as here](there.md). It\nends: $a + b$.\n\n- A point\n\n"
    assert sentences(text + "```python\nno = 1\n```") == [5, 3]
    assert sentences("| what it is | how |\n|---|---|\n| three of us | a |") == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_sentences_of_each_page_are_short(page):
    assert np.mean(sentences(page.read_text(encoding="utf-8"))) <= MOST_WORDS


def public():
    """Docstrings of the public names and of their methods, by name."""
    found = {}

    def add(name, what):
        text = inspect.getdoc(what)
        if text and str(getattr(what, "__module__", "rgbd_planes")).startswith("rgbd_planes"):
            found[name] = text
            for member, method in vars(what).items() if inspect.isclass(what) else ():
                method = method.fget if isinstance(method, property) else getattr(method, "__func__", method)
                if not member.startswith("_") and inspect.isfunction(method):
                    add(f"{name}.{member}", method)
            for base in what.__mro__[1:] if inspect.isclass(what) else ():
                add(base.__qualname__, base) if base.__qualname__ not in found else None

    for name in set(rp.__all__) - {"__version__"}:
        what = getattr(rp, name)
        add(name, what)
        for member, value in vars(what).items() if isinstance(what, ModuleType) else ():
            if not member.startswith("_") and callable(value):
                add(f"{name}.{member}", value)
    return found


def items(docstring):
    """The texts of parameters, results, attributes and errors."""
    return re.findall(r"(?m)^\S.*\n((?:(?: {4}.*)?\n)* {4}\S.*)", docstring)


def plain(docstring):
    """A docstring without the lines that name its parameters and results."""
    lines = [*docstring.splitlines(), ""]
    return "\n".join(
        "" if re.match(r"\S", line) and re.match(r" {4}\S", after) else line.strip() for line, after in pairwise(lines)
    )


def test_the_sentences_of_docstrings_are_short():
    docstrings = public()
    assert {"fit_tiles", "Camera.from_ros", "export.to_dict", "PlaneFits"} <= set(docstrings)
    assert np.mean([words for text in docstrings.values() for words in sentences(plain(text))]) <= MOST_WORDS


def test_docstrings_say_what_they_mean():
    docstrings = public()
    assert items(docstrings["fit_tiles"])
    for name, text in docstrings.items():
        assert not re.search(r"\bsee ``?\w", text, re.IGNORECASE), f"{name} refers elsewhere"
        for item in items(text):
            assert not REFERRAL.fullmatch(" ".join(item.split())), (
                f"{name} says only where else to look: {item.strip()}"
            )
