"""Estimated noise against real frames: ``python -m bench.uncertainty real``."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rgbd_planes as rp
from bench.real_data import FOLDER as DATA
from bench.real_data import needed
from rgbd_planes.camera.depth_frame import as_depth_frame
from rgbd_planes.camera.pixel_pitch import slope_square
from rgbd_planes.fitting.tile_grid import tile_footprints, tile_rays
from rgbd_planes.noise_estimation.samples import mean_depth
from rgbd_planes.sequences.images import read_depth

FEWEST_TILES, FEWEST_ANGLES = 300, 50  # to say what share of them is rejected; how large their angles are
SQUARE = 192  # pixels: the side of the squares into which a single frame is cut
RINGS = ("centre", "middle", "edge")
"""Of the image: equally many tiles are nearest to its middle, farthest from it, and in between."""
WITH_RINGS = ("azure_kinect_nfov", "kinect1_7scenes_seq")
APART = (4, 16)  # pixels from a labelled plane's border, between which tiles are told apart


@dataclass(frozen=True)
class RealSet:
    """Frames of one sensor in two halves, and which pixels of the second are known to be flat."""

    name: str
    camera: rp.Camera
    first: list[NDArray[Any]]
    second: list[NDArray[Any]]
    labels: list[NDArray[Any] | None]


SETS = {
    "kinect1_7scenes_seq": "Kinect v1, 7-Scenes",
    "tum_fr2_distorted": "Kinect v1, TUM fr2",
    "primesense_open3d_rgbd": "PrimeSense",
    "realsense_d4xx_aligned_office": "RealSense D4xx",
    "abw_segcomp_cal0": "ABW, calibration 0, labelled",
    "abw_segcomp_cal1": "ABW, calibration 1, labelled",
    "azure_kinect_nfov": "Azure Kinect, depth camera, one frame",
    "azure_kinect_color_1280x720": "Azure Kinect, in the colour camera, one frame",
    "lingbot_active_stereo_a": "active stereo, two frames, resampled",
}
KINECTS = ("kinect1_7scenes_seq", "tum_fr2_distorted")


def real_sets() -> list[RealSet]:
    """The sets of the data folder that are of a real sensor and in metres; each once in either direction."""
    needed(SETS)
    sets = []
    for folder in SETS:
        camera = rp.Camera.load(DATA / folder / "camera.json")
        paths = sorted((DATA / folder / "depth").glob("*.png"))
        frames = [read_depth(path) for path in paths]
        labels = [labels_of(path) for path in paths]
        if len(frames) == 1:
            # Squares of the one frame, as on a chessboard.
            row, column = np.indices(camera.shape) // SQUARE
            halves = [[np.where((row + column) % 2 == i, frames[0], 0).astype(frames[0].dtype)] for i in (0, 1)]
            of: list[list[NDArray[Any] | None]] = [[None], [None]]
        else:
            halves, of = [frames[::2], frames[1::2]], [labels[::2], labels[1::2]]
        for i in (0, 1):
            sets.append(RealSet(folder, camera, halves[i], halves[1 - i], of[1 - i]))
    return sets


def labels_of(path: Path) -> NDArray[Any] | None:
    """The labels of a depth image of a set, if it has any."""
    labels = path.parents[1] / "labels" / path.name
    return read_depth(labels) if labels.exists() else None


def flat_regions(depth: NDArray[Any], camera: rp.Camera, labels: NDArray[Any] | None) -> NDArray[np.int64]:
    """(H, W) int64: flat parts of a frame, from 1; 0 elsewhere.

    The labelled planes; or else windows of 64x64 pixels, at least nine tenths valid, in which no block of 8x8
    pixels leaves the window's plane by more than one per cent of its distance: what a person would call flat.
    """
    if labels is not None:
        return labels.astype(np.int64)
    side, block = 64, 8
    tiles = rp.fit_tiles(depth, camera, side, max_missing=0.1)
    q = as_depth_frame(depth, camera).inverse_depth
    regions = np.zeros(camera.shape, np.int64)
    for row, column in np.argwhere(tiles.fitted):
        part = np.s_[row * side : (row + 1) * side, column * side : (column + 1) * side]
        if q[part].shape != (side, side):
            continue
        a, b, c = tiles.alpha[row, column]
        residual = (q[part] / (a * camera.tan_x[part] + b * camera.tan_y[part] + c) - 1.0).reshape(
            side // block, block, side // block, block
        )
        enough = np.isfinite(residual).sum(axis=(1, 3)) >= 16
        mean = np.nansum(residual, axis=(1, 3)) / np.maximum(np.isfinite(residual).sum(axis=(1, 3)), 1)
        if enough.all() and np.abs(mean).max() < 0.01:
            regions[part] = 1 + row * tiles.shape[1] + column
    return regions


@dataclass(frozen=True)
class RealResult:
    """Of the second half's flat tiles of one size, by the noise of the first."""

    tiles: int
    angles: int
    rejected: float
    rejected_thousandth: float
    rejected_independent: float
    angle: float
    """Predicted over observed rms angle to the whole flat part, of the tiles that are not rejected."""
    angle_of_all: float
    rings: tuple[tuple[float, float], ...] = ()
    """Of each of `RINGS`: the root mean square residual over the model's, and the share that is rejected."""
    images: tuple[tuple[int, int], ...] = ()
    """Of each image, or square of a single one: tiles, and how many are rejected."""
    borders: tuple[float, ...] = ()
    """Shares of labelled tiles that are rejected: nearer to the border than `APART`, between these, and farther."""


