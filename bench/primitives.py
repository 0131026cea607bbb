"""``python -m bench.primitives``: whether primitives are of the right kind, their radii right, and how fast they come.

Balls and pipes with a Kinect v1's noise, seen whole from one side or a third of that, against the Cramér-Rao bound of
their pixels; planes, cones and corners; a VGA frame's time. With real frames also the radii of cylinders that were seen
several times: the environment variable RGBD_PLANES_DATA names their folder.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, gaussian_filter

import rgbd_planes as rp
from bench.real_data import FOLDER
from bench.timing import in_turns
from rgbd_planes._core.arrays import Floats
from rgbd_planes.noise import KINECT_V1

CAMERA = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0, noise=rp.noise.kinect_v1())
RAYS = np.stack(np.broadcast_arrays(CAMERA.tan_x, CAMERA.tan_y, 1.0), axis=-1)
SPHERES, CYLINDERS = (0.05, 0.1, 0.2, 0.5), (0.03, 0.06, 0.1, 0.2)
DISTANCES = (0.6, 1.2, 2.0, 3.0)
WALL = 0.2
"""q of the wall behind: its pixels are measured, so that those beside the outline are no interior ones."""
FEWEST = 30
SHARED = rp.noise.NoiseModel((KINECT_V1,), correlation=((0.6, 2.0), (0.2, 6.0)), floor=0.5, floor_length=40.0)
"""The same noise with errors that neighbours share."""
COMPARED = 0.1
"""Largest bound on a radius' deviation, as a share of the radius, for which a kind is asked for."""


class Shape(NamedTuple):
    """A sphere, or a cylinder along an axis, and how long it is."""

    kind: rp.Primitive
    centre: Floats
    radius: float
    axis: Floats

    def inverse_depth(self, rays: Floats) -> Floats:
        """q on rays (..., 3); NaN where they miss it."""
        across, centre = rays, self.centre
        if self.kind == rp.Primitive.CYLINDER:
            across = rays - (rays @ self.axis)[..., None] * self.axis
            centre = centre - (centre @ self.axis) * self.axis
        a, b, c = (across**2).sum(axis=-1), across @ centre, centre @ centre - self.radius**2
        with np.errstate(invalid="ignore"):
            q = (b + np.sqrt(b * b - a * c)) / c
        if self.kind == rp.Primitive.CYLINDER:
            with np.errstate(invalid="ignore"):
                along = (rays @ self.axis) / q - self.centre @ self.axis
                q = np.where(np.abs(along) < 2.0 * self.radius, q, np.nan)
        return np.asarray(q)

    def bound(self, rays: Floats, sigma: float) -> float:
        """The Cramér-Rao bound on the radius' standard deviation, from pixels whose rays these are."""
        step = 1e-6 * self.radius
        changes = [self._replace(radius=self.radius + step)]
        changes += [self._replace(centre=self.centre + step * unit) for unit in np.eye(3)]
        if self.kind == rp.Primitive.CYLINDER:
            changes += [self._replace(axis=_unit(self.axis + 1e-6 * unit)) for unit in np.eye(3)]
        q = self.inverse_depth(rays)
        sizes = [step] * 4 + [1e-6] * 3
        slopes = np.stack([(it.inverse_depth(rays) - q) / h for it, h in zip(changes, sizes, strict=False)], axis=1)
        known = np.isfinite(slopes).all(axis=1)
        information = slopes[known].T @ slopes[known] / sigma**2
        # An axis may slide along itself, and has a length of its own: of these nothing is known, and nothing is asked.
        size = np.sqrt(np.diag(information))
        size[size == 0.0] = 1.0
        inverse = np.linalg.pinv(information / np.outer(size, size), rcond=1e-7, hermitian=True)
        return float(np.sqrt(inverse[0, 0]) / size[0])


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / np.linalg.norm(vector))


def shapes(rng: np.random.Generator) -> Iterator[tuple[Shape, float]]:
    """Each kind, radius and distance with a place and a direction by chance, and the distance."""
    for kind, radii in ((rp.Primitive.SPHERE, SPHERES), (rp.Primitive.CYLINDER, CYLINDERS)):
        for radius in radii:
            for distance in DISTANCES:
                z = distance + radius
                centre = z * np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.15, 0.15), 1.0])
                yield Shape(kind, centre, radius, _unit(rng.standard_normal(3) * [1.0, 1.0, 0.4])), distance


