"""Equations between dollar signs become MathML when the site is built: browsers show it by themselves."""

import re
from typing import Any

from latex2mathml.converter import convert

_CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)
_DISPLAY = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"\$((?:[^$\n]|\n(?![ \t]*\n))+)\$")  # may go on in the next line, but not after a blank one
_FUNCTION = re.compile(r"(\\(?:tan|ln)) *(?=\\[a-z])")  # before a letter, from which MathML has no space


def _mathml(equation: str, display: str) -> str:
    return convert(_FUNCTION.sub(r"\1\\,", equation.strip()), display=display)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace the equations outside code, in the way that mkdocs calls its hooks.

    Raises
    ------
    ValueError
        A dollar sign outside code has no other to go with.
    """
    parts = _CODE.split(markdown)
    for i in range(0, len(parts), 2):
        shown = _DISPLAY.sub(lambda found: _mathml(found[1], "block"), parts[i])
        # In a span: Markdown takes <math> for a block where a line begins with it.
        parts[i] = _INLINE.sub(lambda found: f"<span>{_mathml(found[1], 'inline')}</span>", shown)
        if left := re.search(r".*\$.*", parts[i]):
            raise ValueError(f"expected equations between two dollar signs, got one alone: {left[0]!r}")
    return "".join(parts)
