"""The folder of real depth frames beside the checkout, where there is one."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data"
REASON = f"needs the real depth frames in {FOLDER.parent.name}/{FOLDER.name}, beside the checkout"


def sets() -> list[Path]:
    """Every data set: a folder with camera.json and depth/*.png."""
    return sorted(path.parent for path in FOLDER.glob("*/camera.json"))
