"""What calibration files use of YAML: nested mappings, lists, numbers and texts; no library is needed for these.

Tags and the directive of OpenCV's FileStorage, ``%YAML:1.0``, which YAML's own readers refuse, are passed over.
"""

from __future__ import annotations

import re
from typing import Any

_KEY = re.compile(r"""("[^"]*"|'[^']*'|[^\s#\[{"'][^#]*?)\s*:(?:\s+|$)""")
_TAG = re.compile(r"^!+\S*\s*")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
_SPECIAL = {"true": True, "false": False, "null": None, "~": None, ".nan": float("nan"), ".inf": float("inf")}
_LARGEST = 2**22  # characters; calibrations have some thousand
_DEEPEST = 20  # mappings and lists in one another


def parse(text: str) -> Any:
    """The value of a YAML text.

    Raises
    ------
    ValueError
        The text is none, or uses more of YAML than is read here.
    """
    if len(text) > _LARGEST:
        raise ValueError(f"expected a calibration, got {len(text)} characters")
    lines = _lines(text)
    if not lines:
        raise ValueError("expected YAML, got an empty text")
    value, rest = _block(lines, 0, lines[0][0], 0)
    if rest < len(lines):
        raise ValueError(f"expected YAML, got {lines[rest][1][:60]!r} where no entry can begin")
    return value


def _lines(text: str) -> list[tuple[int, str]]:
    """Indentation and content of each line, lists in brackets on one line, without comments."""
    joined: list[tuple[int, str]] = []
    opened = 0
    for raw in text.splitlines():
        if not opened and raw.startswith(("%", "---", "...")):
            continue
        line = _without_comment(raw.expandtabs()).rstrip()
        if not line.strip():
            continue
        if opened:
            indent, before = joined[-1]
            joined[-1] = indent, f"{before} {line.strip()}"
        else:
            joined.append((len(line) - len(line.lstrip()), line.strip()))
        plain = re.sub(r"\"[^\"]*\"|'[^']*'", "", line)
        opened += plain.count("[") + plain.count("{") - plain.count("]") - plain.count("}")
        if opened < 0:
            raise ValueError(f"expected YAML, got a bracket too many in {line.strip()[:60]!r}")
    if opened:
        raise ValueError("expected YAML, got a bracket that is never closed")
    return joined


def _without_comment(line: str) -> str:
    quoted = ""
    for i, character in enumerate(line):
        if quoted:
            quoted = "" if character == quoted else quoted
        elif character in "\"'":
            quoted = character
        elif character == "#" and (i == 0 or line[i - 1].isspace()):
            return line[:i]
    return line


def _block(lines: list[tuple[int, str]], at: int, indent: int, depth: int) -> tuple[Any, int]:
    """The mapping, list or scalar whose lines begin at an indentation, and the number of the line after it."""
    if depth > _DEEPEST:
        raise ValueError(f"expected a calibration, got YAML of more than {_DEEPEST} levels")
    if lines[at][1].startswith("-") and lines[at][1][1:2] in ("", " "):
        return _list(lines, at, indent, depth)
    if _KEY.match(lines[at][1]):
        return _mapping(lines, at, indent, depth)
    return _flow(lines[at][1], depth), at + 1


def _mapping(lines: list[tuple[int, str]], at: int, indent: int, depth: int) -> tuple[dict[str, Any], int]:
    found: dict[str, Any] = {}
    while at < len(lines) and lines[at][0] == indent:
        match = _KEY.match(lines[at][1])
        if match is None:
            break
        key, rest = match[1].strip("\"'"), _TAG.sub("", lines[at][1][match.end() :].strip())
        at += 1
        if rest:
            found[key] = _flow(rest, depth)
        elif at < len(lines) and (lines[at][0] > indent or (lines[at][0] == indent and lines[at][1].startswith("- "))):
            found[key], at = _block(lines, at, lines[at][0], depth + 1)
        else:
            found[key] = None
    return found, at


def _list(lines: list[tuple[int, str]], at: int, indent: int, depth: int) -> tuple[list[Any], int]:
    found: list[Any] = []
    while at < len(lines) and lines[at][0] == indent and lines[at][1].startswith("-"):
        rest = lines[at][1][1:]
        inner = indent + 1 + len(rest) - len(rest.lstrip())
        if rest.strip():  # its content may go on below, as if it stood on a line of its own
            lines = [*lines[:at], (inner, rest.strip()), *lines[at + 1 :]]
            value, at = _block(lines, at, inner, depth + 1)
        elif at + 1 < len(lines) and lines[at + 1][0] > indent:
            value, at = _block(lines, at + 1, lines[at + 1][0], depth + 1)
        else:
            value, at = None, at + 1
        found.append(value)
    return found, at


def _flow(text: str, depth: int) -> Any:
    """A scalar, or a list or mapping in brackets."""
    text = text.strip()
    if not text.startswith(("[", "{")):
        return _scalar(text)
    if depth > _DEEPEST:
        raise ValueError(f"expected a calibration, got YAML of more than {_DEEPEST} levels")
    if text[-1] != {"[": "]", "{": "}"}[text[0]]:
        raise ValueError(f"expected YAML, got {text[-20:]!r} after a bracket")
    parts = _parts(text[1:-1])
    if text[0] == "[":
        return [_flow(part, depth + 1) for part in parts]
    pairs = (part.partition(":") for part in parts)
    return {key.strip().strip("\"'"): _flow(value, depth + 1) for key, _, value in pairs}


def _parts(text: str) -> list[str]:
    """What stands between the commas that are in no bracket."""
    parts, opened, start, quoted = [], 0, 0, ""
    for i, character in enumerate(text):
        if quoted or character in "\"'":
            quoted = "" if character == quoted else quoted or character
            continue
        opened += (character in "[{") - (character in "]}")
        if character == "," and opened == 0:
            parts.append(text[start:i])
            start = i + 1
    parts.append(text[start:])
    return [part for part in parts if part.strip()]


def _scalar(text: str) -> Any:
    if text[:1] in ("'", '"'):
        return text.strip(text[0])
    if text.lower() in _SPECIAL:
        return _SPECIAL[text.lower()]
    if _NUMBER.match(text):
        return int(text) if re.fullmatch(r"[-+]?\d{1,18}", text) else float(text)
    return text
