"""Segmentation: holes, gaps and thin things in front do not cut a plane in two, and other gaps do."""

from dataclasses import replace

import numpy as np
import pytest
from segment_frames import CAMERA

from rgbd_planes import Camera, fit_labels, segment
from rgbd_planes._core.status import Reason
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels
from rgbd_planes.kernels.segmentation.components.occlusion_gaps import find_coplanar
from rgbd_planes.kernels.segmentation.merge.contacts import contract, neighbours
from rgbd_planes.segmentation.workspace import Workspace, rays_of


def test_holes_and_thin_gaps_do_not_cut_a_plane():
    rng = np.random.default_rng(8)
    depth = 1.0 / (0.7 + 0.1 * CAMERA.tan_x + rng.normal(0.0, 1e-3, CAMERA.shape))
    depth[rng.random(depth.shape) < 0.3] = 0.0
    depth[:, 100:102] = 0.0
    found = segment(depth, CAMERA)
    assert len(found) == 1
    assert ((found.reason == Reason.MISSING) == (depth == 0)).all()
    assert (found.labels[depth > 0] == 1).mean() > 0.99


@pytest.mark.parametrize(
    ("between", "right", "wall_parts"),
    [
        (0.9, 0.5, 1),  # a pole before one wall
        (0.0, 0.5, 1),  # nothing was measured there
        (0.3, 0.5, 2),  # one sees through: two walls beside each other
        (0.9, 0.53, 2),  # the wall on the right is nearer
        (0.9, 0.5016, 2),  # by a deviation and a half
        (0.9, 0.5003, 1),  # by a third of one
    ],
)
def test_what_a_thin_thing_separates_is_one_plane(between, right, wall_parts):
    rng = np.random.default_rng(16)
    q = np.full(CAMERA.shape, 0.5)
    q[:, 150:170] = between
    q[:, 170:] = right
    with np.errstate(divide="ignore"):
        depth = 1.0 / np.where(q > 0.0, q + rng.normal(0.0, 1e-3, q.shape), 0.0)
    depth[~np.isfinite(depth)] = 0.0
    found = segment(depth, CAMERA)
    assert len({*found.labels[20:220:20, 50], *found.labels[20:220:20, 250]}) == wall_parts
    assert found.labels.max() == len(found) == wall_parts + (between > 0.0)
    assert np.bincount(found.labels.ravel())[1:].tolist() == found.sizes.tolist()
    left = found.labels[100, 50]
    assert found.planes[left - 1, 3] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize(("share", "parts"), [(0.05, 1), (0.2, 2)])
def test_through_a_thin_thing_one_may_see_here_and_there(share, parts):
    # Something farther away than the wall, in some rows: where it is in many, the wall itself has a gap.
    rng = np.random.default_rng(16)
    q = np.full(CAMERA.shape, 0.5)
    q[:, 150:170] = 0.9
    q[rng.permutation(CAMERA.height)[: int(share * CAMERA.height)], 150:170] = 0.3
    labels = segment(1.0 / (q + rng.normal(0.0, 1e-3, q.shape)), CAMERA).labels
    assert len({labels[120, 50], labels[120, 250]}) == parts


@pytest.mark.parametrize(("deviations", "parts"), [(3.0, 1), (6.0, 2)])
def test_what_is_seen_beside_a_thin_thing_is_farther_by_more_than_the_noise(deviations, parts):
    rng = np.random.default_rng(16)
    q = np.full(CAMERA.shape, 0.5)
    q[:, 150:170] = 0.9
    q += rng.normal(0.0, 1e-3, q.shape)
    q[:, 160] = 0.5 - deviations * 1e-3
    labels = segment(1.0 / q, CAMERA, noise=1e-3).labels
    assert len({labels[120, 50], labels[120, 250]}) == parts


