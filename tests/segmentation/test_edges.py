"""Segmentation: where planes end, and what is folded or curved."""

import numpy as np
import pytest
from scipy.ndimage import convolve, gaussian_filter
from segment_frames import CAMERA, smooth_noise, two_planes

from rgbd_planes import Camera, segment
from rgbd_planes._core.status import Reason
from rgbd_planes.evaluation import scenes
from rgbd_planes.evaluation.metrics import compare_labels
from rgbd_planes.kernels.segmentation.curved.curved import fit_two
from rgbd_planes.kernels.segmentation.model.quadrics import TERMS, group_turns


@pytest.mark.parametrize(("step", "expected"), [(0.02, 2), (0.0005, 1)])
def test_parallel_planes_stay_two_where_the_noise_allows(step, expected):
    rng = np.random.default_rng(6)
    q, truth = two_planes(CAMERA, step)
    found = segment(1.0 / (q + rng.normal(0.0, 1e-3, q.shape)), CAMERA)
    assert len(found) == expected
    if expected == 2:
        assert compare_labels(found.labels, truth).detection(0.95).recall == 1.0


def test_a_door_that_is_ajar_is_a_plane_of_its_own():
    # By five degrees, three metres away, with the noise of a Kinect.
    hinge, angle = np.array([-0.3, 0.0, 3.0]), np.radians(5.0)
    normal = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    q = (normal[0] * CAMERA.tan_x + normal[2]) / (normal @ hinge)
    from_hinge = CAMERA.tan_x / q - hinge[0]
    is_door = (from_hinge > 0.0) & (from_hinge < 0.9) & (np.abs(CAMERA.tan_y / q) < 0.9)
    q = np.where(is_door, q, 1.0 / 3.0)
    found = segment(1.0 / (q + 1.4e-3 * smooth_noise(1, 0.0)), CAMERA)
    assert compare_labels(found.labels, np.where(is_door, 2, 1)).detection(0.85).f_score == 1.0


def test_crease_is_where_the_planes_meet():
    # Two walls that meet in a vertical edge at column 160, each with four sigma of slope across the noise.
    u = CAMERA.tan_x
    q = 0.6 - 0.2 * np.abs(u - CAMERA.tan_x[0, 160])
    rng = np.random.default_rng(7)
    found = segment(1.0 / (q + rng.normal(0.0, 1.5e-3, q.shape)), CAMERA)
    assert len(found) == 2
    edge = (found.labels == found.labels[0, 0]).sum(axis=1)
    assert np.abs(edge - 160).mean() < 2.0
    assert edge.std() < 0.5  # straight: residuals alone leave it ragged


