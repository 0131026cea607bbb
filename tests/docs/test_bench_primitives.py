"""The report on primitives: its bound, and real cylinders where there are real frames."""

import numpy as np
import pytest

import rgbd_planes as rp
from bench import primitives, real_data

UPRIGHT = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize("part", ["half", "third"])
@pytest.mark.parametrize("kind", [rp.Primitive.SPHERE, rp.Primitive.CYLINDER])
def test_the_bound_is_what_the_covariance_is_without_noise(kind, part):
    shape = primitives.Shape(kind, np.array([0.1, 0.05, 1.3]), 0.1, UPRIGHT)
    camera, rays, q, labels = primitives.seen(shape, part)
    fits = rp.fit_primitives(1.0 / q, camera, labels)
    assert fits.kind[0] == kind
    inside = labels.copy()
    inside[1:-1, 1:-1] &= np.lib.stride_tricks.sliding_window_view(labels, (3, 3)).all(axis=(2, 3))
    assert inside[[0, -1]].sum() + inside[:, [0, -1]].sum() == 0
    assert fits.valid_count[0] == inside.sum()
    assert fits.radius_std[0] == pytest.approx(shape.bound(rays[inside], rp.noise.KINECT_V1), rel=1e-3)


def test_a_few_frames_have_the_right_kinds():
    found = primitives.others(2)
    assert found["cone"]["none"] == found["saddle"]["none"] == 1.0
    depth, labels = primitives.frame_of_shapes()
    fits = rp.fit_primitives(depth, primitives.CAMERA, labels)
    assert list(fits.kind) == [rp.Primitive.CYLINDER, rp.Primitive.SPHERE] * 6


@pytest.mark.skipif(not (real_data.FOLDER / "mosd_cylinders").is_dir(), reason=real_data.REASON)
def test_one_object_has_one_radius_in_several_frames():
    found = primitives.real_cylinders(0.001)
    assert found["kinds"]["cylinder"] >= 25
    often = [group for group in found["groups"] if group["seen"] >= 3]
    assert len(often) >= 3
    assert all(group["std"] < 2e-3 for group in often)
