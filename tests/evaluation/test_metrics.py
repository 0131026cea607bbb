"""The measures of a segmentation, on cases small enough to be worked by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rgbd_planes.camera import presets
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels, plane_errors

SMALL_LABELS = arrays(np.int32, (5, 6), elements=st.integers(0, 4))


def row(*runs: tuple[int, int]) -> np.ndarray:
    """A one-row label image from runs (label, length)."""
    return np.concatenate([np.full(length, label, dtype=np.int32) for label, length in runs])[None, :]


def counts(predicted: np.ndarray, truth: np.ndarray, tolerance: float) -> tuple[int, ...]:
    hoover = compare_labels(predicted, truth).hoover(tolerance)
    return hoover.correct, hoover.over_segmented, hoover.under_segmented, hoover.missed, hoover.noise


def test_hoover_counts_each_kind() -> None:
    # Truth: 10 pixels of 1, 10 of 2, 5 of 3, 5 of 4, 10 of 5.
    truth = row((1, 10), (2, 10), (3, 5), (4, 5), (5, 10))
    # 1 is found but for a pixel; 2 is cut in two; 3 and 4 are one; 5 is hardly touched.
    predicted = row((7, 9), (0, 1), (8, 5), (9, 5), (3, 10), (4, 3), (0, 7))
    assert counts(predicted, truth, 0.8) == (1, 1, 1, 1, 1)
    comparison = compare_labels(predicted, truth)
    assert repr(comparison) == "<LabelComparison: 5 true and 5 predicted regions, 40 pixels>"
    hoover = comparison.hoover(0.8)
    assert repr(hoover) == "HooverCounts(correct=1, over_segmented=1, under_segmented=1, missed=1, noise=1)"
    assert hoover.correct_pairs.tolist() == [[1, 7]]
    assert hoover.missed_labels.tolist() == [5]
    assert hoover.noise_labels.tolist() == [4]


def test_hoover_tolerance_is_inclusive_on_both_sides() -> None:
    truth = row((1, 10), (0, 10))
    assert counts(row((1, 8), (0, 12)), truth, 0.8)[0] == 1
    assert counts(row((1, 8), (0, 12)), truth, 0.81)[0] == 0
    # Ten pixels of thirteen lie in the truth: 0.77 of the prediction.
    assert counts(row((1, 13), (0, 7)), truth, 0.76)[0] == 1
    assert counts(row((1, 13), (0, 7)), truth, 0.8)[0] == 0


def test_hoover_tolerance_is_inclusive_where_its_product_is_rounded_up() -> None:
    # 55 pixels of 100, in two parts; 0.55 * 100 is a little more than 55 in floating point.
    cut, whole = row((1, 30), (2, 25), (0, 45)), row((1, 100))
    assert counts(cut, whole, 0.55) == (0, 1, 0, 0, 0)
    assert counts(whole, cut, 0.55) == (0, 0, 1, 0, 0)


def test_hoover_chooses_the_better_of_two_readings() -> None:
    # 8 of 10 pixels in one part (mean share 0.9), all 10 in two parts (mean share 1): over-segmented.
    truth = row((1, 10))
    assert counts(row((1, 8), (2, 2)), truth, 0.8) == (0, 1, 0, 0, 0)
    # The second part spills out of the truth, and leaves the single match the better reading.
    assert counts(row((1, 9), (2, 1), (2, 5)), row((1, 10), (0, 5)), 0.8) == (1, 0, 0, 0, 1)
    # 60 of 100 pixels in one part (mean share 0.8), 70 with one that spills out by 8 (mean share 0.799).
    spilt, whole = row((1, 60), (0, 30), (2, 18)), row((1, 100), (0, 8))
    assert counts(spilt, whole, 0.55) == (1, 0, 0, 0, 1)
    assert counts(whole, spilt, 0.55) == (1, 0, 0, 1, 0)
    # 60 of 100 pixels in one part (mean share 0.8), 70 in two that are all inside (mean share 0.85).
    cut, whole = row((1, 60), (2, 10), (0, 30)), row((1, 100))
    assert counts(cut, whole, 0.55) == (0, 1, 0, 0, 0)
    assert counts(whole, cut, 0.55) == (0, 0, 1, 0, 0)


def test_hoover_parts_must_make_up_the_whole() -> None:
    # Two regions lie wholly in one, of which they are half: none of the three is found.
    cut, whole = row((1, 5), (2, 5), (0, 10)), row((1, 20))
    assert counts(cut, whole, 0.8) == (0, 0, 0, 1, 2)
    assert counts(whole, cut, 0.8) == (0, 0, 0, 2, 1)


@pytest.mark.parametrize("tolerance", [0.5, 1.01, float("nan")])
def test_hoover_refuses_other_tolerances(tolerance: float) -> None:
    with pytest.raises(ValueError, match=r"tolerance must be above 0\.5"):
        compare_labels(row((1, 3)), row((1, 3))).hoover(tolerance)


def test_detection_by_hand() -> None:
    truth = row((1, 10), (2, 10), (3, 4))
    predicted = row((1, 8), (2, 12), (0, 4))
    # IoU: 8 / 10, and 10 / 12; region 3 is missed.
    scores = compare_labels(predicted, truth).detection(0.75)
    assert scores.precision == 1.0
    assert scores.recall == pytest.approx(2 / 3)
    assert scores.f_score == pytest.approx(4 / 5)
    assert scores.panoptic_quality == pytest.approx((8 / 10 + 10 / 12) / 2.5)
    assert scores.matched_iou == pytest.approx((8 / 10 + 10 / 12) / 2)
    assert "pairs" not in repr(scores)
    assert compare_labels(predicted, truth).detection(0.82).pairs.tolist() == [[2, 2]]


def test_detection_below_one_half_matches_as_many_as_it_can() -> None:
    # 1 overlaps 1 (4 of 11) and 2 (3 of 9); 2 overlaps only 1 (3 of 10). Both are matched only as 1-2, 2-1.
    truth = row((1, 4), (1, 3), (2, 3), (2, 1), (0, 3))
    predicted = row((1, 4), (2, 3), (1, 3), (0, 1), (2, 3))
    scores = compare_labels(predicted, truth).detection(0.25)
    assert scores.pairs.tolist() == [[1, 2], [2, 1]]
    # 1 overlaps 1 by more (10 of 18) than 1 and 2, and 2 and 1, do together (4 of 16 each).
    truth = row((1, 10), (1, 4), (0, 2), (2, 4), (2, 2))
    predicted = row((1, 10), (2, 4), (2, 2), (1, 4), (0, 2))
    assert compare_labels(predicted, truth).detection(0.25).pairs.tolist() == [[1, 2], [2, 1]]
    # Two halves each have exactly one half of a region, which is matched once.
    halves = compare_labels(row((1, 5), (2, 5)), row((1, 10))).detection(0.5)
    assert len(halves.pairs) == 1
    assert (halves.precision, halves.recall) == (0.5, 1.0)


def test_scores_where_one_side_or_both_are_empty() -> None:
    none = np.zeros((2, 3), dtype=np.int32)
    both = compare_labels(none, none)
    assert both.detection().f_score == 1.0
    assert both.rand_index == 1.0
    assert both.variation_of_information == 0.0
    assert both.covering == 1.0
    missed = compare_labels(none, none + 1)
    assert (missed.detection().precision, missed.detection().recall, missed.covering) == (0.0, 0.0, 0.0)
    assert missed.hoover().missed == 1
    assert compare_labels(none + 1, none).hoover().noise == 1


def test_rand_index_by_hand() -> None:
    # Truth ab, cd; prediction a, bcd. Of six pairs: cd together in both, ac and ad apart in both.
    assert compare_labels(row((1, 1), (2, 3)), row((1, 2), (2, 2))).rand_index == pytest.approx(3 / 6)


def test_variation_of_information_by_hand() -> None:
    # Halving a segment costs one bit on its pixels, here half of them.
    truth = row((1, 8), (2, 8))
    predicted = row((1, 4), (3, 4), (2, 8))
    assert compare_labels(predicted, truth).variation_of_information == pytest.approx(0.5)
    assert compare_labels(truth, predicted).variation_of_information == pytest.approx(0.5)


def test_covering_by_hand() -> None:
    # Best overlap of region 1 is 6 / 10, of region 2 all of 5.
    comparison = compare_labels(row((1, 6), (3, 4), (2, 5)), row((1, 10), (2, 5)))
    assert comparison.covering == pytest.approx(11 / 15)


def test_unlabelled_truth_counts_in_the_size_of_a_region_only() -> None:
    comparison = compare_labels(row((1, 15)), row((1, 10), (0, 5)))
    assert comparison.predicted_sizes.tolist() == [15]
    assert comparison.iou.tolist() == [[10 / 15]]
    assert comparison.rand_index == 1.0


def test_labels_need_not_be_consecutive() -> None:
    comparison = compare_labels(row((10, 4), (70_000_000, 4)), row((20, 4), (250, 4)))
    assert comparison.truth_labels.tolist() == [20, 250]
    assert comparison.predicted_labels.tolist() == [10, 70_000_000]
    assert comparison.table.tolist() == [[0, 0, 0], [0, 4, 0], [0, 0, 4]]


def test_bad_labels_are_refused() -> None:
    with pytest.raises(TypeError, match="predicted must be integers, or a mask, got dtype float64"):
        compare_labels(np.zeros((2, 2)), np.zeros((2, 2), dtype=int))
    with pytest.raises(TypeError, match=r"expected truth as an array, got str: rgbd_planes\.images\.read_depth reads"):
        compare_labels(row((1, 2)), "labels.png")
    with pytest.raises(TypeError, match=r"expected predicted as an array, got Rendering: its \.labels are one"):
        compare_labels(scenes.room().render(presets.primesense()), row((1, 2)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="negative labels, got -1"):
        compare_labels(row((-1, 2)), row((1, 2)))
    with pytest.raises(ValueError, match=r"one shape, got \(1, 2\) and \(1, 3\)"):
        compare_labels(row((1, 2)), row((1, 3)))


@given(SMALL_LABELS, SMALL_LABELS)
def test_table_and_pairs_against_plain_loops(predicted: np.ndarray, truth: np.ndarray) -> None:
    comparison = compare_labels(predicted, truth)
    for i, label in enumerate(comparison.truth_labels):
        for j, other in enumerate(comparison.predicted_labels):
            assert comparison.table[i + 1, j + 1] == ((truth == label) & (predicted == other)).sum()
    kept = truth > 0
    a, b = truth[kept], predicted[kept]
    if len(a) >= 2:
        upper = np.triu_indices(len(a), 1)
        agree = (a[:, None] == a)[upper] == (b[:, None] == b)[upper]
        assert comparison.rand_index == pytest.approx(agree.mean())


@given(SMALL_LABELS)
def test_a_segmentation_agrees_with_itself(labels: np.ndarray) -> None:
    renamed = np.where(labels > 0, 9 - labels, 0)
    comparison = compare_labels(renamed, labels)
    present = len(np.unique(labels[labels > 0]))
    assert comparison.hoover(1.0).correct == present
    assert comparison.detection(1.0).panoptic_quality == 1.0
    assert str(comparison.variation_of_information) == "0.0"  # not -0.0
    assert comparison.rand_index == 1.0


@given(SMALL_LABELS, SMALL_LABELS, st.sampled_from([0.51, 0.8, 1.0]))
def test_either_side_may_be_the_truth(one: np.ndarray, other: np.ndarray, share: float) -> None:
    there, back = (compare_labels(*pair).detection(share) for pair in ((one, other), (other, one)))
    assert there.precision == back.recall
    assert there.panoptic_quality == pytest.approx(back.panoptic_quality)


def test_plane_errors() -> None:
    tilt = np.radians(1e-6)
    predicted = [[0.0, 0.0, -1.0, 1.5], [0.0, np.sin(tilt), -np.cos(tilt), 2.0], [0.0, -2.0, 0.0, 2.0]]
    truth = [[0.0, -1.0, 0.0, 1.0], [0.0, 0.0, -1.0, 2.0], [0.0, -1.0, 0.0, 1.0]]
    errors = plane_errors(predicted, truth)
    assert errors.angle_deg == pytest.approx([90.0, 1e-6, 0.0], rel=1e-6)
    assert errors.offset == pytest.approx([0.5, 0.0, 0.0])
    for scale in (1e-200, 1e200):  # of which the squares are 0, or infinite
        scaled = plane_errors(scale * np.array([1.0, 0.0, 0.0, 1.0]), scale * np.array([0.0, 1.0, 0.0, 1.5]))
        np.testing.assert_allclose([scaled.angle_deg, scaled.offset], (90.0, -0.5))
    single = plane_errors(predicted[0], truth[0])
    assert (single.angle_deg, single.offset) == (errors.angle_deg[0], errors.offset[0])
    with pytest.raises(ValueError, match=r"expected predicted of shape \(\.\.\., 4\), got \(1, 3\)"):
        plane_errors([[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match=r"must have one shape, got \(3, 4\) and \(4,\)"):
        plane_errors(predicted, truth[0])


def test_detection_below_one_half_takes_the_best_of_as_many() -> None:
    # Two pairs match either way: with 3 of 14 pixels each, or with 4 of 13.
    truth = row((1, 10), (2, 10))
    predicted = row((1, 3), (2, 4), (0, 3), (1, 4), (2, 3), (0, 3))
    scores = compare_labels(predicted, truth).detection(0.2)
    assert scores.pairs.tolist() == [[1, 2], [2, 1]]
    assert scores.matched_iou == pytest.approx(4 / 13)


@pytest.mark.parametrize("iou", [0.0, 1.01, float("nan")])
def test_detection_refuses_other_thresholds(iou: float) -> None:
    with pytest.raises(ValueError, match="iou must be above 0 and at most 1"):
        compare_labels(row((1, 3)), row((1, 3))).detection(iou)


def test_predicted_none_is_one_more_segment_where_the_truth_has_one() -> None:
    comparison = compare_labels(row((5, 2), (0, 2), (5, 1), (0, 1)), row((1, 4), (0, 2)))
    assert comparison.variation_of_information == pytest.approx(1.0)  # cut into halves
    assert comparison.rand_index == pytest.approx(2 / 6)


def test_ignored_pixels_do_not_count() -> None:
    """Nor do regions that lie mostly there; half is not most."""
    truth = row((7, 4), (0, 4))
    predicted = row((1, 3), (2, 2), (3, 1), (4, 2))  # half of region 2 is ignored, and all of 3 and 4
    comparison = compare_labels(predicted, truth, ignore=truth == 0)
    np.testing.assert_array_equal(comparison.predicted_labels, [1, 2])
    np.testing.assert_array_equal(comparison.truth_labels, [7])
    np.testing.assert_array_equal(comparison.table, [[0, 0, 0], [0, 3, 1]])
    scores = comparison.detection(0.7)
    assert (scores.precision, scores.recall) == (0.5, 1.0)
    np.testing.assert_array_equal(scores.pairs, [[7, 1]])
    predicted[0, 5] = 2  # more than half
    mostly = compare_labels(predicted, truth, ignore=truth == 0)
    np.testing.assert_array_equal(mostly.predicted_labels, [1])
    np.testing.assert_array_equal(mostly.table, [[0, 0], [1, 3]])


def test_without_ignored_pixels_nothing_changes(rng) -> None:
    truth, predicted = rng.integers(0, 5, (2, 30, 40))
    nothing = compare_labels(predicted, truth, ignore=np.zeros((30, 40), bool))
    np.testing.assert_array_equal(nothing.table, compare_labels(predicted, truth).table)
    everything = compare_labels(predicted, truth, ignore=np.ones((30, 40), bool))
    assert everything.table.tolist() == [[0]]
    assert everything.detection().pairs.shape == (0, 2)


def test_what_is_ignored_is_a_mask_of_the_labels_shape() -> None:
    labels = row((1, 3))
    with pytest.raises(TypeError, match="ignore must be a mask, an array of bool, got dtype int32"):
        compare_labels(labels, labels, ignore=labels * 0)
    with pytest.raises(ValueError, match=r"shape of the labels, \(1, 3\), got \(3,\)"):
        compare_labels(labels, labels, ignore=np.zeros(3, bool))
