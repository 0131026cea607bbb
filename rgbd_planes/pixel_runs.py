"""Where the pixels of windows, and of unions of parts, lie."""

import numpy as np
import numpy.typing as npt

from rgbd_planes.kernels.statistics.pixel_runs import PixelRuns


def runs_of_windows(windows: npt.NDArray[np.int64], counts: npt.NDArray[np.int32]) -> PixelRuns:
    """The rows of windows, (N, 4), of each of which so many pixels are measured, as if evenly all over it."""
    top, left, height, width = windows.T
    lines = np.where(counts > 0, height, 0)
    which = np.repeat(np.arange(len(windows)), lines)
    first = np.concatenate([[0], np.cumsum(lines)])
    row = np.arange(len(which)) - first[which] + top[which]
    share = (counts / (height * width))[which]
    row, start, stop = (of.astype(np.int32) for of in (row, left[which], (left + width)[which]))
    return PixelRuns(first, row, start, stop, share)


def joined(runs: PixelRuns, labels: npt.NDArray[np.int32], count: int) -> PixelRuns:
    """The runs of ``count`` unions of parts; ``labels`` say which union each part belongs to, from 1, 0 for none."""
    of_runs = np.repeat(labels, np.diff(runs.first))
    order = np.argsort(of_runs, kind="stable")[np.count_nonzero(of_runs == 0) :]
    first = np.searchsorted(of_runs[order], np.arange(1, count + 2))
    return PixelRuns(first, runs.row[order], runs.start[order], runs.stop[order], runs.share[order])
