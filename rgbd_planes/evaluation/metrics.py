"""How good a segmentation is, against one that is known to be right.

Everything is read from one contingency table, the number of pixels that each pair of labels shares. So a frame is read
once. Label 0 is "none" on both sides: unlabelled pixels belong to no region. But a region keeps all its pixels, even
those that the truth leaves unlabelled.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rgbd_planes._core.checks import label_array, number, plain_array, shaped_array
from rgbd_planes._core.lazy_property import kept
from rgbd_planes.evaluation.trajectories import RelativeErrors, TrajectoryErrors, trajectory_errors
from rgbd_planes.uncertainty.planes import angle_and_offset

__all__ = [
    "DetectionScores",
    "HooverCounts",
    "LabelComparison",
    "PlaneErrors",
    "RelativeErrors",
    "TrajectoryErrors",
    "compare_labels",
    "plane_errors",
    "trajectory_errors",
]

# Labels above are renumbered by sorting the pixels, others by a table of all labels.
LARGEST_LISTED = 1 << 22


@dataclass(frozen=True, eq=False)
class HooverCounts:
    """Hoover's five counts, and the regions that they count.

    Attributes
    ----------
    correct, over_segmented, under_segmented, missed, noise : int
        Numbers of regions: of the prediction for ``under_segmented`` and ``noise``, of the truth for the others.
    correct_pairs : (correct, 2) int64
        Label of the truth, label of the prediction.
    missed_labels : (missed,) int64
        Of the truth.
    noise_labels : (noise,) int64
        Of the prediction.
    """

    correct: int
    over_segmented: int
    under_segmented: int
    missed: int
    noise: int
    correct_pairs: NDArray[np.int64] = field(repr=False)
    missed_labels: NDArray[np.int64] = field(repr=False)
    noise_labels: NDArray[np.int64] = field(repr=False)


@dataclass(frozen=True, eq=False)
class DetectionScores:
    """Regions matched one to one at a threshold on intersection over union.

    Attributes
    ----------
    precision, recall, f_score : float
        Matches as a share of the predicted regions, and of the true ones; the harmonic mean of both.
    panoptic_quality : float
        ``f_score`` times ``matched_iou``.
    matched_iou : float
        Mean intersection over union of the matched pairs; 0 where there are none.
    pairs : (matches, 2) int64
        Label of the truth, label of the prediction.
    """

    precision: float
    recall: float
    f_score: float
    panoptic_quality: float
    matched_iou: float
    pairs: NDArray[np.int64] = field(repr=False)


@dataclass(frozen=True, eq=False, repr=False)
class LabelComparison:
    """A predicted segmentation beside the true one; made by `compare_labels`.

    Attributes
    ----------
    table : (T + 1, P + 1) int64
        Pixels shared by true region i and predicted region j; row and column 0 are "none".
    truth_labels : (T,) int64
        The true labels of rows 1..T, ascending.
    predicted_labels : (P,) int64
        The predicted labels of columns 1..P, ascending.
    """

    table: NDArray[np.int64]
    truth_labels: NDArray[np.int64]
    predicted_labels: NDArray[np.int64]

    def __repr__(self) -> str:
        regions = f"{len(self.truth_labels)} true and {len(self.predicted_labels)} predicted regions"
        return f"<LabelComparison: {regions}, {self.table.sum()} pixels>"

    @property
    @kept
    def truth_sizes(self) -> NDArray[np.int64]:
        """(T,) int64: pixels of each true region."""
        return np.asarray(self.table[1:].sum(axis=1))

    @property
    @kept
    def predicted_sizes(self) -> NDArray[np.int64]:
        """(P,) int64: pixels of each predicted region."""
        return np.asarray(self.table[:, 1:].sum(axis=0))

    @property
    @kept
    def iou(self) -> NDArray[np.float64]:
        """(T, P) float64: intersection over union of every pair of regions."""
        shared = self.table[1:, 1:]
        return np.asarray(shared / (self.truth_sizes[:, None] + self.predicted_sizes[None, :] - shared))

    def hoover(self, tolerance: float = 0.8) -> HooverCounts:
        """Correct, over- and under-segmented, missed and noise regions.

        A region that could count under several heads counts under the one whose mean share of overlap is
        highest, as in the paper.

        Parameters
        ----------
        tolerance : float
            Share of the pixels that must agree, above 0.5 and at most 1.

        Raises
        ------
        TypeError, ValueError
            The tolerance is not a number above 0.5 and at most 1.

        Notes
        -----
        Hoover et al., "An experimental comparison of range image segmentation algorithms", PAMI 18(7),
        1996, section 3.
        """
        tolerance = number("tolerance", tolerance, finite=False)
        if not 0.5 < tolerance <= 1.0:
            raise ValueError(f"tolerance must be above 0.5 and at most 1, got {tolerance}")
        shared = self.table[1:, 1:]
        truth_share = shared / self.truth_sizes[:, None]
        predicted_share = shared / self.predicted_sizes[None, :]

        # Every possible instance: its mean share, its kind, its true regions, its predicted regions.
        instances: list[tuple[float, int, NDArray[np.int64], NDArray[np.int64]]] = []
        for i, j in np.argwhere((truth_share >= tolerance) & (predicted_share >= tolerance)):
            instances.append((0.5 * (truth_share[i, j] + predicted_share[i, j]), 0, np.array([i]), np.array([j])))
        inside = predicted_share >= tolerance  # predicted region j lies in true region i
        for i in np.flatnonzero(inside.sum(axis=1) >= 2):
            parts = np.flatnonzero(inside[i])
            total = shared[i, parts].sum()
            if total / self.truth_sizes[i] >= tolerance:
                share = 0.5 * (total / self.predicted_sizes[parts].sum() + total / self.truth_sizes[i])
                instances.append((share, 1, np.array([i]), parts))
        inside = truth_share >= tolerance  # true region i lies in predicted region j
        for j in np.flatnonzero(inside.sum(axis=0) >= 2):
            parts = np.flatnonzero(inside[:, j])
            total = shared[parts, j].sum()
            if total / self.predicted_sizes[j] >= tolerance:
                share = 0.5 * (total / self.truth_sizes[parts].sum() + total / self.predicted_sizes[j])
                instances.append((share, 2, parts, np.array([j])))

        truth_free = np.ones(len(self.truth_labels), dtype=bool)
        predicted_free = np.ones(len(self.predicted_labels), dtype=bool)
        counts = [0, 0, 0]
        pairs = []
        for _, kind, rows, columns in sorted(instances, key=lambda instance: (-instance[0], instance[1])):
            if truth_free[rows].all() and predicted_free[columns].all():
                truth_free[rows] = False
                predicted_free[columns] = False
                # An under-segmentation is counted once for the predicted region, as the paper counts it.
                counts[kind] += 1
                if kind == 0:
                    pairs.append((self.truth_labels[rows[0]], self.predicted_labels[columns[0]]))
        return HooverCounts(
            correct=counts[0],
            over_segmented=counts[1],
            under_segmented=counts[2],
            missed=int(truth_free.sum()),
            noise=int(predicted_free.sum()),
            correct_pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
            missed_labels=self.truth_labels[truth_free],
            noise_labels=self.predicted_labels[predicted_free],
        )

    def detection(self, iou: float = 0.5) -> DetectionScores:
        """Precision, recall, F and panoptic quality of the regions that match at `iou` or better.

        Each region is matched at most once. Above 0.5 there is only one way to do that; below, there are as many
        matches as possible, and of those the best.

        Parameters
        ----------
        iou : float
            Threshold on intersection over union, above 0 and at most 1.

        Raises
        ------
        TypeError, ValueError
            The threshold is not a number above 0 and at most 1.

        Notes
        -----
        Panoptic quality: Kirillov et al., CVPR 2019. Precision and recall as EVOPS (Kornilova et al.,
        2022) counts them, whose threshold is 0.75. Where both sides have no region, all scores are 1.
        """
        iou = number("iou", iou, finite=False)
        if not 0.0 < iou <= 1.0:
            raise ValueError(f"iou must be above 0 and at most 1, got {iou}")
        matches = self.iou >= iou
        if iou > 0.5:
            rows, columns = np.nonzero(matches)
        else:
            from scipy.optimize import linear_sum_assignment

            # One more match outweighs any gain in overlap.
            gain = np.where(matches, 1.0 + min(self.iou.shape, default=0) - (1.0 - self.iou), 0.0)
            rows, columns = linear_sum_assignment(gain, maximize=True)
            chosen = matches[rows, columns]
            rows, columns = rows[chosen], columns[chosen]
        true_count, predicted_count, count = len(self.truth_labels), len(self.predicted_labels), len(rows)
        total = true_count + predicted_count
        overlap = float(self.iou[rows, columns].sum())
        return DetectionScores(
            precision=count / predicted_count if predicted_count else float(true_count == 0),
            recall=count / true_count if true_count else float(predicted_count == 0),
            f_score=2.0 * count / total if total else 1.0,
            panoptic_quality=2.0 * overlap / total if total else 1.0,
            matched_iou=overlap / count if count else 0.0,
            pairs=np.column_stack([self.truth_labels[rows], self.predicted_labels[columns]]),
        )

    @property
    def rand_index(self) -> float:
        """Share of the pairs of pixels on which both segmentations agree.

        Over the pixels that the truth labels; predicted "none" is one more segment there.
        """
        table = self.table[1:].astype(np.float64)
        pixels = table.sum()
        if pixels < 2:
            return 1.0
        squares = (table**2).sum()
        rows = (table.sum(axis=1) ** 2).sum()
        columns = (table.sum(axis=0) ** 2).sum()
        return float(1.0 - (rows + columns - 2.0 * squares) / (pixels * (pixels - 1.0)))

    @property
    def variation_of_information(self) -> float:
        """H(truth | prediction) + H(prediction | truth) in bits (Meila 2007); 0 is agreement.

        Over the pixels that the truth labels; predicted "none" is one more segment there.
        """
        table = self.table[1:].astype(np.float64)
        pixels = table.sum()
        if pixels == 0:
            return 0.0
        rows, columns = np.nonzero(table)
        shared = table[rows, columns]
        truth_share = table.sum(axis=1)[rows] / shared
        predicted_share = table.sum(axis=0)[columns] / shared
        return float((shared * (np.log2(truth_share) + np.log2(predicted_share))).sum() / pixels)

    @property
    def covering(self) -> float:
        """Mean over the truth's pixels of the best overlap of their region (Arbelaez et al. 2011)."""
        if self.truth_sizes.sum() == 0:
            return 1.0
        if len(self.predicted_labels) == 0:
            return 0.0
        return float((self.truth_sizes * self.iou.max(axis=1)).sum() / self.truth_sizes.sum())


