"""The command line: ``rgbd-planes demo``, ``fit``, ``segment``, ``normals``, ``batch``.

A command is one function, listed in ``COMMANDS``: it declares its arguments on the parser it is given and
returns what runs them. Its docstring is its help.
"""

import argparse
import inspect
import os
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rgbd_planes import __version__

if TYPE_CHECKING:  # a command imports what it needs when it runs, so that --help is instant
    from rgbd_planes.scenes import Rendering
    from rgbd_planes.tile_planes import TilePlanes

Run = Callable[[argparse.Namespace], int | None]  # what the process exits with, 0 for None


class CommandError(Exception):
    """What the user can mend: one line on stderr."""


def demo(parser: argparse.ArgumentParser) -> Run:
    """Render a room as a Kinect would see it, fit it, and draw what was found; needs no file.

    example: rgbd-planes demo --out pictures
    """
    parser.add_argument("--out", type=Path, default=Path("."), metavar="FOLDER", help="where to write (.)")
    parser.add_argument("--tile", type=_tile, default=(16, 16), metavar="N or HxW", help="tile size (16)")
    parser.add_argument("--seed", type=int, default=1, help="of the noise and the missing pixels (1)")

    def run(arguments: argparse.Namespace) -> None:
        from rgbd_planes import Camera, TileFitter, fit_tiles, scenes
        from rgbd_planes.files import check_writable
        from rgbd_planes.images import write_png

        camera = Camera(width=640, height=480, fx=525.0, fy=525.0, cx=319.5, cy=239.5, depth_scale=1000.0)
        fitter = TileFitter(camera, tile=arguments.tile, max_error=0.03, num_threads=1)
        arguments.out.mkdir(parents=True, exist_ok=True)
        picture, frame_file, camera_file = (
            arguments.out / name for name in ("demo.png", "demo_depth.png", "demo_camera.json")
        )
        for path in (picture, frame_file, camera_file):
            check_writable(path)

        rendering = scenes.room().render(camera)
        depth = rendering.measure(
            holes=0.05, patches=0.03, baseline=scenes.KINECT_BASELINE, seed=arguments.seed
        )
        print(
            f"Rendered a room of {len(rendering.planes)} planes, {camera.width} x {camera.height} pixels, "
            f"Kinect noise, {(depth == 0).mean():.1%} of the pixels missing."
        )

        tiles = fitter.fit(depth)  # compiles, the first time
        milliseconds = 1e3 * _median_seconds(lambda: fitter.fit(depth))
        print(_counts(tiles))
        print(f"One fit takes {milliseconds:.2f} ms (one thread, median of 20).")
        print(_accuracy(tiles, fit_tiles(depth, camera, arguments.tile, "standard_pca"), rendering))

        write_png(frame_file, depth)
        camera.save(camera_file)
        _save_figure(tiles, depth, picture)
        print(f"See {picture}. The same from the files:")
        print(f"  rgbd-planes fit {frame_file} --camera {camera_file} --figure planes.png")

    return run


def fit(parser: argparse.ArgumentParser) -> Run:
    """Fit a plane to every tile of a depth image (PNG, TIFF, PGM, NPY, NPZ).

    example: rgbd-planes fit depth.png --camera camera.json --tile 16 --out planes.npz --figure planes.png
    """
    parser.add_argument("depth", type=Path, help="depth image: integers in the camera's units, or metres")
    parser.add_argument("--camera", type=Path, required=True, metavar="JSON", help="the camera's file")
    _add_fit_options(parser)
    parser.add_argument("--threads", type=int, metavar="N", help="as many as pay, if not given")
    parser.add_argument(
        "--out", type=Path, metavar="NPZ", help="write the planes; TilePlanes.load reads them"
    )
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw depth, normals and tiles")

    def run(arguments: argparse.Namespace) -> None:
        from rgbd_planes import Camera, fit_tiles
        from rgbd_planes.images import read_depth

        _check_output(arguments.out, (".npz",))
        _check_output(arguments.figure, (".png", ".pdf", ".svg"))
        camera = Camera.load(arguments.camera)
        depth = read_depth(arguments.depth)
        tiles = fit_tiles(
            depth,
            camera,
            arguments.tile,
            arguments.method,
            max_missing=arguments.max_missing,
            max_error=arguments.max_error,
            num_threads=arguments.threads,
        )
        print(_counts(tiles))
        if arguments.out is not None:
            tiles.save(arguments.out)
            print(f"Wrote {arguments.out}")
        if arguments.figure is not None:
            _save_figure(tiles, depth, arguments.figure)
            print(f"Wrote {arguments.figure}")

    return run


