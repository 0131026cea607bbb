"""``rgbd-planes demo``."""

import argparse
import os
import shlex
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rgbd_planes._core.text import percent, shown
from rgbd_planes.cli.arguments import Run, describe_tiles, tile_size, write_figure

if TYPE_CHECKING:
    from rgbd_planes.evaluation.scenes import Rendering
    from rgbd_planes.fitting.tile_planes import TilePlanes


def demo(parser: argparse.ArgumentParser) -> Run:
    """Render a room as a Kinect would see it, fit it, and draw what was found; needs no file.

    example: rgbd-planes demo --out pictures
    """
    parser.add_argument(
        "--out", type=Path, default=Path("."), metavar="FOLDER", help="where to write (the current folder)"
    )
    parser.add_argument(
        "--tile", type=tile_size, default=(16, 16), metavar="N or HxW", help="size of a tile in pixels (16)"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the noise and the missing pixels (1)")

    def run(arguments: argparse.Namespace) -> None:
        import numpy as np

        from rgbd_planes import Camera, TileFitter, noise
        from rgbd_planes._core.files import check_folder_name, check_writable
        from rgbd_planes.evaluation import scenes
        from rgbd_planes.sequences.images import write_png

        camera = Camera(
            width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5, depth_scale=1000.0,
            noise=noise.kinect_v1(),
        )  # fmt: skip
        check_folder_name(arguments.out, "the files")
        fitter = TileFitter(camera, tile=arguments.tile, num_threads=1)
        rendering = scenes.room().render(camera)
        depth = rendering.measure(holes=0.05, patches=0.03, baseline=scenes.KINECT_BASELINE, seed=arguments.seed)
        arguments.out.mkdir(parents=True, exist_ok=True)
        picture, frame_file, camera_file = (
            arguments.out / name for name in ("demo.png", "demo_depth.png", "demo_camera.json")
        )
        for path in (picture, frame_file, camera_file):
            check_writable(path)

        print(
            f"Rendered a room of {len(rendering.planes)} planes, {camera.width} x {camera.height} pixels, "
            f"Kinect noise, {percent(np.mean(depth == 0))} of the pixels missing."
        )

        tiles = fitter.fit(depth)  # compiles, the first time
        milliseconds = 1e3 * _median_seconds(lambda: fitter.fit(depth))
        print(describe_tiles(tiles))
        print("ROUGH are those with a residual that the noise explains less than once in a hundred times: edges.")
        print(f"One fit takes {milliseconds:.2f} ms (one thread, median of 20).")
        print(_accuracy(tiles, rendering))

        write_png(frame_file, depth)
        camera.save(camera_file)
        write_figure(tiles.plot(depth), picture)
        print(f"See {shown(picture)}. The same from the files:")
        size = "x".join(map(str, tiles.tile))
        options = f"--tile {size} --figure planes.png"
        frame_text, camera_text = (shown(shlex.quote(os.fspath(file))) for file in (frame_file, camera_file))
        print(f"  rgbd-planes fit {frame_text} --camera {camera_text} {options}")

    return run


def _accuracy(tiles: "TilePlanes", rendering: "Rendering") -> str:
    """A table of the errors of the tiles that see one plane, for the largest planes and for all."""
    import numpy as np

    from rgbd_planes.evaluation.metrics import plane_errors

    # One pixel of each tile: a ragged one may end before the middle of a whole one.
    rows, columns = (np.cumsum(sides) - (sides + 1) // 2 for sides in (tiles.tile_heights, tiles.tile_widths))
    x, y = (table[np.ix_(rows, columns)] for table in (rendering.camera.tan_x, rendering.camera.tan_y))

    def line(name: str, chosen: Any) -> str:
        truth, found = rendering.planes[labels[chosen] - 1], tiles.planes[chosen]
        rays = np.stack([x[chosen], y[chosen], np.ones(len(truth))], axis=1)
        surface = rays * (-truth[:, 3] / np.sum(truth[:, :3] * rays, axis=1))[:, None]
        off = np.abs(np.sum(found[:, :3] * surface, axis=1) + found[:, 3])
        angle = np.median(plane_errors(found, truth).angle_deg)
        return f"  {name:<22}{len(truth):>6}{angle:>13.2f}°{1e3 * np.median(off):>14.2f} mm"

    labels = np.where(tiles.fitted, rendering.tile_labels(tiles.tile), 0)
    sizes = np.bincount(labels.ravel(), minlength=len(rendering.planes) + 1)[1:]
    largest = [i for i in np.argsort(-sizes, kind="stable")[:6] if sizes[i] > 0]
    if not largest:
        return "No tile sees one plane alone: nothing to compare with the truth."
    return "\n".join(
        [
            "Against the truth, medians over the tiles that see one plane; the surface in the middle of the tile:",
            f"  {'plane':<22}{'tiles':>6}{'normal off':>14}{'surface off':>17}",
            *(line(rendering.names[i], labels == i + 1) for i in largest),
            line("all", labels > 0),
            "  (the noise is independent between pixels, the ideal case for a fit of 1/Z)",
        ]
    )


def _median_seconds(work: Callable[[], object], repeats: int = 20) -> float:
    import statistics

    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)