@pytest.mark.parametrize("degrees", [2.5, 3.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_shallow_edge_is_where_the_planes_meet_too(degrees, seed):
    """Squares of up to 64 pixels fit across it, many more than the rounds that move borders block by block."""
    camera, corner = Camera(640, 480, 525.0, 525.0, 319.5, 239.5), 0.07
    q = 0.5 * (1.0 + np.abs(camera.tan_x - corner) * np.tan(np.radians(0.5 * degrees))) * np.ones(camera.shape)
    found = segment(1.0 / (q + 1.4e-3 * np.random.default_rng(seed).standard_normal(camera.shape)), camera)
    assert len(found) == 2
    edge = np.median((found.labels == found.labels[0, 0]).sum(axis=1))
    assert abs(edge - (319.5 + 525.0 * corner)) < 8.0


@pytest.mark.parametrize(("bend", "planes"), [(0.0, 1), (0.038, 2), (0.046, 2)])
def test_waves_do_not_bend_a_wall_as_if_it_were_two(bend, planes):
    # As of active stereo, whose neighbouring pixels share their errors. By the height of the waves two walls may be
    # one, but over a hundred pixels waves cancel. With the larger bend the walls were one, which was too rough, so that
    # it fell into twenty planes.
    q = 0.4 + bend * np.abs(CAMERA.tan_x) + 3e-3 * smooth_noise(2, 3.0)
    found = segment(1.0 / q, CAMERA)
    assert len(found) == planes
    truth = np.where((CAMERA.tan_x < 0.0) & (bend > 0.0), 2, 1)
    assert compare_labels(found.labels, np.broadcast_to(truth, CAMERA.shape)).detection(0.9).f_score == 1.0


def test_a_folded_surface_is_its_folds():
    # Eight panels, each bent a little against the next: any two pass for one plane, all eight do not.
    fold = 40.0 / CAMERA.fx
    phase = np.abs((CAMERA.tan_x / fold) % 2.0 - 1.0)
    rng = np.random.default_rng(13)
    found = segment(1.0 / (0.6 + 0.014 * phase + rng.normal(0.0, 1e-3, CAMERA.shape)), CAMERA)
    assert 7 <= len(found) <= 9
    assert (found.reason == Reason.PLANE).mean() > 0.95


@pytest.mark.parametrize(("pixels", "fold", "pleats"), [(0.0, 24, 14), (1.0, 40, 8)])
def test_pleats_that_pass_two_by_two_for_one_plane_are_each_one(pixels, fold, pleats):
    # All in one they are far rougher than the noise: what is taken for a plane is less then.
    phase = np.abs((CAMERA.tan_x / (fold / CAMERA.fx)) % 2.0 - 1.0)
    number = np.floor(CAMERA.tan_x / (fold / CAMERA.fx)).astype(int)
    found = segment(1.0 / (0.6 + 0.004 * phase + 3e-4 * smooth_noise(1, pixels)), CAMERA)
    truth = number - number.min() + 1
    assert truth.max() == pleats
    assert compare_labels(found.labels, truth).hoover(0.8).correct == pleats


def column(sides: int | None) -> np.ndarray:
    """Inverse depth of a wall 2.5 m away with an upright column before it, round or with so many sides."""
    u, q = CAMERA.tan_x, np.full(CAMERA.shape, 0.4)
    middle, radius = np.array([0.1, 1.5]), 0.3
    if sides is None:
        ray = np.stack([u, np.ones_like(u)])
        a, b, c = (ray**2).sum(axis=0), np.tensordot(middle, ray, 1), middle @ middle - radius**2
        root = b * b - a * c
        q[root > 0.0] = (a / (b - np.sqrt(np.maximum(root, 0.0))))[root > 0.0]
        return q
    # The ray is inside the column between the last side it enters by and the first it leaves by.
    enters, leaves = np.zeros_like(u), np.full_like(u, np.inf)
    for angle in 2.0 * np.pi * (np.arange(sides) + 0.3) / sides:
        normal = np.array([np.sin(angle), -np.cos(angle)])
        slope, height = normal[0] * u + normal[1], normal @ middle + radius
        z = height / slope
        enters = np.where(slope < 0.0, np.maximum(enters, z), enters)
        leaves = np.where(slope > 0.0, np.minimum(leaves, z), leaves)
    return np.where(enters < leaves, 1.0 / np.maximum(enters, 1e-9), q)


@pytest.mark.parametrize("noise", [1e-4, 5e-4, 1.5e-3])
def test_a_round_column_is_no_plane(noise):
    q = column(None)
    rng = np.random.default_rng(14)
    found = segment(1.0 / (q + rng.normal(0.0, noise, q.shape)), CAMERA)
    on_column = q > 0.45
    assert (found.labels[~on_column] > 0).mean() > 0.98
    assert (found.reason[on_column] == Reason.CURVED).mean() > 0.85


@pytest.mark.parametrize("noise", [1e-4, 5e-4, 1.5e-3])
def test_a_column_of_eight_sides_is_its_sides(noise):
    q = column(8)
    rng = np.random.default_rng(15)
    found = segment(1.0 / (q + rng.normal(0.0, noise, q.shape)), CAMERA)
    assert (found.reason == Reason.CURVED).sum() == 0
    large = found.sizes > 500
    assert np.count_nonzero(large) == 4  # the wall and three sides


@pytest.mark.parametrize("noise", [0.0, 1e-4, 5e-4])
def test_a_column_of_sixteen_sides_is_its_sides(noise):
    q = column(16)
    rng = np.random.default_rng(16)
    found = segment(1.0 / (q + rng.normal(0.0, noise, q.shape)), CAMERA)
    assert not (found.reason == Reason.CURVED).any()
    assert np.count_nonzero(found.sizes > 1000) >= 6  # the wall and five sides or more


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_column_of_many_sides_is_round(noise):
    """From the quadric its sides differ by less than noise would hide."""
    q = column(48)
    rng = np.random.default_rng(16)
    found = segment(1.0 / (q + rng.normal(0.0, noise, q.shape)), CAMERA)
    on_column = q > 0.45
    assert (found.reason[on_column] == Reason.CURVED).mean() > 0.85
    assert (found.labels[~on_column] > 0).mean() > 0.98


def test_a_rendered_mesh_of_a_ball_is_no_polyhedron():
    for make, is_round in ((mesh_of_a_ball, True), (scenes.icosahedron, False), (scenes.dodecahedron, False)):
        body = make("body", (0.0, 0.0, 1.2), 0.3)
        wall = scenes.polygon("wall", [(-9, -9, 3), (9, -9, 3), (9, 9, 3), (-9, 9, 3)])
        rendering = scenes.Scene((wall, *body), np.eye(4)).render(CAMERA)
        on_body = rendering.labels > 1
        found = segment(rendering.depth, CAMERA)
        assert (found.reason[on_body] == Reason.CURVED).mean() == pytest.approx(float(is_round), abs=0.1)


def mesh_of_a_ball(name, centre, radius):
    """320 triangles, between the corners of an icosahedron and the middles of its edges, twice."""
    corners = np.array([surface.plane[:3] for surface in scenes.dodecahedron("dual", (0.0, 0.0, 0.0), 1.0)])
    for _ in range(2):
        distance = np.linalg.norm(corners[:, None] - corners, axis=2) + 9.0 * np.eye(len(corners))
        a, b = np.nonzero(np.triu(distance < 1.3 * distance.min()))
        middles = corners[a] + corners[b]
        corners = np.concatenate([corners, middles / np.linalg.norm(middles, axis=1, keepdims=True)])
    return scenes.polyhedron(name, corners * radius + centre)


def test_the_sides_of_a_round_column_are_as_curved_as_its_front():
    # By itself a side, a few blocks wide, is as good as plane: its neighbours are not, and it goes on as they do.
    u, q = CAMERA.tan_x, np.full(CAMERA.shape, 0.4)
    a, b = u * u + 1.0, 1.6  # a column of 40 cm, its axis 1.6 m away
    root = b * b - a * (b * b - 0.2**2)
    on_column = root > 0.0
    q[on_column] = (a / (b - np.sqrt(np.maximum(root, 0.0))))[on_column]
    for seed in range(3):
        noise = 1e-3 * np.random.default_rng(seed).standard_normal(q.shape)
        found = segment(1.0 / (q + noise), CAMERA)
        assert (found.reason[on_column] == Reason.CURVED).mean() > 0.95
        assert (found.labels[~on_column] > 0).mean() > 0.98


def test_the_normals_of_a_group_turn_between_its_regions_and_within_them(rng):
    """Two groups; one of the regions has no plane."""
    parent, alpha = np.array([0, 0, 2, 2, 2, 0]), rng.normal(size=(6, 3))
    weight, turned = rng.uniform(1.0, 5.0, (2, 6))
    turn_square = np.empty(6)
    alpha[4] = np.inf
    group_turns(parent, weight, alpha, turned, turn_square)
    for root, group in ((0, [0, 1, 5]), (2, [2, 3])):
        normals = alpha[group] / np.linalg.norm(alpha[group], axis=1, keepdims=True)
        mean = np.average(normals, axis=0, weights=weight[group])
        between, within = 1.0 - mean @ mean, np.average(turned[group], weights=weight[group])
        assert turn_square[root] == pytest.approx(between + within)


def test_a_wall_that_ends_in_narrow_panels_is_no_lampshade():
    """As a bay window: four planes that bend the same way, of which one has most of the pixels."""
    u, q, z = CAMERA.tan_x, np.empty(CAMERA.shape), 2.0
    edges = np.interp([0.0, 0.58, 0.72, 0.86, 1.0], [0.0, 1.0], u[0, [0, -1]])
    for left, right, angle in zip(edges[:-1], edges[1:], np.radians([0.0, 18.0, 36.0, 54.0]), strict=True):
        slope = np.tan(angle)
        q = np.where(u >= left, (1.0 - u * slope) / (z * (1.0 - left * slope)), q)
        z *= (1.0 - left * slope) / (1.0 - right * slope)
    found = segment(1.0 / (q + np.random.default_rng(17).normal(0.0, 1e-4, q.shape)), CAMERA)
    assert len(found) == 4
    assert (found.labels > 0).mean() > 0.99


@pytest.mark.parametrize("lying", [False, True])
def test_a_neighbour_is_looked_at_as_far_away_as_a_region_is_wide(lying):
    """One of 4 x 10 blocks, upright or lying, with the other all around it."""
    region = np.ones((32, 32), np.int32)
    region[8:18, 12:16] = 0  # with as much again on each side the window has 28 x 12 blocks
    v, u = 0.02 * np.indices(region.shape)
    means = np.stack([np.full_like(u, 16.0), u, v, np.ones_like(u)], axis=-1).astype(np.float32)
    box = np.array([[8, 18, 12, 16], [0, 32, 0, 32]])
    if lying:
        region, means, box = region.T.copy(), means.transpose(1, 0, 2).copy(), box[:, [2, 3, 0, 1]]
    m = 640.0 * np.array([1.0, 0.0, 0.0, 1.0, 0.1, 0.0, 0.0, 0.1, 0.0, 1.0])
    *_, pixels = fit_two(region, means, 0, 1, m, np.zeros(3), box, 1, np.zeros((TERMS + 1, TERMS + 1)))
    assert pixels == 16 * (28 * 12 - 40)


@pytest.mark.parametrize("turned", [(-27.0, 0.0, 27.0), (27.0, 0.0, -27.0), (-13.0, 13.0, -13.0, 13.0)])
def test_few_panels_or_a_zigzag_stay_planes(turned):
    # As a ceiling between two slopes, or a folding screen: upright panels, by how many degrees each is turned.
    u, q, z = CAMERA.tan_x, np.empty(CAMERA.shape), 2.0
    edges = np.linspace(u[0, 0], u[0, -1], len(turned) + 1)
    for left, right, angle in zip(edges[:-1], edges[1:], np.radians(turned), strict=True):
        slope = np.tan(angle)  # the panel is x tan(angle) = z + constant
        panel = (1.0 - u * slope) / (z * (1.0 - left * slope))
        q = np.where(u >= left, panel, q)
        z *= (1.0 - left * slope) / (1.0 - right * slope)
    rng = np.random.default_rng(17)
    found = segment(1.0 / (q + rng.normal(0.0, 1e-4, q.shape)), CAMERA)
    assert len(found) == len(turned)
    assert (found.labels > 0).mean() > 0.99
    angles = np.degrees(np.arctan2(found.planes[:, 0], -found.planes[:, 2]))
    assert np.abs(np.diff(angles)) == pytest.approx(np.abs(np.diff(turned)), abs=0.2)


@pytest.mark.parametrize("pixels", [2.5, 3.0])
def test_waves_do_not_bite_into_the_rims_of_planes(pixels):
    q = np.where(np.abs(CAMERA.tan_x) + 0.0 * CAMERA.tan_y < 0.4, 0.5, 0.9) + 3e-3 * smooth_noise(3, pixels)
    found = segment(1.0 / q, CAMERA)
    assert len(found) == 3
    assert np.all(found.labels > 0)


def test_what_a_plane_owns_is_no_powder():
    # Between two walls nothing but noise, a quarter of whose pixels happen to lie on the right one.
    rng = np.random.default_rng(18)
    q, _ = two_planes(CAMERA, 0.1)
    q = q + rng.normal(0.0, 1e-3, q.shape)
    noise = rng.uniform(0.3, 3.0, (CAMERA.height, 20))
    q[:, 140:160] = np.where(rng.random(noise.shape) < 0.25, q[:, 180:200], noise)
    q[100:103, 250] = 0.8  # a speck that goes with the wall around it
    found = segment(1.0 / q, CAMERA)
    assert len(found) == 2
    right = found.labels == found.labels[0, 300]
    alike = convolve(right.astype(int), np.ones((3, 3), int), mode="constant")
    assert np.count_nonzero(right[:, 140:160] & (alike[:, 140:160] <= 3)) < 150
    assert right[100:103, 250].all()


def test_a_plane_goes_on_where_its_blocks_are_rough():
    # A shelf seen from its edge: where within itself a pixel looks makes nearly every block of it rough.
    rng = np.random.default_rng(19)
    y = np.indices(CAMERA.shape)[0] + rng.uniform(-0.8, 0.8, CAMERA.shape)
    y[:, :60] = np.arange(CAMERA.height)[:, None]
    q = np.where(np.abs(np.arange(CAMERA.height) - 105)[:, None] <= 3, 0.53 + 3e-3 * (y - 105.0), 0.5)
    found = segment(1.0 / (q + rng.normal(0.0, 2e-4, q.shape)), CAMERA)
    assert len(found) == 2
    assert (found.labels[102:109] == 2).mean() > 0.98


@pytest.mark.parametrize(("metres", "degrees"), [(2.0, 8.0), (4.0, 12.0), (4.0, 14.0)])
def test_a_door_is_no_part_of_its_wall_though_both_together_hardly_turn(metres, degrees):
    """It has a seventh of the pixels. Errors are 8 mm at 2 m, and neighbours share them."""
    camera = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    hinge, angle = np.array([-0.1 * metres, 0.0, metres]), np.radians(degrees)
    normal = np.array([-np.sin(angle), 0.0, -np.cos(angle)])
    q = (normal[0] * camera.tan_x + normal[2]) / (normal @ hinge)
    along = (camera.tan_x / q - hinge[0]) / metres
    is_door = (along > 0.0) & (along < 0.21) & (np.abs(camera.tan_y / q) < 0.35 * metres)
    errors = gaussian_filter(np.random.default_rng(0).standard_normal(camera.shape), 1.2)
    depth = 1.0 / (np.where(is_door, q, 1.0 / metres) + 2e-3 * errors / errors.std())
    found = segment(depth, camera)
    assert compare_labels(found.labels, np.where(is_door, 2, 1)).detection(0.8).f_score == 1.0