def segment(parser: argparse.ArgumentParser) -> Run:
    """Find the planes of a depth image and the pixels that belong to each.

    example: rgbd-planes segment depth.png --camera camera.json --out planes.json --labels labels.png
    """
    parser.add_argument("depth", type=Path, help="depth image: integers in the camera's units, or metres")
    parser.add_argument("--camera", type=Path, required=True, metavar="JSON", help="the camera's file")
    parser.add_argument(
        "--noise", type=float, metavar="SIGMA", help="of inverse depth, 1/m; from the frame, if not given"
    )
    parser.add_argument("--min-size", type=int, default=60, metavar="N", help="pixels of a plane (60)")
    parser.add_argument("--out", type=Path, metavar="JSON", help="write the planes")
    parser.add_argument(
        "--polygons", action="store_true", help="with their outlines in the JSON; needs shapely"
    )
    parser.add_argument("--labels", type=Path, metavar="PNG", help="write the labels, 16 bits, 0 for none")
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw the planes over the depth's relief")
    parser.add_argument("--points", type=Path, metavar="PLY", help="write the points, coloured by plane")
    parser.add_argument("--mesh", type=Path, metavar="PLY", help="write the outlines; needs shapely")

    def run(arguments: argparse.Namespace) -> None:
        from rgbd_planes import Camera, plane_polygons, segmentation_export
        from rgbd_planes import segment as segment_depth
        from rgbd_planes.images import read_depth

        _check_output(arguments.out, (".json",))
        _check_output(arguments.labels, (".png",))
        _check_output(arguments.figure, (".png", ".pdf", ".svg"))
        _check_output(arguments.points, (".ply",))
        _check_output(arguments.mesh, (".ply",))
        if arguments.polygons and arguments.out is None:
            raise CommandError("--polygons goes into the JSON: give --out, too")
        camera = Camera.load(arguments.camera)
        depth = read_depth(arguments.depth)
        found = segment_depth(depth, camera, noise=arguments.noise, min_size=arguments.min_size)
        print(f"{len(found)} planes on {found.share:.1%} of the measured pixels.")
        polygons = plane_polygons(found) if arguments.polygons or arguments.mesh else []
        if arguments.out is not None:
            outlines = polygons if arguments.polygons else None
            segmentation_export.write_json(arguments.out, found, outlines)
        if arguments.labels is not None:
            segmentation_export.write_labels(arguments.labels, found)
        if arguments.points is not None:
            segmentation_export.write_points_ply(arguments.points, found, depth)
        if arguments.mesh is not None:
            segmentation_export.write_polygons_ply(arguments.mesh, polygons)
        if arguments.figure is not None:
            _write_figure(found.plot(depth).figure, arguments.figure)
        for path in (arguments.out, arguments.labels, arguments.points, arguments.mesh, arguments.figure):
            if path is not None:
                print(f"Wrote {path}")

    return run


def batch(parser: argparse.ArgumentParser) -> Run:
    """Fit every frame of a data set or a recording into a Parquet table, one row a tile or a segment.

    example: rgbd-planes batch rgbd_dataset_freiburg1_xyz --out planes.parquet --tile 16

    After an interruption the same command does the rest. A frame that cannot be read or fitted is reported
    and skipped, and makes the exit status 1.
    """
    parser.add_argument("sequence", type=Path, help="data set, folder of depth images, or recording")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="the table, many files")
    parser.add_argument("--camera", type=Path, metavar="JSON", help="instead of the sequence's own camera")
    parser.add_argument(
        "--format",
        metavar="NAME",
        help="if it is not recognised: arkitscenes, folder, icl_nuim, mkv, rosbag, scannet, scannet_sens, "
        "seven_scenes, tum",
    )
    parser.add_argument("--topic", help="of a ROS bag, if it has several with depth")
    parser.add_argument(
        "--segments", action="store_true", help="one row a segment, not a tile; no options of tiles"
    )
    _add_fit_options(parser)
    parser.add_argument(
        "--noise",
        choices=("kinect_v1", "kinect_v1_nguyen"),
        help="of the sensor: adds covariances and p-values",
    )
    parser.add_argument("--threads", type=int, metavar="N", help="one for each core, if not given")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster: tcp://host:port")

    def run(arguments: argparse.Namespace) -> int:
        from rgbd_planes import Camera, FitSettings, fit_sequence, noise, open_sequence, sequences
        from rgbd_planes.batch import Progress
        from rgbd_planes.extras import needs

        with needs("tqdm", "batch"):
            from tqdm import tqdm
        camera = None if arguments.camera is None else Camera.load(arguments.camera)
        if arguments.topic is None:
            sequence = open_sequence(arguments.sequence, camera, arguments.format)
        else:
            sequence = sequences.rosbag(arguments.sequence, camera, arguments.topic)
        if arguments.noise is not None:
            sequence = sequence.with_noise(getattr(noise, arguments.noise)())
        settings = FitSettings(
            segments=arguments.segments,
            tile=arguments.tile,
            method=arguments.method,
            max_missing=arguments.max_missing,
            max_error=arguments.max_error,
        )
        bar = tqdm(total=len(sequence), unit="frame", disable=None)  # None: not where nobody looks

        def progress(done: Progress) -> None:
            for problem in done.problems:
                line = f"rgbd-planes batch: skipped frame {problem.frame}, {problem.name}: {problem.reason}"
                bar.write(line, file=sys.stderr)
            bar.update(done.frames)

        try:
            with bar:
                report = fit_sequence(
                    sequence,
                    arguments.out,
                    settings,
                    num_threads=arguments.threads,
                    scheduler=arguments.scheduler,
                    progress=progress,
                )
        except KeyboardInterrupt:
            print("rgbd-planes batch: stopped; the same command does the rest", file=sys.stderr)
            raise
        rows = ", ".join(f"{count} {status}" for status, count in report.status.items())
        print(
            f"{report.frames - len(report.problems)} of {report.frames} frames, {report.rows} rows: {rows}."
        )
        if report.resumed:
            print(f"{report.resumed} frames had been done before.")
        total = sum(report.seconds.values())
        if total > 0.0:
            shares = ", ".join(f"{work} {seconds / total:.0%}" for work, seconds in report.seconds.items())
            print(f"Of the work: {shares}.")
        print(f"Wrote {report.out}, a folder that pandas.read_parquet reads as one table.")
        if report.problems:
            print(f"Skipped {len(report.problems)} of {report.frames} frames.", file=sys.stderr)
        return 1 if report.problems else 0

    return run


