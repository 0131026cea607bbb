"""The folder of real depth frames beside the checkout, where there is one."""

from collections.abc import Iterable
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data"
REASON = f"needs the real depth frames in {FOLDER.parent.name}/{FOLDER.name}, beside the checkout"


def needed(names: Iterable[str]) -> None:
    """End the program, with the reason, if one of these data sets is not there."""
    missing = [name for name in names if not (FOLDER / name / "camera.json").is_file()]
    if missing:
        raise SystemExit(f"{REASON}: {', '.join(missing)} is not there; see docs/measured.md")


def sets() -> list[Path]:
    """Every data set: a folder with camera.json and depth/*.png."""
    return sorted(path.parent for path in FOLDER.glob("*/camera.json"))
