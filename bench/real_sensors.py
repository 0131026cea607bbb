"""Is a fit in 1/Z better than one in XYZ on real sensors, too? ``python -m bench.real_sensors``

Tiles that lie inside a plane that people have labelled, against the plane fitted to all its pixels by the same
method: the median angle between them, and how often larger PCA's is. Reads the labelled frames of
``../shared/data``, where there are any.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import rgbd_planes as rp
from rgbd_planes.images import read_depth

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SETS = ("abw_segcomp_cal0", "abw_segcomp_cal1", "icl_nuim_evops_gt")
METHODS = ("range_explicit", "standard_pca", "standard_explicit")
LEAST_PIXELS = 1000
RESAMPLES = 1000


def angles(folder: Path, tile: int) -> NDArray[np.float64]:
    """(N, 3) angles in degrees, by each method, of the tiles inside labelled planes."""
    camera = rp.Camera.load(folder / "camera.json")
    whole = np.array([[0, 0, camera.height, camera.width]])
    found = []
    for path in sorted((folder / "labels").glob("*.png")):
        depth, labels = read_depth(folder / "depth" / path.name), read_depth(path)
        for label in np.unique(labels[labels > 0]):
            region = np.where(labels == label, depth, 0)
            if np.count_nonzero(region) < LEAST_PIXELS:
                continue
            columns = []
            for method in METHODS:
                plane = rp.fit_windows(
                    region, camera, whole, method, implementation="naive", max_missing=1.0
                ).planes[0, :3]
                tiles = rp.fit_tiles(region, camera, tile, method, max_missing=0.05)
                chord = np.linalg.norm(tiles.planes[..., :3] - plane, axis=-1)
                columns.append(np.degrees(2.0 * np.arcsin(chord / 2.0)).ravel())
            rows = np.column_stack(columns)
            found.append(rows[np.isfinite(rows).all(axis=1)])
    return np.concatenate(found)


def main() -> int:
    """Print the table."""
    if not DATA.is_dir():
        print(f"no labelled frames in {DATA.parent.name}/{DATA.name}", file=sys.stderr)
        return 1
    print("| data | tile | tiles | 1/Z | PCA | Z(X, Y) | PCA ÷ 1/Z (95 % interval) |")
    print("|---|---|---|---|---|---|---|")
    rng = np.random.default_rng(1)
    for name in SETS:
        for tile in (10, 20):
            rows = angles(DATA / name, tile)
            median = np.median(rows, axis=0)
            ratios = []
            for _ in range(RESAMPLES):
                ours, pca, _ = np.median(rows[rng.integers(len(rows), size=len(rows))], axis=0)
                ratios.append(pca / ours)
            low, high = np.percentile(ratios, [2.5, 97.5])
            print(
                f"| {name} | {tile} | {len(rows)} | {median[0]:.2f}° | {median[1]:.2f}° | {median[2]:.2f}° "
                f"| {median[1] / median[0]:.2f} ({low:.2f}–{high:.2f}) |"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