def normals(parser: argparse.ArgumentParser) -> Run:
    """Compute the normal at every pixel of a depth image.

    example: rgbd-planes normals depth.png --camera camera.json --window 7 --out normals.npy --figure normals.png
    """
    parser.add_argument("depth", type=Path, help="depth image: integers in the camera's units, or metres")
    parser.add_argument("--camera", type=Path, required=True, metavar="JSON", help="the camera's file")
    parser.add_argument("--window", type=int, default=7, metavar="N", help="odd, 3 to 31 pixels (7)")
    parser.add_argument(
        "--avoid-edges", action="store_true", help="move windows that an edge runs through off it"
    )
    parser.add_argument(
        "--max-missing",
        type=float,
        default=0.5,
        metavar="SHARE",
        help="of a window that may be missing (0.5)",
    )
    parser.add_argument("--threads", type=int, metavar="N", help="as many as pay, if not given")
    parser.add_argument("--out", type=Path, metavar="NPY", help="write them, (H, W, 3) float32")
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw depth, normals and curvature")

    def run(arguments: argparse.Namespace) -> None:
        import numpy as np

        import rgbd_planes as rp
        from rgbd_planes.files import write_beside
        from rgbd_planes.images import read_depth

        _check_output(arguments.out, (".npy",))
        _check_output(arguments.figure, (".png", ".pdf", ".svg"))
        camera = rp.Camera.load(arguments.camera)
        depth = read_depth(arguments.depth)
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
            f"normals at {share:.1%} of the pixels."
        )
        if arguments.out is not None:
            with write_beside(arguments.out) as beside, open(beside, "wb") as file:
                np.save(file, found)
            print(f"Wrote {arguments.out}")
        if arguments.figure is not None:
            from rgbd_planes.surface_plots import plot_surfaces

            curvature = rp.curvature(depth, camera, arguments.window, **options)
            figure = plot_surfaces(depth, camera, found, curvature)
            with write_beside(arguments.figure) as beside:
                figure.savefig(beside, dpi=120)
            print(f"Wrote {arguments.figure}")

    return run


COMMANDS = (demo, fit, segment, normals, batch)