@pytest.mark.parametrize("deviations", [-4.0, 4.0])
@pytest.mark.parametrize(
    ("rows", "columns", "goes"),
    [
        (slice(100, 108), slice(196, 200), True),
        (slice(100, 108), slice(96, 100), False),  # amid the wall: the sensor's error, for all that it shows
        (slice(100, 103), slice(196, 200), False),  # of twelve pixels
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_a_face_too_small_for_a_plane_is_not_the_large_one_beside_it(deviations, rows, columns, goes, turned):
    camera = replace(CAMERA, width=240, height=320, cx=119.5, cy=159.5) if turned else CAMERA
    rng = np.random.default_rng(3)
    q = np.where(np.arange(320) < 200, 0.5, 0.7) + 1e-3 * rng.standard_normal((240, 320))
    face = np.s_[rows, columns]
    q[face] = 0.5 + 1e-3 * deviations + 1e-4 * rng.standard_normal(q[face].shape)
    if turned:
        q, face = q.T, face[::-1]
    found = segment(1.0 / q, camera, noise=1e-3)
    here = np.zeros(q.shape, bool)
    here[face] = True
    wall, other = found.labels[0, 0], found.labels[-1, -1]
    expected = np.where(here & goes, 0, np.where(q < 0.6, wall, other))
    assert np.count_nonzero(found.labels != expected) <= 2  # noise of the wall that touches the face and looks like it
    assert len(found) == 2
    np.testing.assert_array_equal(found.sizes, np.bincount(found.labels.ravel())[1:])
    assert set(found.reason[here].tolist()) == {Reason.UNCLAIMED if goes else Reason.PLANE}
    np.testing.assert_allclose(found.alpha, fit_labels(1.0 / q, camera, found.labels).alpha, rtol=0.0, atol=1e-4)
    if goes:  # nor does a plane shrink below what is asked for
        least = int(found.sizes[wall - 1]) + 16
        kept = segment(1.0 / q, camera, noise=1e-3, min_size=least)
        assert kept.sizes.max() == least


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_strip_that_agrees_with_two_planes_does_not_make_them_one(mirrored):
    # Two walls meet behind a strip that hides the corner, with gaps beside it: within the 4e-4 of 1/Z that exact frames
    # may be rough, it agrees with either wall, while one plane through both walls would be twenty deviations off.
    away = np.abs(np.arange(CAMERA.width) - 160.0)
    row = 0.5 - 4e-5 * np.where(away < 14.0, 0.0, away)
    row[(away >= 14.0) & (away < 26.0)] = 0.0
    q = np.broadcast_to(row[::-1] if mirrored else row, CAMERA.shape)
    labels = segment(np.divide(1.0, q, out=np.zeros_like(q), where=q > 0.0), CAMERA).labels
    left, strip, right = labels[120, [50, 160, 270]]
    assert left != right
    assert strip in (left, right)


@pytest.mark.parametrize("between", [0.0, 0.9])
def test_a_wall_behind_many_bars_is_one_plane(between):
    rng = np.random.default_rng(21)
    q = np.full(CAMERA.shape, 0.5) + rng.normal(0.0, 1e-3, CAMERA.shape)
    bars = np.arange(CAMERA.width) % 16 >= 12  # the wall shows in twenty parts
    q[:, bars] = between
    depth = np.divide(1.0, q, out=np.zeros_like(q), where=q > 0.0)
    assert len(np.unique(segment(depth, CAMERA).labels[:, ~bars])) == 1


def test_what_a_grid_leaves_of_a_wall_is_compared_with_what_is_beside_it():
    # Of thousands of parts every one with every other would take seconds, and gigabytes.
    side = 12
    u, v = np.meshgrid(np.linspace(-0.02, 0.02, 12), np.linspace(-0.02, 0.02, 12))
    terms = np.stack([np.ones(u.size), u.ravel(), v.ravel(), np.full(u.size, 0.5)])
    moments = np.tile((terms @ terms.T)[np.triu_indices(4)], (side * side, 1))
    row, column = np.divmod(np.arange(side * side), side)
    box = 4 * np.stack([4 * row, 4 * row + 3, 4 * column, 4 * column + 3], axis=1)
    pairs = np.zeros((side**4, 2), np.int64)
    alpha, deviation = np.tile([0.0, 0.0, 0.5], (side * side, 1)), np.full(side * side, 1e-3)
    count = find_coplanar(moments, alpha, deviation, box, 2.0, 30.0, pairs)
    found = {tuple(sorted(pair)) for pair in pairs[:count].tolist()}
    place = np.arange(side * side).reshape(side, side)
    beside = {*zip(place[:, :-1].ravel(), place[:, 1:].ravel(), strict=True)}
    below = {*zip(place[:-1].ravel(), place[1:].ravel(), strict=True)}
    assert found == beside | below
    assert count == len(found)


def test_a_large_thing_leaves_two_planes():
    rng = np.random.default_rng(17)
    q = np.full(CAMERA.shape, 0.5)
    q[:, 20:300] = 0.8
    found = segment(1.0 / (q + rng.normal(0.0, 1e-3, q.shape)), CAMERA)
    assert len(found) == 3


@pytest.mark.parametrize(("rows", "parts"), [(30, 2), (90, 1)])
def test_a_waist_is_thin_where_it_is_longer_than_wide(rows, parts):
    # It is 60 pixels wide there, and far wider in all other rows.
    rng = np.random.default_rng(16)
    q = np.full(CAMERA.shape, 0.5)
    q[:, 30:290] = 0.9
    waist = q[100 : 100 + rows]
    waist[:, :130] = waist[:, 190:] = 0.5
    labels = segment(1.0 / (q + rng.normal(0.0, 1e-3, q.shape)), CAMERA).labels
    assert len({labels[105, 50], labels[105, 250]}) == parts


@pytest.mark.parametrize("side", [12, 16, 20, 24])
def test_planes_within_small_masks_are_found(side, rng):
    # Hardly a square of 8 pixels is measured.
    depth = scenes.plane((0.2, 0.3, -1.0), 1.5).render(CAMERA).measure()
    for row, column in rng.integers(0, CAMERA.height - side, (8, 2)):
        mask = np.zeros(CAMERA.shape, bool)
        mask[row : row + side, column : column + side] = True
        found = segment(np.where(mask, depth, 0), CAMERA)
        np.testing.assert_array_equal(found.labels, mask)


@pytest.mark.parametrize(("measured", "of"), [(2, 4), (2, 5), (3, 6)])
def test_planes_go_on_across_three_missing_rows(measured, of):
    rendering = scenes.room().render(CAMERA)
    depth = rendering.measure(quantise=False)
    depth[np.arange(CAMERA.height) % of >= measured] = np.nan
    found = segment(depth, CAMERA)
    truth = np.where(np.isfinite(depth), rendering.labels, 0)
    assert compare_labels(found.labels, truth).hoover(0.8).correct >= 12


def test_planes_of_sparse_pixels():
    # A block in four has more than half of its pixels: runs of blocks and of pixels make one part.
    rng = np.random.default_rng(14)
    depth = 1.0 / (0.7 + 0.1 * CAMERA.tan_x + rng.normal(0.0, 1e-3, CAMERA.shape))
    measured = rng.random(depth.shape) < 0.45
    depth[~measured] = 0.0
    found = segment(depth, CAMERA)
    assert len(found) == 1
    assert found.sizes[0] == np.count_nonzero(found.labels)
    assert (found.labels[measured] == 1).mean() > 0.99
    assert ((found.reason == Reason.MISSING) == ~measured).all()


@pytest.mark.parametrize("distortion", [(), (0.1, -0.05, 0.001, -0.001, 0.01)])
@pytest.mark.parametrize("regions", [2, 3, 40, 4000])
def test_regions_touch_at_sides_and_corners_and_over_a_gap_of_one_block(regions, distortion):
    camera = Camera(**{**CAMERA.to_dict(), "distortion": distortion})
    rays, work = rays_of(camera), Workspace(camera)
    rows, columns = work.blocks
    region = np.random.default_rng(regions).integers(-1, regions, (rows, columns)).astype(np.int32)
    region[5:20, 30:60] = -1
    region[25:32, 10:18] = 1
    count = neighbours(region, rays, work.contacts)

    u, v = (np.broadcast_to(of, region.shape) for of in (rays.centre_u, rays.centre_v))
    expected: dict[tuple[int, int], np.ndarray] = {}
    for row, column in np.ndindex(rows, columns):
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            for far in (1, 2):
                r, c = row + far * down, column + far * right
                if not (0 <= r < rows and 0 <= c < columns) or region[r, c] >= 0:
                    break
            if not (0 <= r < rows and 0 <= c < columns) or min(region[row, column], region[r, c]) < 0:
                continue
            a, b = sorted((region[row, column], region[r, c]))
            at_sides = {region[row, c], region[r, column]} & {a, b} if far == 1 and down and right else ()
            if a != b and not at_sides:  # corners count only where sides do not touch
                middle = 1.0, (u[row, column] + u[r, c]) / 2.0, (v[row, column] + v[r, c]) / 2.0
                expected[a, b] = expected.get((a, b), 0.0) + np.array(middle)
    pairs = work.contacts.pairs[:count, :2]
    assert [(a, b) for a, b in pairs] == list(expected)
    assert work.contacts.where[:count] == pytest.approx(np.array(list(expected.values())))


@pytest.mark.parametrize("regions", [40, 4000])
def test_regions_that_were_joined_touch_where_their_parts_did(regions, rng):
    """And so they touch the same regions as if they had always been one; there, corners of parts would not count."""
    rays, work, again = rays_of(CAMERA), Workspace(CAMERA), Workspace(CAMERA)
    region = rng.integers(-1, regions, work.blocks).astype(np.int32)
    parent = np.minimum(rng.integers(0, regions, regions), np.arange(regions))
    for i in range(regions):  # each the root of its own, or one that comes before it
        parent[i] = parent[parent[i]]
    first = neighbours(region, rays, work.contacts)
    expected: dict[tuple[int, int], np.ndarray] = {}
    for (a, b), where in zip(parent[work.contacts.pairs[:first, :2]], work.contacts.where[:first], strict=True):
        if a != b:
            expected[min(a, b), max(a, b)] = expected.get((min(a, b), max(a, b)), 0.0) + where
    count = contract(work.contacts, first, parent, np.ones(regions, np.bool_))
    pairs = [(a, b) for a, b in work.contacts.pairs[:count, :2]]
    assert pairs == list(expected)
    assert work.contacts.where[:count] == pytest.approx(np.array(list(expected.values())))
    joined = np.where(region >= 0, parent[region], -1).astype(np.int32)
    found = again.contacts.pairs[: neighbours(joined, rays, again.contacts), :2]
    assert {*pairs} == {(a, b) for a, b in found}


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize(("pixels", "planes"), [(1, 1), (2, 1), (3, 1), (4, 2)])
def test_a_slit_cuts_a_wall_in_two_wherever_it_is(upright, pixels, planes):
    # Where blocks begin and end must not matter. What is seen through a slit of three pixels may be a stray.
    rng = np.random.default_rng(1)
    camera = Camera(160, 120, 130.0, 130.0, 79.5, 59.5)
    for place in range(50, 54):
        q = np.full(camera.shape, 0.5)
        (q.T if upright else q)[place : place + pixels] = 0.1
        assert len(segment(1.0 / (q + rng.normal(0.0, 1e-3, q.shape)), camera)) == planes


def test_a_pole_within_a_block_leaves_the_wall_one():
    # What it leaves of the wall on either side are two pieces of one share.
    rng = np.random.default_rng(2)
    for place in range(100, 104):
        q = np.full(CAMERA.shape, 0.5)
        q[:, place : place + 2] = 1.5
        q[:, 200:] = 0.7
        found = segment(1.0 / (q + rng.normal(0.0, 1e-3, q.shape)), CAMERA)
        assert len(found) == 2
        assert found.labels[120, 90] == found.labels[120, 110] > 0


def test_holes_leave_planes_as_wide_as_they_are():
    # Two missing pixels side by side are no end of a run: narrow planes would be left out.
    for share in (0.05, 0.2, 0.4):
        rendering = scenes.room().render(CAMERA)
        full, holed = (
            compare_labels(segment(depth, CAMERA).labels, np.where(depth > 0, rendering.labels, 0)).hoover(0.8).correct
            for depth in (rendering.measure(seed=4), rendering.measure(seed=4, holes=share))
        )
        assert holed >= full - 2


def share_of_strips(wide, deviations, holes):
    """How much of a strip of so many pixels, so many deviations before a wall, is found, in the mean."""
    camera = Camera(160, 120, 131.0, 131.0, 79.5, 59.5)
    row, column = np.indices(camera.shape)
    found = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        for angle in np.linspace(0.05, 1.5, 10):
            off = (row - 60 - 0.37 * seed) * np.cos(angle) - (column - 80) * np.sin(angle)
            thin = np.abs(off) < 0.5 * wide
            q = 0.5 + 1e-3 * (deviations * thin + rng.standard_normal(camera.shape))
            measured = rng.random(camera.shape) > holes
            labels = segment(np.where(measured, 1.0 / q, np.nan), camera).labels
            wall = np.bincount(labels[measured & ~thin]).argmax()
            found.append(((labels > 0) & (labels != wall))[measured & thin].mean())
    return np.mean(found)


def test_a_thin_faint_plane_with_holes_keeps_the_blocks_of_which_it_has_some():
    # Of few blocks it has nearly all. A tenth is found where only blocks stay its own of which it has nearly all.
    assert share_of_strips(7, 6.0, 0.3) > 0.18


def test_a_wall_does_not_keep_the_blocks_of_a_thin_plane():
    # It has a quarter of many of them. Where it keeps these, five of six are found.
    assert share_of_strips(5, 20.0, 0.0) > 0.88
