"""Is a fit in 1/Z better than one in XYZ on real sensors, too? ``python -m bench.real_sensors``

Tiles that lie inside a plane that people have labelled, or in frames without labels inside a window that is flat to
within 1 % of its distance, against the plane fitted to all its pixels by the same method: the median angle between
them, and how many times larger PCA's is. Reads the frames of the folder that ``RGBD_PLANES_DATA`` names.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rgbd_planes as rp
from bench.real_data import FOLDER as DATA
from bench.real_data import needed
from bench.uncertainty_real import SETS as REAL_SETS
from bench.uncertainty_real import flat_regions, labels_of
from rgbd_planes.sequences.images import read_depth

SETS = {**REAL_SETS, "icl_nuim_evops_gt": "ICL-NUIM, rendered, labelled"}
METHODS = ("range_explicit", "standard_pca", "standard_explicit")
LEAST_PIXELS = 1000
RESAMPLES = 1000


def angles(folder: Path, tile: int) -> list[NDArray[np.float64]]:
    """(N, 3) for each flat part of the frames: angles in degrees, by each method, of the N tiles inside it."""
    camera = rp.Camera.load(folder / "camera.json")
    found = []
    for path in sorted((folder / "depth").glob("*.png")):
        depth = read_depth(path)
        labels = flat_regions(depth, camera, labels_of(path))
        normals = [rp.fit_labels(depth, camera, labels, m, max_missing=1.0).planes[:, :3] for m in METHODS]
        for label in np.unique(labels[labels > 0]):
            region = np.where(labels == label, depth, 0)
            if np.count_nonzero(region) < LEAST_PIXELS:
                continue
            columns = []
            for method, normal in zip(METHODS, normals, strict=True):
                tiles = rp.fit_tiles(region, camera, tile, method, max_missing=0.05)
                chord = np.linalg.norm(tiles.planes[..., :3] - normal[label - 1], axis=-1)
                columns.append(np.degrees(2.0 * np.arcsin(chord / 2.0)).ravel())
            rows = np.column_stack(columns)
            found.append(rows[np.isfinite(rows).all(axis=1)])
    return found


def _interval(parts: list[NDArray[np.float64]], rng: np.random.Generator) -> list[float]:
    """What PCA's error in units of ours may be, with 95 % confidence: of other flat parts as many as these."""
    ratios = []
    for _ in range(RESAMPLES):
        chosen = np.concatenate([parts[i] for i in rng.integers(len(parts), size=len(parts))])
        one, other, _ = np.median(chosen, axis=0)
        ratios.append(other / one)
    return [float(end) for end in np.percentile(ratios, [2.5, 97.5])]


def measure() -> list[dict[str, Any]]:
    """A row for each data set and size of tile: medians in degrees, and PCA's error in units of ours."""
    needed(SETS)
    rng = np.random.default_rng(1)
    rows: list[dict[str, Any]] = []
    for name in SETS:
        for tile in (10, 20):
            parts = [part for part in angles(DATA / name, tile) if len(part)]
            found = np.concatenate(parts)
            ours, pca, explicit = np.median(found, axis=0).tolist()
            row = {"data": name, "tile": tile, "tiles": len(found), "range_explicit": ours, "standard_pca": pca}
            rows.append({**row, "standard_explicit": explicit, "ratio": [pca / ours, *_interval(parts, rng)]})
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = ["| data | tile | tiles | 1/Z | PCA | Z(X, Y) | PCA ÷ 1/Z (95 % interval) |"]
    lines.append("|---|---:|---:|---:|---:|---:|---:|")
    for row in rows:
        medians = " | ".join(f"{row[method]:.2f}°" for method in METHODS)
        ratio, low, high = row["ratio"]
        lines.append(
            f"| {SETS[row['data']]} | {row['tile']} | {row['tiles']} | {medians} | {ratio:.2f} ({low:.2f}–{high:.2f}) |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    print(table(measure()))


if __name__ == "__main__":
    main()
