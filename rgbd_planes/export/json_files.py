"""Results as JSON, shared by the exports of tiles and of segments."""

import json
import math
import os
from collections.abc import Mapping
from typing import Any

from rgbd_planes._core.files import write_beside


def write_json_file(path: str | os.PathLike[str], content: Mapping[str, Any]) -> None:
    """Write what JSON can hold, in one line; whole or not at all."""
    with write_beside(path, ".json") as beside:
        beside.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def finite_or_none(value: float) -> float | None:
    """A number as JSON has it, which has no infinity and no NaN."""
    return float(value) if math.isfinite(value) else None