def seen(shape: Shape, part: str) -> tuple[rp.Camera, Floats, Floats, NDArray[np.bool_]]:
    """A camera of what is around a shape, its rays, q with a wall behind it, and which pixels are labelled."""
    q = shape.inverse_depth(RAYS)
    labels = np.isfinite(q)
    if part == "third":
        columns = np.flatnonzero(labels.any(axis=0))
        labels[:, columns[max(len(columns) // 3, 1)] :] = False
    rows, columns = np.flatnonzero(labels.any(axis=1)), np.flatnonzero(labels.any(axis=0))
    top, left = max(rows[0] - 1, 0), max(columns[0] - 1, 0)
    camera, rays, q = _around(np.where(np.isnan(q), WALL, q), slice(top, rows[-1] + 2), slice(left, columns[-1] + 2))
    return camera, rays, q, labels[top : rows[-1] + 2, left : columns[-1] + 2]


def _around(q: Floats, rows: slice, columns: slice) -> tuple[rp.Camera, Floats, Floats]:
    """The camera of a part of the image, its rays, and q there."""
    top, left = int(rows.start), int(columns.start)
    height, width = q[rows, columns].shape
    return CAMERA.cropped(left, top, width, height), RAYS[rows, columns], q[rows, columns]


def monte_carlo(runs: int) -> list[dict[str, Any]]:
    """A row for each shape and part: kinds, bias and deviations over so many frames."""
    rng = np.random.default_rng(1)
    rows = []
    for shape, distance in shapes(rng):
        for part in ("half", "third"):
            camera, rays, q, labels = seen(shape, part)
            inside = binary_erosion(labels, np.ones((3, 3), np.bool_), border_value=1)  # the pixels that fits take
            if inside.sum() < FEWEST:
                continue
            bound = shape.bound(rays[inside], KINECT_V1)
            kinds, radii, predicted = [], [], []
            for _ in range(runs):
                depth = 1.0 / (q + KINECT_V1 * rng.standard_normal(q.shape))
                fits = rp.fit_primitives(depth, camera, labels)
                kinds.append(fits.kind[0] == shape.kind)
                if kinds[-1]:
                    radii.append(fits.radius[0])
                    predicted.append(fits.radius_std[0])
            row = {
                "kind": shape.kind.name.lower(), "radius": shape.radius, "distance": distance, "part": part,
                "pixels": int(inside.sum()), "bound": bound, "right": float(np.mean(kinds)),
            }  # fmt: skip
            if len(radii) > 1:
                deviation = float(np.std(radii, ddof=1))
                row |= {
                    "bias": float(np.mean(radii) - shape.radius) / deviation,
                    "observed": deviation / bound,
                    "predicted": float(np.sqrt(np.mean(np.square(predicted)))) / deviation,
                }
            rows.append(row)
    return rows


def _cone(rays: Floats) -> Floats:
    """q of a cone that stands upright and opens downwards by a third of its height, NaN beside it."""
    apex, form = np.array([0.0, -0.35, 1.0]), np.diag([1.0, -(0.35**2), 1.0])
    a = ((rays @ form) * rays).sum(axis=-1)
    b, c = rays @ form @ apex, apex @ form @ apex
    with np.errstate(invalid="ignore", divide="ignore"):
        z = (b - np.where(a < 0.0, -1.0, 1.0) * np.sqrt(b * b - a * c)) / a
        height = z * rays[..., 1] - apex[1]
        return np.where((height > 0.15) & (height < 0.5) & (z > 0.0), 1.0 / z, np.nan)


def others(runs: int) -> dict[str, dict[str, float]]:
    """How often flat pieces and shapes that are none of the three get each kind."""
    walls = np.array([[-0.5, 0.0, 0.8], [0.5, 0.0, 0.8]])
    u, v = RAYS[..., 0], RAYS[..., 1]
    surfaces = {
        "plane, 40 x 40 pixels": (RAYS @ [0.2, -0.1, 0.7], slice(200, 240), slice(300, 340)),
        "plane, 200 x 200 pixels": (RAYS @ [0.2, -0.3, 0.5], slice(100, 300), slice(200, 400)),
        "cone": (_cone(RAYS), slice(150, 450), slice(200, 440)),
        "corner of a room": ((RAYS @ walls.T).max(axis=-1), slice(200, 280), slice(280, 360)),
        "saddle": (0.8 + 0.5 * u * u - 0.5 * v * v, slice(160, 320), slice(240, 400)),
    }
    rng, found = np.random.default_rng(2), {}
    for name, (whole, rows, columns) in surfaces.items():
        camera, _, q = _around(whole, rows, columns)
        kinds = []
        for _ in range(runs):
            depth = np.nan_to_num(1.0 / (q + KINECT_V1 * rng.standard_normal(q.shape)))
            kinds.append(int(rp.fit_primitives(depth, camera, np.isfinite(q)).kind[0]))
        found[name] = {kind.name.lower(): kinds.count(kind) / runs for kind in rp.Primitive}
    return found


def shared_errors(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Errors of variance 1.25 as `SHARED` has them."""
    margin = 60
    wide = np.add(shape, 2 * margin)
    total = np.sqrt(1.0 - sum(share for share, _ in SHARED.correlation)) * rng.standard_normal(wide)
    for share, length in (*SHARED.correlation, (SHARED.floor**2, SHARED.floor_length)):
        width = length / np.sqrt(2.0)
        smooth = gaussian_filter(rng.standard_normal(wide), width, mode="wrap")
        total += np.sqrt(share) * smooth * 2.0 * width * np.sqrt(np.pi)
    return np.asarray(total[margin:-margin, margin:-margin])


def with_shared_errors(runs: int) -> list[dict[str, Any]]:
    """A row for some shapes under errors that neighbours share."""
    rng = np.random.default_rng(3)
    upright, leaning = np.array([0.0, 1.0, 0.0]), _unit(np.array([0.3, 1.0, 0.1]))
    rows = []
    for shape in (
        Shape(rp.Primitive.SPHERE, np.array([0.1, 0.05, 1.7]), 0.2, upright),
        Shape(rp.Primitive.SPHERE, np.array([-0.1, 0.05, 1.1]), 0.1, upright),
        Shape(rp.Primitive.CYLINDER, np.array([0.1, 0.05, 1.3]), 0.1, leaning),
    ):
        for part in ("half", "third"):
            camera, _, q, labels = seen(shape, part)
            camera = camera.with_noise(SHARED)
            radii, predicted, right = [], [], 0
            for _ in range(runs):
                fits = rp.fit_primitives(1.0 / (q + KINECT_V1 * shared_errors(rng, q.shape)), camera, labels)
                right += fits.kind[0] == shape.kind
                if fits.kind[0] == shape.kind:
                    radii.append(fits.radius[0])
                    predicted.append(fits.radius_std[0])
            deviation = float(np.std(radii, ddof=1))
            rows.append({
                "kind": shape.kind.name.lower(), "radius": shape.radius, "part": part, "right": right / runs,
                "bias": float(np.mean(radii) - shape.radius) / deviation,
                "predicted": float(np.sqrt(np.mean(np.square(predicted)))) / deviation,
            })  # fmt: skip
    return rows


def frame_of_shapes() -> tuple[Floats, NDArray[np.int32]]:
    """A VGA frame of six balls and six pipes before a wall, and their labels."""
    nearest, labels = np.full(CAMERA.shape, 0.3), np.zeros(CAMERA.shape, np.int32)
    for i in range(12):
        kind = rp.Primitive.SPHERE if i % 2 else rp.Primitive.CYLINDER
        centre = np.array([-0.6 + 0.4 * (i % 4), -0.45 + 0.45 * (i // 4), 1.4])
        radius, axis = 0.16 if kind == rp.Primitive.SPHERE else 0.1, _unit(np.array([0.3, 1.0, 0.1]))
        q = np.nan_to_num(Shape(kind, centre, radius, axis).inverse_depth(RAYS))
        nearer = q > nearest
        nearest[nearer], labels[nearer] = q[nearer], i + 1
    return 1.0 / (nearest + KINECT_V1 * np.random.default_rng(0).standard_normal(nearest.shape)), labels


def times(rounds: int) -> dict[str, float]:
    """Milliseconds for a VGA frame of a dozen curved surfaces, one thread."""
    depth, labels = frame_of_shapes()
    correlated = CAMERA.with_noise(SHARED)
    work = {
        f"{np.count_nonzero(labels)} pixels, {labels.max()} surfaces": lambda: rp.fit_primitives(depth, CAMERA, labels),
        "the same, with errors that neighbours share": lambda: rp.fit_primitives(depth, correlated, labels),
        "the same, with the frame's own noise": lambda: rp.fit_primitives(depth, CAMERA.with_noise(None), labels),
    }  # fmt: skip
    return {name: 1e3 * found.fastest for name, found in in_turns(work, rounds).items()}


def real_cylinders(level: float) -> dict[str, Any]:
    """Objects of the data set ``mosd_cylinders``: which are of a kind, and the radii of those that seem the same.

    The noise is estimated from its frames, and ``level`` is the significance. Of each object, which was labelled by
    hand, the largest curved surface that `segment` finds on it counts. The objects' identities are not known: radii
    apart by less than 2 mm count as of one, of which a scene may hold several.
    """
    folder = FOLDER / "mosd_cylinders"
    camera = rp.Camera.load(folder / "camera.json")
    paths = sorted((folder / "depth").glob("*.png"))
    frames = [rp.images.read_depth(path) for path in paths]
    camera = camera.with_noise(rp.estimate_noise(frames, camera))
    kinds, cylinders = [], []
    for path, frame in zip(paths, frames, strict=True):
        curved = rp.segment(frame, camera).curved_labels
        objects = rp.images.read_depth(folder / "labels" / path.name) // 10
        labels, count = np.zeros(curved.shape, np.int32), 0
        for one in np.unique(objects[objects > 1]):
            sizes = np.bincount(curved[objects == one], minlength=2)
            largest = 1 + int(np.argmax(sizes[1:]))
            if sizes[largest] >= 300:
                count += 1
                labels[(objects == one) & (curved == largest)] = count
        fits = rp.fit_primitives(frame, camera, labels, significance=level)
        kinds += fits.kind.tolist()
        is_cylinder = fits.kind == rp.Primitive.CYLINDER
        cylinders += np.stack([fits.radius, fits.radius_std], axis=1)[is_cylinder].tolist()
    radii = np.array(sorted(cylinders))
    groups = []
    for part in np.split(radii, np.flatnonzero(np.diff(radii[:, 0]) > 0.002) + 1):
        radius, predicted = part.T
        row = {"seen": len(part), "mean": float(radius.mean()), "predicted": float(np.sqrt(np.mean(predicted**2)))}
        groups.append(row | ({"std": float(radius.std(ddof=1))} if len(part) > 1 else {}))
    counts = {kind.name.lower(): kinds.count(kind) for kind in rp.Primitive}
    return {"objects": len(kinds), "kinds": counts, "groups": groups}


def summary(rows: list[dict[str, Any]]) -> dict[str, float]:
    """The worst of the rows whose bound is small enough, and what all of them are together."""
    told = [row for row in rows if row["bound"] < COMPARED * row["radius"]]
    return {
        "cases": len(told),
        "right, least": min(row["right"] for row in told),
        "right, mean": float(np.mean([row["right"] for row in told])),
        "|bias|, largest": max(abs(row["bias"]) for row in told),
        "observed / bound, mean": float(np.sqrt(np.mean([row["observed"] ** 2 for row in told]))),
        "observed / bound, largest": max(row["observed"] for row in told),
        "predicted / observed, mean": float(np.exp(np.mean([np.log(row["predicted"]) for row in told]))),
        "predicted / observed, least": min(row["predicted"] for row in told),
        "predicted / observed, largest": max(row["predicted"] for row in told),
    }


def main(arguments: list[str] | None = None) -> int:
    """Print tables, and write them as JSON if asked to."""
    parser = argparse.ArgumentParser(prog="python -m bench.primitives", description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="frames of each shape (200)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers there")
    options = parser.parse_args(arguments)
    rows = monte_carlo(options.runs)
    for row in rows:
        text = "  ".join(f"{key} {value:.3g}" if isinstance(value, float) else f"{value}" for key, value in row.items())
        print(text, flush=True)
    found: dict[str, Any] = {"rows": rows, "summary": summary(rows), "others": others(2 * options.runs)}
    found["shared"] = with_shared_errors(options.runs)
    found["times"] = times(20)
    if (FOLDER / "mosd_cylinders").is_dir():
        found["cylinders"] = {level: real_cylinders(level) for level in (0.01, 0.001)}
    for name in ("summary", "others", "shared", "times", "cylinders"):
        print(name, json.dumps(found.get(name), indent=1))
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
