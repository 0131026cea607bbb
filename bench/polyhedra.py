"""Whether polyhedra keep their faces and round things have none: ``python -m bench.polyhedra``.

Icosahedra, prisms and columns beside balls, cushions, lampshades and pipes, in several sizes, distances and noises.
A face is found by Hoover's measure at 80 %. A false plane is a label that is no face by this measure.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bench import curved_scenes
from bench.segmentation import Frame
from rgbd_planes.evaluation.metrics import compare_labels
from rgbd_planes.segmentation.segment import segment

DISTANCES = (0.8, 1.5, 2.5)
SIZES = (0.13, 0.22)
"""Of the solids, as a share of the distance."""
LEAST = 300
"""Pixels of a face that counts."""


def frames() -> Iterator[tuple[str, Frame]]:
    """Each scene as each kind of sensor measures it, with the sensor's name."""
    for measure, camera in curved_scenes.SENSORS:
        for distance in DISTANCES:
            for size in SIZES:
                rendering = curved_scenes.solids(distance, size * distance).render(camera)
                raw = measure(rendering.depth, 7)
                truth = np.where(raw > 0, curved_scenes.flat_labels(rendering), 0).astype(np.int32)
                name = f"{measure.__name__}, {distance} m, {size * distance:.2f} m"
                yield measure.__name__, Frame(name, raw, camera, truth)


def faces_found(labels: NDArray[np.int32], truth: NDArray[np.int32]) -> tuple[int, int, int]:
    """How many faces are found and there, and how many planes are false."""
    comparison = compare_labels(labels, truth)
    large = comparison.truth_labels[comparison.truth_sizes >= LEAST]
    large = large[large != truth[0, 0]]  # the wall
    score = comparison.hoover(0.8)
    return int(np.isin(large, score.correct_pairs[:, 0]).sum()), len(large), int(score.noise)


def main() -> None:
    """Print a line for each sensor."""
    counts: dict[str, list[tuple[int, int, int]]] = {}
    for sensor, frame in frames():
        counts.setdefault(sensor, []).append(faces_found(segment(frame.depth, frame.camera).labels, frame.truth))
    print(f"| sensor | faces of {LEAST} pixels | found | false planes a frame |")
    print("|---|---:|---:|---:|")
    every = [row for rows in counts.values() for row in rows]
    for sensor, rows in {**counts, "all": every}.items():
        found, there, false = np.sum(rows, axis=0)
        print(f"| {sensor.replace('_', ' ')} | {there} | {found / there:.1%} | {false / len(rows):.1f} |")


if __name__ == "__main__":
    main()
