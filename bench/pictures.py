"""The documentation's pictures: ``python -m bench.pictures [NAME ...]``.

Those of results are drawn by their pages' own code. The others are drawings, the moving picture of the README, and a
page in a browser, which needs Chromium. Plots of what was measured are drawn by ``python -m bench.measured``.
"""

import argparse
import contextlib
import functools
import io
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from bench import browser, curvature_picture, drawings, primitive_picture, segmentation_stages, story
from rgbd_planes.camera import presets
from rgbd_planes.evaluation import scenes
from rgbd_planes.sequences import images

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "images"
# The page of which a block of Python draws it, and the file that this writes.
PICTURES = {
    "demo": ("README.md", "planes.png"),
    "segments": ("docs/howto/segments.md", "segments.png"),
    "noise": ("docs/howto/noise.md", "noise.png"),
    "odometry": ("docs/howto/odometry.md", "odometry.png"),
    "bias": ("docs/howto/bent-floors.md", "bias.png"),
    "fisheye": ("docs/howto/calibration.md", "fisheye.png"),
}


def code_of(name: str) -> str:
    """The code that draws a picture: the first block of its page that writes its file."""
    page, file = PICTURES[name]
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks: list[str] = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return next(block for block in blocks if f'savefig("{file}")' in block)


def draw(name: str) -> None:
    """Run the code beside the files that the pages speak of, and keep its picture."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        camera = presets.primesense()
        camera.save("camera.json")
        images.write_png("depth.png", scenes.room().render(camera).measure(holes=0.05, patches=0.03, seed=1))
        exec(compile(code_of(name), PICTURES[name][0], "exec"), {})
        Image.open(PICTURES[name][1]).convert("RGB").save(FOLDER / f"{name}.png", optimize=True)


def view() -> None:
    """Take a picture of ``rgbd-planes view`` in a browser, of a camera that passes through the rendered room."""
    camera = presets.primesense()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        for i in range(8):
            aside, ahead = 0.04 * i, 0.06 * i
            room = scenes.room((0.35 + aside, -1.5, ahead - 0.4), (aside - 0.12, -0.8, 2.4 + ahead))
            frame = f"{folder}/frame-{i:06}"
            images.write_png(f"{frame}.depth.png", room.render(camera).measure(holes=0.03, patches=0.02, seed=i))
            np.savetxt(f"{frame}.pose.txt", room.camera_to_scene)
        camera.save(f"{folder}/camera.json")
        command = [sys.executable, "-m", "rgbd_planes", "view", folder, "--camera", f"{folder}/camera.json"]
        with subprocess.Popen([*command, "--no-browser"], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            url = process.stdout.readline().split()[-1]
            process.stdout.readline()
            with browser.Browser(f"{folder}/profile", 1300, 800) as page:
                page.open(url, 30.0)
                shot = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
            process.terminate()
    below = 36  # the viewer's own bar
    shot.crop((0, below, shot.width, shot.height)).quantize(128).save(FOLDER / "view.png", optimize=True)


def normals() -> None:
    """Draw what ``rgbd-planes normals`` draws, of the rendered room."""
    from rgbd_planes.cli import main as cli

    with tempfile.TemporaryDirectory() as folder:
        camera = presets.primesense()
        camera.save(f"{folder}/camera.json")
        images.write_png(f"{folder}/depth.png", scenes.room().render(camera).measure(holes=0.05, patches=0.03, seed=1))
        command = ["normals", f"{folder}/depth.png", "--camera", f"{folder}/camera.json", "--window", "11"]
        cli.main([*command, "--avoid-edges", "--figure", f"{folder}/normals.png"])
        Image.open(f"{folder}/normals.png").convert("RGB").quantize(200).save(FOLDER / "normals.png", optimize=True)


def _drawing(name: str, figure: Callable[[], Figure]) -> Callable[[], None]:
    return lambda: figure().savefig(FOLDER / f"{name}.png", dpi=110)


# Those that no page's code draws, and their files.
OTHERS: dict[str, tuple[str, Callable[[], None]]] = {
    "story": ("story.gif", lambda: story.draw(FOLDER / "story.gif")),
    "view": ("view.png", view),
    **{
        f"stage_{stage}": (f"stage_{stage}.png", functools.partial(segmentation_stages.draw, stage, FOLDER))
        for stage in segmentation_stages.STAGES
    },
    "normals": ("normals.png", normals),
    "curvature": ("curvature.png", lambda: curvature_picture.picture().savefig(FOLDER / "curvature.png", dpi=85)),
    "primitives": ("primitives.png", lambda: primitive_picture.picture().savefig(FOLDER / "primitives.png", dpi=85)),
    **{
        name: (f"{name}.png", _drawing(name, figure))
        for name, figure in (
            ("axes", drawings.axes),
            ("depth_kinds", drawings.depth_kinds),
            ("inverse_depth", drawings.inverse_depth),
            ("paper", drawings.paper),
            ("robustness", drawings.robustness),
        )
    },
}


def main() -> None:
    """Draw all pictures, or those named."""
    parser = argparse.ArgumentParser(prog="python -m bench.pictures", description=__doc__)
    known = [*PICTURES, *OTHERS]
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(known))
    names = parser.parse_args().names
    if unknown := set(names) - set(known):
        parser.error(f"expected of {', '.join(known)}, got {', '.join(sorted(unknown))}")
    for name in names or known:
        if name in PICTURES:
            draw(name)
            print(f"wrote {FOLDER / name}.png")
        else:
            file, work = OTHERS[name]
            work()
            print(f"wrote {FOLDER / file}")


if __name__ == "__main__":
    main()
