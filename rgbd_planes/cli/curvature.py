"""``rgbd-planes curvature``."""

import argparse
from collections.abc import Mapping
from pathlib import Path

from rgbd_planes._core.text import percent, two_digits
from rgbd_planes.cli.arguments import (
    FIGURES,
    Run,
    add_frame,
    add_limits,
    add_noise,
    check_outputs,
    read_frame,
    tile_size,
    write_figure,
)


def curvature(parser: argparse.ArgumentParser) -> Run:
    """Fit a surface of second order to every tile of a depth image: normals and curvatures.

    example: rgbd-planes curvature depth.png --camera camera.json --figure bent.png
    """
    add_frame(parser)
    parser.add_argument(
        "--tile", type=tile_size, default=(24, 24), metavar="N or HxW", help="size of a tile in pixels (24)"
    )
    add_limits(parser)
    add_noise(parser, "says which tiles are curved, and how exactly that is known")
    parser.add_argument("--threads", type=int, metavar="N", help="number of threads (as many as pay)")
    parser.add_argument(
        "--out", type=Path, metavar="NPZ/CSV", help="write the surfaces; TileSurfaces.load reads an NPZ"
    )
    parser.add_argument("--figure", type=Path, metavar="PNG/PDF/SVG", help="draw depth, normals and mean curvature")

    def run(arguments: argparse.Namespace) -> int:
        import numpy as np

        from rgbd_planes import TileStatus, fit_surfaces

        check_outputs(arguments, (arguments.depth, arguments.camera), out=(".npz", ".csv"), figure=FIGURES)
        depth, camera, status = read_frame(arguments)
        if arguments.noise is not None:
            camera = camera.with_noise(arguments.noise)
        surfaces = fit_surfaces(
            depth,
            camera,
            arguments.tile,
            max_missing=arguments.max_missing,
            max_error=arguments.max_error,
            significance=arguments.significance,
            num_threads=arguments.threads,
        )
        rows, columns = surfaces.shape
        counts = ", ".join(
            f"{np.count_nonzero(surfaces.status == kind)} {kind.name}"
            for kind in TileStatus
            if (surfaces.status == kind).any()
        )
        print(f"{rows} x {columns} tiles of {surfaces.tile[0]} x {surfaces.tile[1]} pixels: {counts}.")
        if surfaces.fitted.any():
            mean = surfaces.mean_curvature[surfaces.fitted]
            if camera.noise is None:
                print(
                    f"Mean curvature: median {two_digits(float(np.median(np.abs(mean))))} 1/m either way. Which tiles "
                    f"are curved, a noise model tells: --noise."
                )
            else:
                curved = surfaces.p_flat[surfaces.fitted] < 0.01
                deviation = two_digits(float(np.median(surfaces.mean_curvature_std[surfaces.fitted])))
                text = f"Curved (p < 0.01): {percent(curved.mean())} of the surfaces; mean curvature is known to "
                print(f"{text}{deviation} 1/m (median).")
                if arguments.noise is not None:
                    print("Pixels that err alike make flat tiles look curved: rgbd-planes noise finds how they do.")
        if arguments.out is not None:
            if arguments.out.suffix.lower() == ".csv":
                _write_csv(arguments.out, surfaces.to_table())
            else:
                surfaces.save(arguments.out)
            print(f"Wrote {arguments.out}")
        if arguments.figure is not None:
            write_figure(surfaces.plot(depth), arguments.figure)
            print(f"Wrote {arguments.figure}")
        return status

    return run


def _write_csv(path: Path, table: "Mapping[str, object]") -> None:
    """Write a table whole or not at all."""
    import csv

    import numpy as np

    from rgbd_planes._core.files import write_beside

    with write_beside(path) as beside, open(beside, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*(np.asarray(column).tolist() for column in table.values()), strict=True))