def from_border(labels: NDArray[np.int64]) -> NDArray[np.float64]:
    """(H, W) float64: distance of each pixel from the next one that has another label, in pixels."""
    from scipy.ndimage import distance_transform_edt

    inside = np.ones(labels.shape, bool)
    for axis in (0, 1):
        here, there = np.swapaxes(labels, 0, axis), np.swapaxes(inside, 0, axis)
        differ = here[1:] != here[:-1]
        there[1:] &= ~differ
        there[:-1] &= ~differ
    return np.full(labels.shape, np.inf) if inside.all() else np.asarray(distance_transform_edt(inside) + 1.0)


def real_result(data: RealSet, noise: rp.noise.NoiseModel, size: int) -> RealResult:
    """Shares rejected at 1 and at 0.1 %; predicted over observed rms angle to the whole flat part."""
    camera = replace(data.camera, noise=noise)
    plain = replace(data.camera, noise=rp.noise.kinect_v1())
    p, q, predicted, observed, accepted, excess, distance, border = [], [], [], [], [], [], [], []
    images: list[tuple[int, int]] = []
    for depth, labels in zip(data.second, data.labels, strict=True):
        regions = flat_regions(depth, data.camera, labels)
        tiles = rp.fit_tiles(depth, camera, size, max_missing=0.1, significance=0.0)
        rows, columns = np.arange(0, camera.height, size), np.arange(0, camera.width, size)
        low = np.minimum.reduceat(np.minimum.reduceat(regions, rows, axis=0), columns, axis=1)
        high = np.maximum.reduceat(np.maximum.reduceat(regions, rows, axis=0), columns, axis=1)
        whole = (tiles.tile_heights[:, None] == size) & (tiles.tile_widths == size)
        region = np.where((low == high) & tiles.fitted & whole, low, 0)
        inside = region > 0
        p.append(tiles.p_value[inside])
        parts = np.zeros((inside.sum(), 2), np.int64) if len(data.second) > 1 else np.argwhere(inside) * size // SQUARE
        for part in np.unique(parts, axis=0):
            rejected = p[-1][(parts == part).all(axis=1)] < 0.01
            images.append((len(rejected), int(rejected.sum())))
        q.append(replace(tiles, camera=plain).p_value[inside])
        excess.append(_residual_over_expected(tiles, inside))
        distance.append(np.hypot(*(size * (np.argwhere(inside) + 0.5) - np.array(camera.shape) / 2.0).T))
        if labels is not None:
            nearest = np.minimum.reduceat(np.minimum.reduceat(from_border(regions), rows, axis=0), columns, axis=1)
            border.append(nearest[inside])
        merged = rp.merge(tiles, region, significance=0.0)
        # Regions of few tiles are mostly the tile itself.
        enough = np.bincount(region.ravel(), minlength=len(merged.status) + 1)[1:] >= 9
        chosen = inside.copy()
        chosen[chosen] = enough[region[chosen] - 1]
        accepted.append(tiles.p_value[chosen] >= 0.01)
        cosine = np.sum(tiles.planes[chosen, :3] * merged.planes[region[chosen] - 1, :3], axis=-1)
        observed.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        predicted.append(tiles.angle_std[chosen])
    p_all, seen, expected, flat = (np.concatenate(parts) for parts in (p, observed, predicted, accepted))
    rings = np.array_split(np.argsort(np.concatenate(distance), kind="stable"), len(RINGS))
    bands = []
    if border:
        band = np.searchsorted(APART, np.concatenate(border), side="right")
        of_bands = (p_all[band == i] for i in range(len(APART) + 1))
        bands = [float(np.mean(some < 0.01)) if len(some) else np.nan for some in of_bands]
    square = np.minimum(np.concatenate(excess), 9.0)  # no single edge is to be all that counts
    return RealResult(
        tiles=len(p_all),
        angles=int(flat.sum()),
        rejected=float(np.mean(p_all < 0.01)) if len(p_all) else np.nan,
        rejected_thousandth=float(np.mean(p_all < 0.001)) if len(p_all) else np.nan,
        rejected_independent=float(np.mean(np.concatenate(q) < 0.01)) if len(p_all) else np.nan,
        angle=_rms(expected[flat]) / _rms(seen[flat]) if flat.any() else np.nan,
        angle_of_all=_rms(expected) / _rms(seen) if len(seen) else np.nan,
        rings=tuple(
            (float(np.sqrt(np.mean(square[ring]))), float(np.mean(p_all[ring] < 0.01))) for ring in rings if len(ring)
        ),
        images=tuple(images),
        borders=tuple(bands),
    )


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _residual_over_expected(tiles: rp.TilePlanes, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Sum of squared residuals of the chosen tiles of a frame over what the camera's noise expects."""
    noise = tiles.camera.noise
    assert noise is not None
    footprint = tile_footprints(tiles.camera.shape, tiles.tile)[chosen.ravel()]
    q, count = 1.0 / mean_depth(tiles)[chosen], tiles.valid_count[chosen]
    growth = noise._growth(*tile_rays(tiles.camera, tiles.tile).centre[:, chosen])
    lateral = noise.lateral**2 * slope_square(tiles.alpha[chosen], tiles.camera, footprint)
    made = noise.statistics(count, np.broadcast_to(tiles.tile, (len(count), 2)))
    expected, _ = made.with_independent(noise._along(q) ** 2 * growth, lateral + noise._rounding(q), count)
    return np.asarray(count * tiles.rmse[chosen] ** 2 / expected)


SIZES = (8, 16, 24)


def measure(folder: Path | None = None) -> list[dict[str, Any]]:
    """Of each set, direction and size of tile, by the noise of the other half and by its own.

    With a ``folder``, the pictures of the estimates go there.
    """
    rows: list[dict[str, Any]] = []
    for data in real_sets():
        noise = rp.estimate_noise(data.first, data.camera)
        own = rp.estimate_noise(data.second, data.camera)
        if folder is not None and (not rows or rows[-1]["data"] != data.name):
            noise.evidence.plot().savefig(folder / f"noise_{data.name}.png", dpi=70)
        for size in SIZES:
            row: dict[str, Any] = {"data": data.name, "size": size, "falloff": noise.falloff, "lateral": noise.lateral}
            for name, of in (("", noise), ("own_", own)):
                result = real_result(data, of, size)
                enough, measured = result.tiles >= FEWEST_TILES, result.angles >= FEWEST_ANGLES
                row |= {
                    "tiles": result.tiles,
                    f"{name}rejected": result.rejected if enough else None,
                    f"{name}thousandth": result.rejected_thousandth if enough else None,
                    f"{name}angle": result.angle if measured else None,
                    f"{name}angle_of_all": result.angle_of_all if measured else None,
                    "independent": result.rejected_independent,
                }
                row[f"{name}borders"] = result.borders
                if not name:
                    row |= {"rings": result.rings, "images": result.images}
            rows.append(row)
    return rows


ENDS = {"rejected": (0.003, 0.03), "angle": (0.75, 1.25)}


def right(kind: str, value: float) -> bool:
    """Whether a share or an angle is what it should be."""
    return ENDS[kind][0] <= value <= ENDS[kind][1]


def interval(share: float, tiles: int) -> tuple[float, float]:
    """What a share of so many tiles may be the sample of, with 95 % confidence: exact, of a binomial distribution."""
    from scipy.stats import binomtest

    found = binomtest(round(share * tiles), tiles).proportion_ci()
    return float(found.low), float(found.high)


def interval_of_images(images: list[tuple[int, int]]) -> tuple[float, float]:
    """The same if images, not tiles, are independent: of a ratio of means, to first order, and at least `interval`."""
    from scipy.stats import t

    tiles, rejected = np.array(images, float).T
    share = rejected.sum() / tiles.sum()
    low, high = interval(share, int(tiles.sum()))
    if len(tiles) < 2:
        return 0.0, 1.0
    error = np.sqrt(len(tiles) / (len(tiles) - 1) * np.sum((rejected - share * tiles) ** 2)) / tiles.sum()
    reach = float(t.ppf(0.975, len(tiles) - 1) * error)
    return min(max(share - reach, 0.0), low), max(min(share + reach, 1.0), high)


def wrong_beyond_chance(low: float, high: float) -> bool:
    """Whether a share's whole interval is wrong."""
    return high < ENDS["rejected"][0] or low > ENDS["rejected"][1]


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown: both directions in a cell, what is not right in bold."""
    tested = [row for row in rows if row["rejected"] is not None]

    def count(kind: str, name: str) -> str:
        values = [row[name] for row in rows if row[name] is not None]
        return f"{sum(right(kind, value) for value in values)} of {len(values)}"

    def wrong(name: str) -> int:
        return sum(wrong_beyond_chance(*interval(row[name], row["tiles"])) for row in tested)

    by_image = sum(wrong_beyond_chance(*interval_of_images(row["images"])) for row in tested)

    def median(name: str) -> str:
        return f"{100.0 * float(np.median([row[name] for row in tested])):.2f} %"

    def cell(data: str, size: int, kind: str) -> str:
        values = [row[kind] for row in rows if (row["data"], row["size"]) == (data, size)]
        if not any(value is not None for value in values):
            return ""
        shown = [
            "–" if value is None else f"{100.0 * value:.1f} %" if kind == "rejected" else f"{value:.2f}"
            for value in values
        ]
        return ", ".join(
            text if value is None or right(kind, value) else f"**{text}**"
            for text, value in zip(shown, values, strict=True)
        )

    kinds = [(kind, size) for kind in ENDS for size in SIZES]
    lines = [
        "| frames | " + " | ".join(f"{kind}, {size} px" for kind, size in kinds) + " |",
        "|---" + "|---:" * len(kinds) + "|",
    ]
    for data in dict.fromkeys(row["data"] for row in rows):
        lines.append(f"| {SETS[data]} | {' | '.join(cell(data, size, kind) for kind, size in kinds)} |")

    def independent(of_kinect: bool) -> str:
        shares = [row["independent"] for row in tested if (row["data"] in KINECTS) == of_kinect]
        return f"{100.0 * min(shares):.0f} to {100.0 * max(shares):.0f} %"

    lines += [
        "",
        "A share is right between 0.3 and 3 %, an angle between 0.75 and 1.25; what is not right is bold. "
        f"{count('rejected', 'rejected')} shares, of {FEWEST_TILES} tiles or more, are right, and so are "
        f"{count('angle', 'angle')} angles, of {FEWEST_ANGLES} tiles or more that are not rejected: if those that are "
        f"count, too, {count('angle', 'angle_of_all')}. {wrong('rejected')} shares are wrong "
        "beyond chance: the 95 % intervals of the other wrong ones, as if tiles were independent, reach what is right. "
        "Tiles of one image, or of one square of a single frame, have its noise in common. As if only images and "
        f"squares were independent, {by_image} shares are wrong beyond chance. "
        f"With the noise of the very half that is tested, {count('rejected', 'own_rejected')} shares and "
        f"{count('angle', 'own_angle')} angles are right (shares wrong beyond chance: {wrong('own_rejected')}). "
        f"In the median of the sets, the p-values of {median('thousandth')} of the tiles are below 0.001, and by their "
        f"own half's noise those of {median('own_thousandth')}. By the published noise of a Kinect v1, which takes "
        f"pixels for independent, {independent(True)} of a Kinect v1's tiles are rejected, and {independent(False)} of "
        "those of the other sensors, whose noise is another.",
        "",
        "The shares that are not right (bold: beyond chance), with their intervals, and what they are by their own "
        "half's noise:",
        "",
        "| frames | tile | tiles | rejected by the other half's noise | 95 %, by tile | 95 %, by image or square "
        "| by its own |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in tested:
        if not right("rejected", row["rejected"]):
            ends = interval(row["rejected"], row["tiles"])
            both = (
                f"{100.0 * low:.1f}–{100.0 * high:.1f} %" for low, high in (ends, interval_of_images(row["images"]))
            )
            share = f"{100.0 * row['rejected']:.1f} %"
            lines.append(
                f"| {SETS[row['data']]} | {row['size']} | {row['tiles']} "
                f"| {f'**{share}**' if wrong_beyond_chance(*ends) else share} "
                f"| {' | '.join(both)} | {100.0 * row['own_rejected']:.1f} % |"
            )
    return "\n".join([*lines, "", *border_table(rows), "", *ring_table(rows)])


def border_table(rows: list[dict[str, Any]]) -> list[str]:
    """Labelled tiles by how far they are from the border of their plane."""
    near, far = APART
    lines = [
        f"Of the labelled tiles, those less than {near} pixels from the border of their plane, {near} to {far}, and "
        "more; rejected by the other half's noise, and by their own:",
        "",
        f"| frames | tile | less than {near} | to {far} | more | by its own: less than {near} | to {far} | more |",
        "|---" + "|---:" * 7 + "|",
    ]
    for row in rows:
        if row["borders"] and row["rejected"] is not None:
            shares = " | ".join(f"{100.0 * share:.1f} %" for share in (*row["borders"], *row["own_borders"]))
            lines.append(f"| {SETS[row['data']]} | {row['size']} | {shares} |")
    return lines


def ring_table(rows: list[dict[str, Any]]) -> list[str]:
    """The lateral errors and falloffs of the sets' noise, and tiles of the smallest size by ring of the image."""

    def cell(data: str, text: Callable[[dict[str, Any]], str]) -> str:
        return ", ".join(text(row) for row in rows if (row["data"], row["size"]) == (data, SIZES[0]))

    def of_ring(i: int, entry: int, form: str) -> Callable[[dict[str, Any]], str]:
        return lambda row: form.format(row["rings"][i][entry])

    def with_some(name: str) -> str:
        found = [row["data"] for row in rows if row[name] and row["size"] == SIZES[0]]
        each = (f"{SETS[data]} ({cell(data, lambda row: f'{row[name]:.2f}')})" for data in dict.fromkeys(found))
        return "; ".join(each)

    forms = {"residual": (0, "{:.2f}"), "rejected": (1, "{:.1%}")}
    kinds = [(name, kind, i) for name in forms for i, kind in enumerate(RINGS)]
    lines = [
        f"The lateral errors, in pixels, are {with_some('lateral')}. The noise grows away from the optical axis, with "
        f"these falloffs: {with_some('falloff')}. In the others there is none. Of the third of the tiles of 8 pixels "
        "that is nearest to the middle of the image, of the next and of the outermost third, the root mean square "
        "residual over the model's and the share that is rejected:",
        "",
        "| frames | " + " | ".join(f"{name}, {kind}" for name, kind, _ in kinds) + " |",
        "|---" + "|---:" * len(kinds) + "|",
    ]
    for data in WITH_RINGS:
        cells = [cell(data, of_ring(i, *forms[name])).replace("%", " %") for name, _, i in kinds]
        lines.append(f"| {SETS[data]} | {' | '.join(cells)} |")
    return lines


def real_report(folder: Path) -> list[str]:
    """The two halves of every real set, by tile size."""
    return [
        "## Real frames",
        "",
        "Noise estimated from one half of the frames, tested on the tiles of the other half that lie in one "
        "labelled plane or, where nothing is labelled, in a part that is flat to the eye. Rejected is the share "
        "below the 1 % level. Angle: predicted over observed rms angle of the tiles that are not, to the plane of the "
        "whole flat part.",
        "",
        table(measure(folder)),
        "",
    ]
