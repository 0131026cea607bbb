"""Segmentation: who contends for a block, how contenders are weighed, and what regions have, against plain NumPy."""

import numpy as np
import pytest
from segment_frames import CAMERA

from rgbd_planes import Camera, scenes, segment
from rgbd_planes.kernels.segmentation.assign.contested_blocks import LANES, NEIGHBOURS, contenders, weigh_contenders
from rgbd_planes.kernels.segmentation.assign.whole_blocks import add_up
from rgbd_planes.kernels.segmentation.model.records import EMPTY, MIXED, Owners, Pyramid, Shares
from rgbd_planes.segmentation import regions as rounds
from rgbd_planes.segmentation.workspace import rays_of

FISHEYE = Camera(480, 480, 155.0, 155.0, 239.5, 239.5, distortion_model="fisheye")


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_contenders_are_the_regions_around_in_their_order(camera, rng):
    rays = rays_of(camera)
    rows, columns = rays.centre_v.shape[0], rays.centre_u.shape[1]
    around = np.full((rows + 2, columns + 2), -1, np.int32)
    coarse = rng.integers(-1, 4, (-(-rows // 2), -(-columns // 2)))
    region = around[1:-1, 1:-1]
    region[:] = np.kron(coarse, np.ones((2, 2)))[:rows, :columns]
    region[5:9, 5:9] = np.arange(16).reshape(4, 4)  # nine contenders
    listed = rng.choice(rows * columns, 70, replace=False).astype(np.int32)
    listed[0], listed[-1] = 6 * columns + 6, 0  # and a corner of the image
    u, v = (np.broadcast_to(of, region.shape) for of in (rays.centre_u, rays.centre_v))

    candidate, centre = np.empty(NEIGHBOURS, np.int64), np.empty((NEIGHBOURS, 3))
    for block in listed:
        row, column = divmod(int(block), columns)
        count = contenders(around, row, column, rays.centre_u, rays.centre_v, candidate, centre)
        nine = around[row : row + 3, column : column + 3].ravel()
        assert candidate[:count].tolist() == list(dict.fromkeys(nine[nine >= 0].tolist()))
        for a, found in zip(candidate[:count], centre, strict=False):
            y, x = np.divmod(np.flatnonzero(nine == a), 3)
            y, x = row + y - 1, column + x - 1
            assert found == pytest.approx((u[y, x].sum(), v[y, x].sum(), len(y)), rel=1e-12, abs=1e-12)


def test_contenders_are_weighed_by_their_variance():
    variance = np.exp(np.linspace(-80.0, 80.0, NEIGHBOURS * LANES)).astype(np.float32).reshape(NEIGHBOURS, LANES)
    mantissa, plane, penalty = np.empty(LANES, np.float32), *np.zeros((2, 4 * NEIGHBOURS, LANES), np.float32)
    weigh_contenders(
        NEIGHBOURS, variance, variance.view(np.int32), mantissa, mantissa.view(np.int32), plane, penalty[:NEIGHBOURS]
    )
    assert plane[3::4] == pytest.approx(1.0 / np.sqrt(variance.astype(np.float64)), rel=1e-6)
    assert penalty[:NEIGHBOURS] == pytest.approx(np.log(variance.astype(np.float64)), abs=1e-5)


REGIONS = 5


def test_all_that_regions_have_is_added_up(rng):
    """From blocks, from squares of 4x4 of them that one region has, and from shares."""
    shapes = np.array([[8, 12], [4, 6], [2, 3], [1, 2]])
    levels = [rng.random((10, 8, 12))]
    for rows, columns in shapes[1:3]:
        levels.append(levels[-1].reshape(10, rows, 2, columns, 2).sum(axis=(2, 4)))
    sums = np.concatenate([level.reshape(10, -1) for level in levels], axis=1)
    offsets = np.concatenate([[0], np.cumsum(shapes.prod(axis=1))])
    owner = np.kron(rng.integers(0, REGIONS, (2, 3)), np.ones((4, 4), int)).astype(np.int32)
    owner[:4, :4] = np.kron(rng.integers(0, REGIONS, (2, 2)), np.ones((2, 2), int))
    owner[4:6, 5:7] = MIXED, EMPTY
    shares = Shares(np.array([2, 1, 2], np.int32), np.ones(3, np.int32), rng.random((3, 10)))
    moments = np.full((REGIONS, 10), np.nan)
    add_up(Pyramid(sums, np.empty(0), np.empty(0), offsets, shapes), owner, shares, 2, moments)
    expected = np.array([sums[:, : owner.size][:, owner.ravel() == a].sum(axis=1) for a in range(REGIONS)])
    expected[2] += shares.moments[0]
    expected[1] += shares.moments[1]
    np.testing.assert_allclose(moments, expected, rtol=1e-12)


def test_moments_of_regions_are_those_of_what_they_have_after_each_round(monkeypatch):
    """Whatever merges, parts, spreads and moves on in between."""
    counts, assign = [], rounds.assign_pixels

    def checked(view, regions, *others):
        many = assign(view, regions, *others)
        moments, owners, block_moments = regions[1], Owners(*regions[3]), view[2][0]
        shares, expected = Shares(*others[-1]), np.zeros_like(moments)
        for row, column in np.ndindex(owners.block.shape):
            a, first = owners.block[row, column], owners.first[row, column]
            if a >= 0:
                expected[a] += block_moments[:, row * owners.block.shape[1] + column]
            elif a == MIXED:
                for s in range(first, first + owners.count[row, column]):
                    expected[shares.region[s]] += shares.moments[s]
        np.testing.assert_allclose(moments, expected, rtol=1e-9, atol=1e-9)
        counts.append(len(expected))
        return many

    monkeypatch.setattr(rounds, "assign_pixels", checked)
    camera = Camera(160, 120, 140.0, 140.0, 79.5, 59.5, depth_scale=1000.0)
    for seed, eye in enumerate([(0.35, -1.5, -0.2), (-0.8, -1.6, 0.0), (0.9, -1.2, 0.3)]):
        segment(scenes.room(eye).render(camera).measure(holes=0.1, seed=seed), camera)
    assert len(counts) == 9
    assert len({*counts}) > 1
