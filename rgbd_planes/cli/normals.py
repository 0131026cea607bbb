"""``rgbd-planes normals``."""

import argparse
from pathlib import Path

from rgbd_planes._core.text import percent, shown
from rgbd_planes.cli.arguments import FIGURES, Run, add_frame, add_max_missing, check_outputs, read_frame, write_figure


def normals(parser: argparse.ArgumentParser) -> Run:
    """Compute the normal at every pixel of a depth image.

    example: rgbd-planes normals depth.png --camera camera.json --out normals.npy
    """
    add_frame(parser)
    parser.add_argument(
        "--window", type=int, default=7, metavar="N", help="side of the window in pixels: odd, 3 to 31 (7)"
    )
    parser.add_argument(
        "--avoid-edges",
        action="store_true",
        help="use a window beside an edge for pixels whose own window it runs through",
    )
    add_max_missing(parser, "window")
    parser.add_argument("--threads", type=int, metavar="N", help="number of threads (as many as pay)")
    parser.add_argument(
        "--out", type=Path, metavar="NPY/PNG/TIF", help="write the normals: (H, W, 3) float32, or as colours"
    )
    parser.add_argument("--figure", type=Path, metavar="PNG/PDF/SVG", help="draw depth, normals and curvature")

    def run(arguments: argparse.Namespace) -> int:
        import numpy as np

        import rgbd_planes as rp
        from rgbd_planes.export.exchange import write_normals

        check_outputs(
            arguments, (arguments.depth, arguments.camera), out=(".npy", ".png", ".tif", ".tiff"), figure=FIGURES
        )
        depth, camera, status = read_frame(arguments)
        options = {
            "avoid_edges": arguments.avoid_edges,
            "max_missing": arguments.max_missing,
            "num_threads": arguments.threads,
        }
        found = rp.normals(depth, camera, arguments.window, **options)
        share = np.isfinite(found[..., 0]).mean()
        height, width = camera.shape
        print(
            f"{width} x {height} pixels, windows of {arguments.window} x {arguments.window}: "
            f"normals at {percent(share)} of the pixels."
        )
        if arguments.out is not None:
            write_normals(arguments.out, found)
            print(f"Wrote {shown(arguments.out)}")
        if arguments.figure is not None:
            from rgbd_planes.plotting.normals import plot_normals

            curvature = rp.curvature(depth, camera, arguments.window, **options)
            figure = plot_normals(depth, camera, found, curvature, avoid_edges=arguments.avoid_edges)
            write_figure(figure, arguments.figure)
            print(f"Wrote {shown(arguments.figure)}")
        return status

    return run
