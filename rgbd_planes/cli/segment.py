"""``rgbd-planes segment``."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rgbd_planes._core.text import shown
from rgbd_planes.cli.arguments import (
    FIGURES,
    CommandError,
    Run,
    add_frame,
    add_min_size,
    add_noise,
    check_outputs,
    read_frame,
    write_figure,
)

if TYPE_CHECKING:
    from rgbd_planes import PrimitiveFits, Segmentation

_SHOWN = 5  # planes


def segment(parser: argparse.ArgumentParser) -> Run:
    """Find the planes of a depth image and the pixels that belong to each.

    example: rgbd-planes segment depth.png --camera camera.json --out planes.json
    """
    add_frame(parser)
    add_noise(parser, "without either, it is estimated from the frame", number_is_model=False)
    add_min_size(parser)
    parser.add_argument(
        "--out", type=Path, metavar="JSON/NPZ", help="write the planes; Segmentation.load reads an NPZ, labels included"
    )
    parser.add_argument("--polygons", action="store_true", help="add the outlines to the JSON; needs shapely")
    parser.add_argument(
        "--primitives",
        action="store_true",
        help="fit spheres and cylinders to the curved surfaces: adds them to the JSON and the figure",
    )
    parser.add_argument("--labels", type=Path, metavar="PNG", help="write the labels, 16 bits, 0 for none")
    parser.add_argument("--figure", type=Path, metavar="PNG/PDF/SVG", help="draw the planes over the depth's relief")
    parser.add_argument("--points", type=Path, metavar="PLY", help="write the points, coloured by plane")
    parser.add_argument("--mesh", type=Path, metavar="PLY", help="write the outlines as a mesh; needs shapely")

    def run(arguments: argparse.Namespace) -> int:
        from rgbd_planes import fit_primitives, plane_polygons
        from rgbd_planes import segment as segment_depth
        from rgbd_planes._core.optional_imports import needs
        from rgbd_planes.export import primitives as primitive_export
        from rgbd_planes.export import segments as export
        from rgbd_planes.export.json_files import write_json_file

        check_outputs(
            arguments,
            (arguments.depth, arguments.camera),
            out=(".json", ".npz"),
            labels=(".png",),
            figure=FIGURES,
            points=(".ply",),
            mesh=(".ply",),
        )
        if arguments.polygons and (arguments.out is None or arguments.out.suffix.lower() != ".json"):
            raise CommandError("--polygons goes into the JSON: give --out with a name that ends in .json")
        outlined = arguments.polygons or arguments.mesh is not None
        if outlined:
            with needs("shapely", "polygons"):
                import shapely  # noqa: F401 (now, not after the work)
        depth, camera, status = read_frame(arguments)
        found = segment_depth(depth, camera, noise=arguments.noise, min_size=arguments.min_size)
        print(f"{found._summary}.")
        if len(found):
            print(_largest(found))
        primitives = None
        if arguments.primitives:
            primitives = fit_primitives(depth, camera, found.curved_labels, noise=arguments.noise)
            print(_round(primitives))
        polygons = plane_polygons(found) if outlined else []
        if arguments.out is not None and arguments.out.suffix.lower() == ".npz":
            found.save(arguments.out)
        elif arguments.out is not None:
            content = export.to_dict(found, polygons if arguments.polygons else None)
            if primitives is not None:
                content["primitives"] = primitive_export.to_dict(primitives)["primitives"]
            write_json_file(arguments.out, content)
        if arguments.labels is not None:
            export.write_labels(arguments.labels, found)
        if arguments.points is not None:
            export.write_points_ply(arguments.points, found, depth)
        if arguments.mesh is not None:
            export.write_polygons_ply(arguments.mesh, polygons)
        if arguments.figure is not None:
            write_figure(found.plot(depth, primitives=primitives), arguments.figure)
        for path in (arguments.out, arguments.labels, arguments.points, arguments.mesh, arguments.figure):
            if path is not None:
                print(f"Wrote {shown(path)}")
        return status

    return run


def _largest(found: "Segmentation") -> str:
    """A table of the largest planes."""
    import numpy as np

    from rgbd_planes._core.text import two_digits

    lines = ["The largest, with nx X + ny Y + nz Z + d = 0:"]
    lines.append(
        f"label {'pixels':>8} {'nx':>7} {'ny':>7} {'nz':>7} {'d, m':>8} {'std n, degrees':>15} {'std d, mm':>10}"
    )
    for i in np.argsort(-found.sizes, kind="stable")[:_SHOWN]:
        nx, ny, nz, d = found.planes[i]
        lines.append(
            f"{i + 1:5} {found.sizes[i]:8} {nx:7.3f} {ny:7.3f} {nz:7.3f} {d:8.4g} "
            f"{two_digits(found.angle_std[i]):>15} {two_digits(1e3 * found.offset_std[i]):>10}"
        )
    return "\n".join(lines)


def _round(primitives: "PrimitiveFits") -> str:
    """A table of the largest spheres and cylinders."""
    import numpy as np

    from rgbd_planes import Primitive
    from rgbd_planes._core.text import counted, two_digits

    sizes, is_round = primitives.sizes, primitives.kind >= Primitive.SPHERE
    lines = [f"{counted(len(primitives), 'curved surface')}, {int(is_round.sum())} of them spheres and cylinders."]
    if is_round.any():
        lines.append(
            f"label {'pixels':>8} {'kind':>9} {'x, m':>7} {'y, m':>7} {'z, m':>7} {'radius, mm':>11} {'std, mm':>8}"
        )
    for k in np.argsort(-sizes * is_round, kind="stable")[: min(_SHOWN, is_round.sum())]:
        x, y, z = primitives.centre[k]
        lines.append(
            f"{k + 1:5} {sizes[k]:8} {Primitive(primitives.kind[k]).name.lower():>9} {x:7.3f} {y:7.3f} {z:7.3f} "
            f"{1e3 * primitives.radius[k]:11.5g} {two_digits(1e3 * primitives.radius_std[k]):>8}"
        )
    return "\n".join(lines)
