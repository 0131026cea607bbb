"""The documentation's pictures, as its pages' own code draws them: ``python -m bench.pictures [NAME ...]``.

That of the roofline is drawn by ``python -m bench.measured roofline``.
"""

import argparse
import contextlib
import re
import tempfile
from pathlib import Path

from PIL import Image

from rgbd_planes.camera import presets
from rgbd_planes.evaluation import scenes
from rgbd_planes.sequences import images

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "images"
# The page whose code draws it, which of its blocks of Python that is, and the file that it writes.
PICTURES = {
    "demo": ("README.md", 0, "planes.png"),
    "segments": ("docs/howto/segments.md", 0, "segments.png"),
    "bias": ("docs/howto/bent-floors.md", 0, "bias.png"),
    "fisheye": ("docs/howto/calibration.md", 4, "fisheye.png"),
}


def code_of(name: str) -> str:
    """The code that draws a picture."""
    page, block, _ = PICTURES[name]
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks: list[str] = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return blocks[block]


def draw(name: str) -> None:
    """Run the code beside the files that the pages speak of, and keep its picture."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        camera = presets.primesense()
        camera.save("camera.json")
        images.write_png("depth.png", scenes.room().render(camera).measure(holes=0.05, patches=0.03, seed=1))
        exec(compile(code_of(name), PICTURES[name][0], "exec"), {})
        Image.open(PICTURES[name][2]).convert("RGB").save(FOLDER / f"{name}.png", optimize=True)


def main() -> None:
    """Draw all pictures, or those named."""
    parser = argparse.ArgumentParser(prog="python -m bench.pictures", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PICTURES))
    names = parser.parse_args().names
    if unknown := set(names) - set(PICTURES):
        parser.error(f"expected of {', '.join(PICTURES)}, got {', '.join(sorted(unknown))}")
    for name in names or PICTURES:
        draw(name)
        print(f"wrote {FOLDER / name}.png")


if __name__ == "__main__":
    main()
