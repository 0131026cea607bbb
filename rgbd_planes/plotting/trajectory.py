"""The path of a camera: from above, and how well it is known over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from rgbd_planes._core.arrays import Floats
from rgbd_planes.plotting.figures import NotebookFigure, check_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PATH, TRUTH, LOST = "#1f77b4", "#666666", "#d62728"


class Pose(Protocol):
    """What is drawn of a pose; a `CameraPose` is one."""

    @property
    def index(self) -> int: ...
    @property
    def T_world_camera(self) -> Floats: ...  # noqa: N802 (names its frames)
    @property
    def covariance(self) -> Floats: ...
    @property
    def is_keyframe(self) -> bool: ...
    @property
    def is_lost(self) -> bool: ...
    @property
    def rotation_std(self) -> float: ...
    @property
    def translation_std(self) -> float: ...


def plot_trajectory(poses: Sequence[Pose], truth: ArrayLike | None = None, figure: Figure | None = None) -> Figure:
    """Draw the path of a camera from above, and its standard deviations over time.

    Parameters
    ----------
    poses : sequence of CameraPose
    truth : (N, 4, 4) array_like, optional
        True poses, camera to the same world; NaN where they are not known.
    figure : matplotlib Figure, optional
        Drawn into; a new one by default.

    Returns
    -------
    matplotlib Figure
        Left: x to the right and z forward, of the first camera; ellipses of keyframes are two standard deviations
        relative to the keyframe before. Right: standard deviations relative to each frame's reference.
    """
    check_figure(figure)
    drawn = NotebookFigure(figsize=(10.0, 4.6), layout="constrained") if figure is None else figure
    above, right = drawn.subplots(1, 2, width_ratios=[1.15, 1.0])
    right.remove()
    grid = above.get_gridspec()[1].subgridspec(2, 1)
    _draw_path(above, poses, truth)
    number = [pose.index for pose in poses]
    panels = [drawn.add_subplot(grid[0]), drawn.add_subplot(grid[1])]
    series = [1e3 * np.array([p.translation_std for p in poses]), np.array([p.rotation_std for p in poses])]
    for panel, values, unit in zip(panels, series, ("position, mm", "rotation, degrees"), strict=True):
        panel.plot(number, values, color=PATH, linewidth=1.2)
        panel.set_ylabel(f"std of {unit}")
        panel.set_ylim(bottom=0.0)
        panel.grid(alpha=0.3)
        for pose in poses:
            if pose.is_lost:
                panel.axvline(pose.index, color=LOST, alpha=0.3, linewidth=1.0)
    panels[0].set_title("relative to the keyframe; red: lost", fontsize=10)
    panels[0].tick_params(labelbottom=False)
    panels[1].set_xlabel("frame")
    return drawn


def _draw_path(axes: Axes, poses: Sequence[Pose], truth: ArrayLike | None) -> None:
    from matplotlib.patches import Ellipse

    places = np.array([pose.T_world_camera[:3, 3] for pose in poses]).reshape(-1, 3)
    if truth is not None:
        true = np.asarray(truth, np.float64)[:, :3, 3]
        axes.plot(true[:, 0], true[:, 2], color=TRUTH, linewidth=2.5, alpha=0.6, label="truth")
    axes.plot(places[:, 0], places[:, 2], color=PATH, linewidth=1.5, label="odometry")
    lost = np.array([pose.is_lost for pose in poses], np.bool_)
    if lost.any():
        axes.plot(places[lost, 0], places[lost, 2], "x", color=LOST, markersize=5, label="lost")
    keyframes = [pose for pose in poses if pose.is_keyframe]
    for pose in keyframes:
        rotation = pose.T_world_camera[:3, :3]
        covariance = (rotation @ pose.covariance[3:, 3:] @ rotation.T)[np.ix_([0, 2], [0, 2])]
        values, vectors = np.linalg.eigh(covariance)
        width, height = 4.0 * np.sqrt(np.maximum(values, 0.0))
        angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        place = pose.T_world_camera[[0, 2], 3]
        axes.add_patch(Ellipse((place[0], place[1]), width, height, angle=angle, color=PATH, alpha=0.15, linewidth=0))
    if keyframes:
        at = np.array([pose.T_world_camera[[0, 2], 3] for pose in keyframes])
        ahead = np.array([pose.T_world_camera[[0, 2], 2] for pose in keyframes])
        axes.quiver(*at.T, *ahead.T, color=PATH, width=0.004, scale=18.0, label="keyframes")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    axes.set_xlabel("x, m (right)")
    axes.set_ylabel("z, m (forward)")
    axes.set_title("from above, world is the first camera", fontsize=10)
    axes.legend(loc="best", fontsize=9)