def main(argv: list[str] | None = None) -> int:
    """Run a command; what goes wrong is one line on stderr.

    Returns
    -------
    int
        0; 1 if frames of a batch were skipped; 2 after an error.
    """
    parser = _Parser(
        prog="rgbd-planes",
        description="Fit planes to depth images.",
        epilog="rgbd-planes COMMAND --help tells more",
    )
    parser.add_argument("--version", action="version", version=__version__)
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for command in COMMANDS:
        summary, _, example = inspect.cleandoc(command.__doc__ or "").partition("\n")
        subparser = subparsers.add_parser(
            command.__name__,
            help=summary,
            description=summary,
            epilog=example.strip(),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        subparser.set_defaults(run=command(subparser))
    arguments = parser.parse_args(argv)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"PIL\.")  # of a damaged file, the error says enough
            warnings.showwarning = _show_each_once()
            status: int | None = arguments.run(arguments)
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of a pipe has left: nothing more to say, and no noise at exit
        status = 0
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (CommandError, ModuleNotFoundError, OSError, TypeError, ValueError) as error:
        print(f"rgbd-planes {arguments.command}: {_one_line(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return status or 0


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def _add_fit_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--tile", type=_tile, default=(16, 16), metavar="N or HxW", help="tile size (16)")
    parser.add_argument(
        "--method",
        default="range_explicit",
        metavar="NAME",
        help="range_explicit (default), range_implicit, standard_explicit, standard_implicit, standard_pca",
    )
    parser.add_argument(
        "--max-missing", type=float, default=0.5, metavar="SHARE", help="fit no tile that misses more (0.5)"
    )
    parser.add_argument(
        "--max-error", type=float, metavar="METRES", help="call a tile with a larger residual rough"
    )


def _tile(text: str) -> tuple[int, int]:
    """Parse "16", or "12x20" for a height of 12."""
    try:
        height, _, width = text.partition("x")
        return int(height), int(width or height)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a size such as 16 or 12x20, got {text!r}") from None


def _check_output(path: Path | None, suffixes: tuple[str, ...]) -> None:
    """Refuse now what could not be written after the work."""
    from rgbd_planes.files import check_writable

    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise CommandError(f"{path}: expected a name that ends in {' or '.join(suffixes)}")
    check_writable(path)


def _save_figure(tiles: "TilePlanes", depth: Any, path: Path) -> None:
    _write_figure(tiles.plot(depth), path)


def _write_figure(figure: Any, path: Path) -> None:
    from rgbd_planes.files import write_beside

    with write_beside(path) as beside:
        figure.savefig(beside, dpi=120)


def _counts(tiles: "TilePlanes") -> str:
    import numpy as np

    from rgbd_planes import TileStatus

    height, width = tiles.tile
    counts = {status: np.count_nonzero(tiles.status == status) for status in TileStatus}
    found = ", ".join(f"{count} {status.name}" for status, count in counts.items() if count)
    line = f"{tiles.status.size} tiles of {height} x {width} pixels by {tiles.method}: {found}"
    if tiles.fitted.any():
        line += (
            f"; median residual {1e3 * np.median(tiles.rmse_metric[tiles.fitted]):.1f} mm along the normal"
        )
    else:
        measured = tiles.valid_count.sum() / (tiles.camera.width * tiles.camera.height)
        line += f"; {measured:.0%} of the pixels are measured"
    return line + "."


def _accuracy(tiles: "TilePlanes", usual: "TilePlanes", rendering: "Rendering") -> str:
    """A table of the errors of the tiles that see one plane, for the largest planes and for all."""
    import numpy as np

    def line(name: str, fits: "TilePlanes", chosen: Any) -> str:
        truth = rendering.planes[labels[chosen] - 1]
        # Of small angles the cosine loses digits, the chord does not.
        chord = np.linalg.norm(fits.planes[chosen][:, :3] - truth[:, :3], axis=-1)
        angle = np.degrees(2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0)))
        offset = 1e3 * np.abs(fits.planes[chosen][:, 3] - truth[:, 3])
        return f"  {name:<22}{len(truth):>6}{np.median(angle):>13.2f}°{np.median(offset):>13.1f} mm"

    labels = np.where(tiles.fitted & usual.fitted, rendering.tile_labels(tiles.tile), 0)
    sizes = np.bincount(labels.ravel(), minlength=len(rendering.planes) + 1)[1:]
    largest = [i for i in np.argsort(-sizes, kind="stable")[:6] if sizes[i] > 0]
    if not largest:
        return "No tile sees one plane alone: nothing to compare with the truth."
    return "\n".join(
        [
            "Against the truth, medians over the tiles that see one plane:",
            f"  {'plane':<22}{'tiles':>6}{'normal off':>14}{'distance off':>16}",
            *(line(rendering.names[i], tiles, labels == i + 1) for i in largest),
            line("all", tiles, labels > 0),
            line(f"all, by {usual.method}", usual, labels > 0),
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


def _show_each_once() -> Callable[..., None]:
    """Shows a warning; what two steps of a command have to say, only once."""
    shown: set[str] = set()

    def show(message: Warning | str, *where: object, **more: object) -> None:
        text = _one_line(message)
        if text not in shown:
            shown.add(text)
            print(f"rgbd-planes: warning: {text}", file=sys.stderr)

    return show


def _one_line(message: object) -> str:
    """The text of an error: of the system's own, the file and the reason without the number."""
    if isinstance(message, OSError) and message.strerror is not None:
        message = f"{message.filename}: {message.strerror}" if message.filename else message.strerror
    return " ".join(str(message).split())