def compare_labels(predicted: ArrayLike, truth: ArrayLike, ignore: ArrayLike | None = None) -> LabelComparison:
    """Put a predicted segmentation beside the true one.

    Parameters
    ----------
    predicted, truth : (H, W) int
        Labels, 0 for none. They need not be consecutive.
    ignore : (H, W) bool, optional
        Pixels that do not count, such as those that nobody has labelled where only some planes were. Nor does a
        predicted region of which more than half is there.

    Returns
    -------
    LabelComparison
        From which every score is read.

    Raises
    ------
    TypeError
        If the labels are not integers, or masked, or ``ignore`` is no mask.
    ValueError
        If the shapes differ or a label is negative.
    """
    columns, predicted_labels = _consecutive(label_array("predicted", predicted), "predicted")
    rows, truth_labels = _consecutive(label_array("truth", truth), "truth")
    if rows.shape != columns.shape:
        raise ValueError(f"predicted and truth must have one shape, got {columns.shape} and {rows.shape}")
    if ignore is not None:
        mask = plain_array("ignore", ignore)
        if mask.dtype != np.bool_:
            raise TypeError(f"ignore must be a mask, an array of bool, got dtype {mask.dtype}")
        if mask.shape != rows.shape:
            raise ValueError(f"ignore must have the shape of the labels, {rows.shape}, got {mask.shape}")
        counts = ~mask
        sizes = np.bincount(columns.ravel(), minlength=1)
        is_ignored = 2 * np.bincount(columns[counts], minlength=len(sizes)) < sizes
        columns = np.where(is_ignored, 0, np.arange(len(sizes)))[columns[counts]]
        (columns, left), (rows, seen) = _consecutive(columns, "predicted"), _consecutive(rows[counts], "truth")
        predicted_labels, truth_labels = predicted_labels[left - 1], truth_labels[seen - 1]
    height, width = len(truth_labels) + 1, len(predicted_labels) + 1
    flat = np.bincount((rows * np.intp(width) + columns).ravel(), minlength=height * width)
    return LabelComparison(flat.reshape(height, width), truth_labels, predicted_labels)


