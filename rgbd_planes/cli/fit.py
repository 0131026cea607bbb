"""``rgbd-planes fit``."""

import argparse
from pathlib import Path

from rgbd_planes._core.text import shown
from rgbd_planes.cli.arguments import (
    FIGURES,
    Run,
    add_fit_options,
    add_frame,
    add_noise,
    check_outputs,
    describe_tiles,
    read_frame,
    write_figure,
)


def fit(parser: argparse.ArgumentParser) -> Run:
    """Fit a plane to every tile of a depth image (PNG, TIFF, PGM, PFM, NPY, NPZ).

    example: rgbd-planes fit depth.png --camera camera.json --figure planes.png
    """
    add_frame(parser)
    add_fit_options(parser)
    add_noise(parser, "calls tiles ROUGH that it does not explain, and gives the files covariances and p-values")
    parser.add_argument("--threads", type=int, metavar="N", help="number of threads (as many as pay)")
    parser.add_argument("--out", type=Path, metavar="NPZ/JSON", help="write the planes; TilePlanes.load reads an NPZ")
    parser.add_argument("--figure", type=Path, metavar="PNG/PDF/SVG", help="draw depth, normals and tiles")

    def run(arguments: argparse.Namespace) -> int:
        from rgbd_planes import fit_tiles
        from rgbd_planes.export.exchange import write_csv
        from rgbd_planes.export.tiles import write_json

        check_outputs(arguments, (arguments.depth, arguments.camera), out=(".npz", ".json", ".csv"), figure=FIGURES)
        depth, camera, status = read_frame(arguments)
        if arguments.noise is not None:
            camera = camera.with_noise(arguments.noise)
        tiles = fit_tiles(
            depth,
            camera,
            arguments.tile,
            arguments.method,
            max_missing=arguments.max_missing,
            max_error=arguments.max_error,
            significance=arguments.significance,
            num_threads=arguments.threads,
        )
        print(describe_tiles(tiles))
        if camera.noise is None and arguments.max_error is None and tiles.fitted.any():
            print("Without the sensor's noise, tiles across edges are OK, too: rgbd-planes noise finds it.")
        if arguments.out is not None:
            if arguments.out.suffix.lower() == ".json":
                write_json(arguments.out, tiles)
            elif arguments.out.suffix.lower() == ".csv":
                write_csv(arguments.out, tiles.to_table())
            else:
                tiles.save(arguments.out)
            print(f"Wrote {shown(arguments.out)}")
        if arguments.figure is not None:
            write_figure(tiles.plot(depth), arguments.figure)
            print(f"Wrote {shown(arguments.figure)}")
        return status

    return run
