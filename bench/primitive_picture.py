"""The picture of the page on primitives: what labels are, and how radius and distance err together."""

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

import rgbd_planes as rp
from bench.curvature_picture import curved_room
from bench.primitives import Shape, seen
from rgbd_planes.noise import KINECT_V1

Floats = npt.NDArray[np.float64]
LEAST_SHOWN = 6000  # pixels
COLOURS = {"half": "#1f77b4", "third": "#d62728"}


def errors_of(part: str, frames: int) -> tuple[Floats, Floats]:
    """Errors of radius and distance, (N, 2) in mm, of a ball in so many frames, and the mean of their covariances."""
    ball = Shape(rp.Primitive.SPHERE, np.array([0.0, 0.0, 1.6]), 0.1, np.array([0.0, 1.0, 0.0]))
    camera, _, q, labels = seen(ball, part)
    rng = np.random.default_rng(4)
    found, covariances = [], []
    for _ in range(frames):
        fits = rp.fit_primitives(1.0 / (q + KINECT_V1 * rng.standard_normal(q.shape)), camera, labels)
        if fits.kind[0] == rp.Primitive.SPHERE:
            found.append([fits.radius[0] - ball.radius, fits.centre[0, 2] - ball.centre[2]])
            covariances.append(fits.covariance[0][np.ix_([6, 2], [6, 2])])
    return 1e3 * np.array(found), 1e6 * np.mean(covariances, axis=0)


def picture() -> Figure:
    """Draw the surfaces of a room with their kinds, and the errors of a ball's radius and distance."""
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, noise=rp.noise.kinect_v1())
    depth = curved_room(camera)
    found = rp.segment(depth, camera)
    labels = np.where(found.labels > 0, found.labels + found.curved_labels.max(), found.curved_labels)
    fits = rp.fit_primitives(depth, camera, labels)
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    left.imshow(depth, cmap="gray", vmax=2.6)
    for k in np.flatnonzero(fits.sizes >= LEAST_SHOWN).tolist():
        kind = fits.kind[k]
        rows, columns = np.nonzero(fits.labels == k + 1)
        text = rp.Primitive(kind).name.lower()
        if fits.radius[k] > 0.0:
            text += f"\n{1e3 * fits.radius[k]:.2f} ± {1e3 * fits.radius_std[k]:.2f} mm"
        left.contour(fits.labels == k + 1, levels=[0.5], colors=f"C{k}", linewidths=1.0)
        place = np.median(columns), np.median(rows)
        box = {"fc": "white", "alpha": 0.8, "lw": 0}
        left.text(*place, text, ha="center", va="center", fontsize=8, bbox=box)
    left.set_axis_off()
    for part, colour in COLOURS.items():
        errors, covariance = errors_of(part, 300)
        name = "one side seen" if part == "half" else "a third of that"
        right.plot(*errors.T, ".", color=colour, ms=3, alpha=0.5, label=name)
        values, vectors = np.linalg.eigh(covariance)
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        sides = 2.0 * 2.448 * np.sqrt(values)  # 95 % are within
        right.add_patch(Ellipse((0.0, 0.0), sides[1], sides[0], angle=angle, fill=False, color=colour, lw=1.5))
    right.set(xlabel="error of the radius, mm", ylabel="error of the centre's distance, mm")
    right.legend(loc="upper left", title="a ball of 100 mm at 1.5 m,\n300 frames; ellipse: 95 %", fontsize=8)
    return figure