def _consecutive(given: NDArray[np.generic], name: str) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Labels renumbered 0 (none), 1..N, and the old label of each."""
    labels: NDArray[np.intp] = given.astype(np.intp)
    if labels.size and labels.min() < 0:
        which = "labels of 2**63 or more" if given.dtype.kind == "u" else "negative labels"
        raise ValueError(f"{name} must not hold {which}, got {given[labels < 0][0]}")
    if labels.size and labels.max() >= LARGEST_LISTED:
        values, inverse = np.unique(labels, return_inverse=True)
        return inverse.reshape(labels.shape) + (values[0] != 0), values[values > 0].astype(np.int64)
    present = np.bincount(labels.ravel(), minlength=1) > 0
    present[0] = True
    if present.all():
        return labels, np.arange(1, len(present), dtype=np.int64)
    number = np.cumsum(present) - 1
    return number[labels], np.flatnonzero(present)[1:].astype(np.int64)


@dataclass(frozen=True, eq=False)
class PlaneErrors:
    """How far planes are from the true ones, pair by pair.

    Attributes
    ----------
    angle_deg : (...) float64
        Between the normals, in degrees, 0 to 180.
    offset : (...) float64
        Predicted less true distance from the camera, in metres.
    """

    angle_deg: NDArray[np.float64]
    offset: NDArray[np.float64]


def plane_errors(predicted: ArrayLike, truth: ArrayLike) -> PlaneErrors:
    """Angle between the normals and difference of the offsets of pairs of planes.

    Parameters
    ----------
    predicted, truth : (..., 4) float
        Planes (nx, ny, nz, d), n of any length, as many of both; the sign of both is taken as it is.

    Returns
    -------
    PlaneErrors
        NaN where a plane is NaN.

    Raises
    ------
    TypeError, ValueError
        The shapes differ, or are not (..., 4), an array is masked or not of numbers, or a normal has no length.
    """
    first, second = shaped_array("predicted", predicted, (4,)), shaped_array("truth", truth, (4,))
    if first.shape != second.shape:
        raise ValueError(f"predicted and truth must have one shape, got {first.shape} and {second.shape}")
    first, second = _with_unit_normals("predicted", first), _with_unit_normals("truth", second)
    return PlaneErrors(*angle_and_offset(first, second))


def _with_unit_normals(name: str, planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 4) planes with normals of length 1."""
    largest = np.abs(planes[..., :3]).max(axis=-1, keepdims=True)  # whose square may be too large, or too small
    without = planes[largest[..., 0] == 0.0]
    if len(without):
        raise ValueError(f"expected planes with a normal in {name}, got {without[0].tolist()}")
    scaled = planes / largest
    return np.asarray(scaled / np.linalg.norm(scaled[..., :3], axis=-1, keepdims=True))
