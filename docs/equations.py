"""Equations between dollar signs become MathML when the site is built: browsers show it by themselves."""

import re
from typing import Any

from latex2mathml.converter import convert

_CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)
_DISPLAY = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"\$([^$\n]+?)\$")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace the equations outside code, in the way that mkdocs calls its hooks."""
    parts = _CODE.split(markdown)
    for i in range(0, len(parts), 2):
        shown = _DISPLAY.sub(lambda found: convert(found[1].strip(), display="block"), parts[i])
        # In a span: Markdown takes <math> for a block where a line begins with it.
        parts[i] = _INLINE.sub(lambda found: f"<span>{convert(found[1].strip())}</span>", shown)
    return "".join(parts)
