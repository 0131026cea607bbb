"""Planes of the depth images that another program writes into a folder, live: ``python examples/folder.py FOLDER``.

Needs ``pip install "rgbd-planes[viewer]"``, and ``camera.json`` in the folder or by ``--camera``. Ctrl-C ends it.
"""

import argparse
import time
from pathlib import Path

import rgbd_planes as rp

SUFFIXES = {".png", ".tif", ".tiff", ".pgm", ".pfm", ".npy", ".npz"}
PATIENCE = 2.0  # seconds: a file that cannot be read by then is no depth image


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--camera", type=Path, metavar="JSON", help="the camera, if not FOLDER/camera.json")
    parser.add_argument("--show", default="window", metavar="WHERE", help="window, browser, or a file PLANES.rrd")
    options = parser.parse_args(arguments)

    try:
        camera = rp.Camera.load(options.camera or options.folder / "camera.json")
    except (OSError, ValueError) as error:
        parser.error(str(error))
    rp.warmup(camera, segment=True)  # compiles, once for an installation
    tracker = rp.PlaneTracker()
    try:
        with rp.LiveView(options.show) as view:
            for path, depth in new_images(options.folder):
                found = tracker.follow(rp.segment(depth, camera))
                view.show(depth, camera, found, timestamp=path.stat().st_mtime)
    except KeyboardInterrupt:
        pass


def new_images(folder: Path):
    """Path and content of each image that is new or written again, as soon as it is whole; without end."""
    done: dict[Path, int] = {}  # when each was written
    waiting: dict[Path, float] = {}  # since when each cannot be read
    while True:
        for path in sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES):
            written = path.stat().st_mtime_ns
            if done.get(path) == written:
                continue
            try:
                depth = rp.images.read_depth(path)
            except (OSError, ValueError) as error:  # perhaps only half of it is there
                if time.monotonic() - waiting.setdefault(path, time.monotonic()) < PATIENCE:
                    continue
                print(f"skipped {path}: {error}")
            else:
                yield path, depth
            done[path] = written
            waiting.pop(path, None)
        time.sleep(0.02)


if __name__ == "__main__":
    main()
