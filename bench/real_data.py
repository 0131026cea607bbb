"""The folder of real depth frames, where there is one: the environment variable RGBD_PLANES_DATA names it."""

import os
from collections.abc import Iterable
from pathlib import Path

FOLDER = Path(os.environ.get("RGBD_PLANES_DATA") or "no-real-frames")
REASON = "needs real depth frames: the environment variable RGBD_PLANES_DATA names their folder"


def needed(names: Iterable[str]) -> None:
    """End the program, with the reason, if one of these data sets is not there."""
    missing = [name for name in names if not (FOLDER / name / "camera.json").is_file()]
    if missing:
        raise SystemExit(f"{REASON}: {', '.join(missing)} is not there; see docs/measured.md")


def sets() -> list[Path]:
    """Every data set of single frames: a folder with camera.json and depth/*.png."""
    return sorted(path.parent for path in FOLDER.glob("*/camera.json") if (path.parent / "depth").is_dir())
