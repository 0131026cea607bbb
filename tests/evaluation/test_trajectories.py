"""Errors of trajectories: hand-made cases, and the numbers of evo."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rgbd_planes import metrics


def walk(count: int, seed: int = 0, noise: float = 0.0) -> np.ndarray:
    """A smooth path; with noise, poses beside it."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    time = np.linspace(0.0, 3.0, count)
    turns = np.column_stack([0.2 * np.sin(time), 0.5 * time, 0.1 * np.cos(time)]) + noise * rng.normal(size=(count, 3))
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    places = np.column_stack([np.cos(time), 0.3 * time, np.sin(2.0 * time)])
    poses[:, :3, 3] = places + noise * rng.normal(size=(count, 3))
    return poses


def test_another_world_is_no_error() -> None:
    truth = walk(40)
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix(), [3.0, -2.0, 1.0]
    errors = metrics.trajectory_errors(world @ truth, truth)
    assert errors.absolute_rmse < 1e-12
    np.testing.assert_allclose(errors.T_truth_estimated, np.linalg.inv(world), atol=1e-9)
    assert [step.step for step in errors.relative] == [1, 30]
    assert max(step.translation_rmse for step in errors.relative) < 1e-12
    assert max(step.angle_rmse for step in errors.relative) < 1e-6


def test_relative_errors_of_a_path_that_is_too_long() -> None:
    truth = np.tile(np.eye(4), (11, 1, 1))
    truth[:, 0, 3] = 0.1 * np.arange(11)
    longer = truth.copy()
    longer[:, 0, 3] *= 1.02
    errors = metrics.trajectory_errors(longer, truth, steps=(1, 5))
    np.testing.assert_allclose(errors.relative[0].translation, 0.002)
    np.testing.assert_allclose(errors.relative[1].translation, 0.01)
    assert len(errors.relative[1].translation) == 6
    assert errors.path_length == pytest.approx(1.0)
    np.testing.assert_allclose(errors.absolute, np.abs(0.002 * (np.arange(11) - 5)), atol=1e-12)


def test_a_turn_is_an_angle() -> None:
    truth = np.tile(np.eye(4), (2, 1, 1))
    for angle in (1e-5, 1.0, 179.9):
        turned = truth.copy()
        turned[1, :3, :3] = Rotation.from_rotvec([0.0, np.radians(angle), 0.0]).as_matrix()
        assert metrics.trajectory_errors(turned, truth).relative[0].angle_deg[0] == pytest.approx(angle)


def test_poses_that_are_not_known_do_not_count() -> None:
    truth = walk(20)
    estimated = truth.copy()
    estimated[3], truth[7] = np.nan, np.inf
    errors = metrics.trajectory_errors(estimated, truth, steps=(1, 40))
    assert np.flatnonzero(np.isnan(errors.absolute)).tolist() == [3, 7]
    assert errors.absolute_rmse < 1e-12
    assert len(errors.relative[0].translation) == 19 - 4
    assert np.isnan(errors.relative[1].translation_rmse)
    assert "no pairs" in repr(errors)


def test_errors_over_a_second_are_of_frames_a_second_apart() -> None:
    """At 10 frames a second, of which one is missing: the motions that would end or begin there are left out."""
    kept = np.delete(np.arange(40), 17)
    truth, estimated = walk(40)[kept], walk(40, 1, 0.02)[kept]
    stamps = 1e9 + 0.1 * kept + np.random.default_rng(0).uniform(-0.02, 0.02, 39)
    errors = metrics.trajectory_errors(estimated, truth, steps=(1,), timestamps=stamps, seconds=(1.0, 60.0))
    assert [each.over for each in errors.relative] == ["1 frame", "1 s", "60 s"]
    pairs = [(i, i + 10) for i in range(30) if i not in (7, 17)]
    place = {number: i for i, number in enumerate(kept.tolist())}
    expected = []
    for first, last in pairs:
        i, j = place[first], place[last]
        off = np.linalg.inv(np.linalg.inv(truth[i]) @ truth[j]) @ np.linalg.inv(estimated[i]) @ estimated[j]
        expected.append(np.linalg.norm(off[:3, 3]))
    np.testing.assert_allclose(errors.relative[1].translation, expected, rtol=1e-9)
    assert not len(errors.relative[2].translation)
    unknown = np.where(kept == 3, np.nan, stamps)
    again = metrics.trajectory_errors(estimated, truth, timestamps=unknown)
    assert len(again.relative[2].translation) == len(pairs) - 1
    for wrong, message in ((stamps[:5], "39 timestamps"), (stamps[::-1], "do not fall")):
        with pytest.raises(ValueError, match=message):
            metrics.trajectory_errors(estimated, truth, timestamps=wrong)
    with pytest.raises(ValueError, match="seconds"):
        metrics.trajectory_errors(estimated, truth, timestamps=stamps, seconds=(0.0,))


def test_what_is_no_trajectory() -> None:
    truth = walk(5)
    with pytest.raises(ValueError, match="same frames"):
        metrics.trajectory_errors(truth[:4], truth)
    with pytest.raises(ValueError, match="none of 5"):
        metrics.trajectory_errors(np.full_like(truth, np.nan), truth)
    with pytest.raises(ValueError, match="rigid motion"):
        metrics.trajectory_errors(2.0 * truth, truth)
    with pytest.raises(ValueError, match="steps"):
        metrics.trajectory_errors(truth, truth, steps=(0,))


@pytest.mark.filterwarnings("ignore")
def test_as_evo() -> None:
    pytest.importorskip("evo", reason="evo is not installed")
    from evo.core import metrics as evo_metrics
    from evo.core.trajectory import PosePath3D

    truth, estimated = walk(90), walk(90, 1, 0.02)
    ours = metrics.trajectory_errors(estimated, truth, steps=(1, 30), timestamps=5.0 + np.arange(90) / 30.0)
    reference, path = PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimated))
    for step in ours.relative:
        for relation, own in (("translation_part", step.translation), ("rotation_angle_deg", step.angle_deg)):
            error = evo_metrics.RPE(
                evo_metrics.PoseRelation[relation], step.step or 30, evo_metrics.Unit.frames, all_pairs=True
            )
            error.process_data((reference, path))
            np.testing.assert_allclose(own, error.error, rtol=1e-6, atol=1e-9)
    path.align(reference)
    absolute = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    absolute.process_data((reference, path))
    np.testing.assert_allclose(ours.absolute, absolute.error, rtol=1e-6)
    assert ours.absolute_rmse == pytest.approx(absolute.get_statistic(evo_metrics.StatisticsType.rmse))
