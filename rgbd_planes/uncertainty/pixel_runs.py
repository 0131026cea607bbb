"""Where the pixels of labels, of windows, and of unions of parts, lie."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from rgbd_planes.camera.depth_frame import DepthFrame
from rgbd_planes.kernels.statistics import pixel_runs
from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns


def runs_of_labels(labels: npt.NDArray[np.int32], frame: DepthFrame, count: int) -> PixelRuns:
    """The measured pixels of labels 1 to ``count``."""
    measured = frame.values[:3]
    return runs_found(lambda found: pixel_runs.runs_of_labels(labels, *measured, found), labels.size, count)


def runs_found(find: Callable[[npt.NDArray[np.int32]], int], pixels: int, count: int) -> PixelRuns:
    """The runs of labels 1 to ``count`` that a kernel writes, as `kernels.statistics.pixel_runs.add_row` does."""
    found = np.empty((4, pixels), np.int32)
    number = find(found)
    first = np.empty(count + 1, np.int64)
    row, start, stop = np.empty((3, number), np.int32)
    pixel_runs.by_label(found, number, first, row, start, stop)
    return PixelRuns(first, row, start, stop, np.ones(number))


def runs_of_windows(windows: npt.NDArray[np.int64], counts: npt.NDArray[np.int32]) -> PixelRuns:
    """The rows of windows, (N, 4), of each of which so many pixels are measured, as if evenly all over it."""
    top, left, height, width = windows.T
    lines = np.where(counts > 0, height, 0)
    which = np.repeat(np.arange(len(windows)), lines)
    first = np.concatenate([[0], np.cumsum(lines)])
    row = np.arange(len(which)) - first[which] + top[which]
    share = (counts / (height * width))[which]
    row, start, stop = (each.astype(np.int32) for each in (row, left[which], (left + width)[which]))
    return PixelRuns(first, row, start, stop, share)


def joined(runs: PixelRuns, labels: npt.NDArray[np.int32], count: int) -> PixelRuns:
    """The runs of ``count`` unions of parts; ``labels`` say which union each part belongs to, from 1, 0 for none."""
    run_labels = np.repeat(labels, np.diff(runs.first))
    order = np.argsort(run_labels, kind="stable")[np.count_nonzero(run_labels == 0) :]
    first = np.searchsorted(run_labels[order], np.arange(1, count + 2))
    return PixelRuns(first, runs.row[order], runs.start[order], runs.stop[order], runs.share[order])
