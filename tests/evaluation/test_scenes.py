"""The rendered scenes: against ray-box intersection by slabs, and against the laws they state."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rgbd_planes as rp
from rgbd_planes.camera.camera import Camera
from rgbd_planes.evaluation import scenes

SHEET = scenes.polygon("sheet", [(-1, -1, 3), (0, -1, 3), (0, 1, 3), (-1, 1, 3)])


def small_camera(**options):
    intrinsics = {"width": 64, "height": 48, "fx": 52.5, "fy": 52.5, "cx": 31.5, "cy": 23.5, "depth_scale": 1000.0}
    return Camera(**(intrinsics | options))


def rays_of(camera):
    return np.stack([camera.tan_x, camera.tan_y, np.ones_like(camera.tan_x)], axis=-1)


@settings(max_examples=50)
@given(
    incidence=st.floats(0.0, np.radians(80.0)),
    turn=st.floats(0.0, 2 * np.pi),
    distance=st.floats(0.3, 30.0),
    reverse=st.booleans(),
)
def test_plane_is_met_where_the_equation_says(incidence, turn, distance, reverse):
    camera = small_camera()
    normal = np.array([np.sin(incidence) * np.cos(turn), np.sin(incidence) * np.sin(turn), -np.cos(incidence)])
    if reverse:  # behind the camera's back, seen only where it comes round to the front
        normal = -normal
    rendering = scenes.plane(3.0 * normal, distance).render(camera)
    facing = rays_of(camera) @ normal
    seen = facing < 0.0
    assert np.array_equal(np.isfinite(rendering.depth), seen)
    assert np.array_equal(rendering.labels, seen.astype(np.int32))
    # In inverse depth, which a grazing ray keeps well conditioned.
    np.testing.assert_allclose(1.0 / rendering.depth[seen], -facing[seen] / distance, atol=1e-14 / distance)
    if seen.any():
        np.testing.assert_allclose(rendering.planes, [[*normal, distance]], rtol=1e-13, atol=1e-15)
        assert rendering.names == ("plane",)
    else:
        assert rendering.planes.shape == (0, 4)


def test_scenes_renderings_and_fitters_show_themselves_in_a_line():
    camera = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    scene = scenes.plane((0.0, 0.0, -1.0), 2.0)
    assert repr(scene) == "<Scene: 1 surface>"
    assert repr(scene.render(camera)) == "<Rendering: 1 plane in 64 x 48 pixels>"
    assert repr(rp.TileFitter(camera)) == "<TileFitter: 3 x 4 tiles of 16 x 16 pixels, range_explicit>"


def test_a_fisheye_shows_nothing_beside_the_camera():
    camera = Camera(60, 40, 15.0, 15.0, 29.5, 19.5, distortion_model="fisheye")
    rendering = scenes.plane([0, 0, -1], 2.0).render(camera)
    row, column = np.indices(camera.shape)
    seen = np.hypot(row - 19.5, column - 29.5) < 15 * np.radians(85)
    np.testing.assert_array_equal(rendering.depth, np.where(seen, 2.0, np.nan))
    np.testing.assert_array_equal(rendering.labels, seen)


def test_box_equals_the_slab_method():
    camera = small_camera(distortion=(0.1, -0.05, 0.001, 0.002, 0.0))
    foot, size, turn = np.array([0.1, 0.4, 2.0]), np.array([0.9, 0.7, 0.5]), 25.0
    eye, target = (0.5, -0.6, 0.1), (0.0, 0.2, 2.0)
    pose = scenes.look_at(eye, target)
    rendering = scenes.Scene(scenes.box("box", foot, size, turn), pose).render(camera)

    # The box's own axes: the ray enters the last of the three slabs and leaves the first.
    angle = np.radians(turn)
    rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    direction = rays_of(camera) @ pose[:3, :3].T @ rotation
    origin = (np.array(eye) - (foot - [0, size[1] / 2, 0])) @ rotation
    bounds = np.sort([(-size / 2 - origin) / direction, (size / 2 - origin) / direction], axis=0)
    enter, leave = bounds[0].max(axis=-1), bounds[1].min(axis=-1)
    hit = enter < leave
    assert 100 < hit.sum() < hit.size
    assert np.array_equal(np.isfinite(rendering.depth), hit)
    np.testing.assert_allclose(rendering.depth[hit], enter[hit], rtol=1e-12)


def test_labels_planes_and_names_agree_with_the_depth():
    camera = small_camera(fy=-52.5)
    rendering = scenes.room().render(small_camera())
    assert len(rendering.planes) == len(rendering.names) >= 12
    assert np.array_equal(np.unique(rendering.labels), np.arange(1, len(rendering.planes) + 1))
    np.testing.assert_allclose(np.linalg.norm(rendering.planes[:, :3], axis=1), 1.0, rtol=1e-14)
    assert (rendering.planes[:, 3] > 0.0).all()
    for view in (rendering, scenes.room().render(camera)):
        points = rays_of(view.camera) * view.depth[..., None]
        normal, offset = np.split(view.planes[view.labels - 1], [3], axis=-1)
        residual = (points * normal).sum(axis=-1, keepdims=True) + offset
        assert np.abs(residual).max() < 1e-12
    floor = rendering.names.index("floor") + 1
    assert (rendering.labels[-1] == floor).any()
    assert not (rendering.labels[0] == floor).any()  # y points down the image


def test_the_nearest_surface_wins_whatever_the_order():
    room = scenes.room()
    forward = room.render(small_camera())
    backward = scenes.Scene(room.surfaces[::-1], room.camera_to_scene).render(small_camera())
    assert np.array_equal(forward.depth, backward.depth)
    assert set(forward.names) == set(backward.names)


def test_no_two_surfaces_of_the_room_are_seen_in_one_plane():
    rendering = scenes.room().render(small_camera(width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5))
    difference = np.abs(rendering.planes[:, None] - rendering.planes[None]).max(axis=-1)
    assert difference[np.triu_indices(len(difference), k=1)].min() > 1e-2


def test_rays_that_meet_nothing_have_no_depth_and_label_0():
    rendering = scenes.Scene((SHEET,), np.eye(4)).render(small_camera())
    assert np.array_equal(rendering.labels == 1, np.isfinite(rendering.depth))
    assert (rendering.labels[:, 32:] == 0).all()
    assert (rendering.labels[20:30, 25:32] == 1).all()
    edge_on = scenes.Scene((scenes.polygon("edge", [(0, 0, 1), (1, 0, 1), (1, 0, 2)]),), np.eye(4))
    assert not edge_on.render(small_camera()).labels.any()


def test_look_at_puts_the_target_on_the_optical_axis_and_stays_level():
    pose = scenes.look_at((1.0, -1.5, 0.5), (-0.3, -0.4, 3.0))
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-15)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    target = np.linalg.solve(pose, (-0.3, -0.4, 3.0, 1.0))
    np.testing.assert_allclose(target[:2], 0.0, atol=1e-15)
    assert target[2] > 0.0
    assert pose[1, 0] == 0.0  # the image's rows are level
    assert pose[1, 1] > 0.0  # and its y points down


@pytest.mark.parametrize("tile", [(8, 8), (7, 13), (48, 64)])
def test_tile_labels_are_of_tiles_that_see_one_plane(tile):
    rendering = scenes.room().render(small_camera())
    expected = [
        [
            patch.flat[0] if (patch == patch.flat[0]).all() else 0
            for column in range(0, 64, tile[1])
            for patch in [rendering.labels[row : row + tile[0], column : column + tile[1]]]
        ]
        for row in range(0, 48, tile[0])
    ]
    assert np.array_equal(rendering.tile_labels(tile), expected)
    assert np.array_equal(rendering.tile_labels(9), rendering.tile_labels((9, 9)))


def test_noise_is_the_papers():
    camera = small_camera(width=400, height=300, fx=525.0, fy=525.0, cx=199.5, cy=149.5)
    rendering = scenes.plane((0.3, 0.2, -1.0), 2.0).render(camera)
    measured = rendering.measure(quantise=False, seed=5)
    standard = (measured - rendering.depth) / (rp.noise.KINECT_V1 * rendering.depth**2)
    count = standard.size
    assert abs(standard.mean()) < 5 / np.sqrt(count)
    assert abs(standard.std() - 1.0) < 5 / np.sqrt(2 * count)
    for shifted in (standard[:, 1:] * standard[:, :-1], standard[1:] * standard[:-1]):
        assert abs(shifted.mean()) < 5 / np.sqrt(count)  # neighbours are independent
    near, far = np.array_split(np.sort(rendering.depth.ravel()), 2)
    for depths in (near, far):  # the law in Z holds near and far
        part = standard[np.isin(rendering.depth, depths)]
        assert abs(part.std() - 1.0) < 5 / np.sqrt(2 * part.size)


def test_what_noise_would_put_behind_the_camera_is_missing():
    rendering = scenes.plane((0.0, 0.0, -1.0), 8.0).render(small_camera())
    measured = rendering.measure(noise=0.1, quantise=False)
    assert np.isnan(measured).any()
    assert np.nanmin(measured) > 0.0


def test_a_seed_is_a_frame_and_holes_leave_the_rest_as_it_was():
    rendering = scenes.room().render(small_camera())
    whole = rendering.measure(seed=3)
    assert np.array_equal(whole, rendering.measure(seed=3))
    assert not np.array_equal(whole, rendering.measure(seed=4))
    holed = rendering.measure(seed=3, holes=0.2, patches=0.1, baseline=0.075)
    assert np.array_equal(holed[holed > 0], whole[holed > 0])
    assert (holed == 0).sum() > 0.2 * holed.size


@pytest.mark.parametrize("share", [0.0, 0.05, 0.6, 1.0])
def test_shares_of_missing_pixels(share):
    camera = small_camera(width=400, height=300, fx=525.0, fy=525.0, cx=199.5, cy=149.5)
    rendering = scenes.plane((0.0, 0.0, -1.0), 2.0).render(camera)
    holes = rendering.measure(holes=share, seed=2) == 0
    assert holes.mean() == pytest.approx(share, abs=5 * np.sqrt(share * (1 - share) / holes.size))
    patches = rendering.measure(patches=share, seed=2) == 0
    assert patches.mean() == pytest.approx(share, abs=1e-4)
    if 0.0 < share < 1.0:  # a neighbour of a pixel in a patch is mostly in it too
        assert (patches[:, 1:] & patches[:, :-1]).mean() > 0.8 * share


@pytest.mark.parametrize("fx", [500.0, -500.0])
@pytest.mark.parametrize("baseline", [0.075, -0.075])
def test_shadow_is_as_wide_as_the_parallax_and_away_from_the_projector(baseline, fx):
    camera = small_camera(width=640, height=4, fx=fx, fy=500.0, cx=319.5, cy=1.5)
    near, far, left, right = 1.0, 2.5, -0.1003, 0.1003
    sheet = scenes.polygon("sheet", [(left, -1, near), (right, -1, near), (right, 1, near), (left, 1, near)])
    wall = scenes.plane((0.0, 0.0, -1.0), far).surfaces
    rendering = scenes.Scene((sheet, *wall), np.eye(4)).render(camera)
    shadow = np.isnan(rendering.measure(noise=0.0, baseline=baseline, quantise=False))
    assert (shadow == shadow[0]).all()
    columns = np.flatnonzero(shadow[0])
    assert abs(len(columns) - 500.0 * 0.075 * (1 / near - 1 / far)) <= 1.0
    sheet_columns = np.flatnonzero(rendering.labels[0] == 1)
    # On the side of the sheet that the projector does not see, and touching it.
    to_the_left = baseline * fx > 0
    assert (columns[-1] + 1 == sheet_columns[0]) if to_the_left else (columns[0] - 1 == sheet_columns[-1])
    assert (np.diff(columns) == 1).all()


def test_quantised_to_the_cameras_units():
    room = scenes.room()
    rendering = room.render(small_camera())
    raw = rendering.measure(noise=0.0)
    assert raw.dtype == np.uint16
    assert np.array_equal(raw, np.rint(1000.0 * rendering.depth))

    camera = small_camera(depth_scale=None, disparity=(-1 / 351.3, 1092.5 / 351.3), invalid_values=(2047,))
    rendering = room.render(camera)
    raw = rendering.measure(noise=0.0, holes=0.3, seed=1)
    scale, offset = camera.disparity
    missing = raw == 2047
    assert 0.2 < missing.mean() < 0.4
    assert np.abs(scale * raw + offset - 1.0 / rendering.depth)[~missing].max() <= 0.5 * abs(scale) * (1 + 1e-9)

    # Without an invalid value, a raw value whose inverse depth is not positive says missing.
    raw = room.render(small_camera(depth_scale=None, disparity=camera.disparity)).measure(noise=0.0, holes=1.0)
    assert (scale * raw + offset <= 0.0).all()
    with pytest.raises(ValueError, match="invalid_values"):
        room.render(small_camera(depth_scale=None, disparity=(1e-3, 0.1))).measure()

    too_far = scenes.plane((0.0, 0.0, -1.0), 70.0).render(small_camera())
    assert not too_far.measure(noise=0.0).any()  # 70 m do not fit 16 bits of millimetres
    rendering = room.render(small_camera(depth_scale=None))
    with pytest.raises(ValueError, match="depth_scale or disparity"):
        rendering.measure()
    assert rendering.measure(quantise=False, noise=0.0).dtype == np.float64


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"holes": 1.5}, "holes"),
        ({"patches": -0.1}, "patches"),
        ({"noise": -1.0}, "noise"),
        ({"noise": np.nan}, "noise"),
        ({"baseline": np.nan}, "baseline"),
    ],
)
def test_measure_refuses_nonsense(options, message):
    rendering = scenes.plane((0.0, 0.0, -1.0), 1.0).render(small_camera())
    with pytest.raises(ValueError, match=message):
        rendering.measure(**options)


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        ([(0, 0, 1), (1, 0, 1)], "K >= 3"),
        ([(0, 0, 1), (1, 0, 1), (1, 1, 1.1), (0, 1, 1)], "flat, convex"),
        ([(0, 0, 1), (2, 0, 1), (0.2, 0.2, 1), (0, 2, 1)], "flat, convex"),
        ([(0, 0, 1), (1, 0, 1), (2, 0, 1)], "no area"),
    ],
)
def test_polygons_that_are_none(vertices, message):
    with pytest.raises(ValueError, match=message):
        scenes.polygon("thing", vertices)


def test_impossible_views_and_planes():
    with pytest.raises(ValueError, match="straight up or down"):
        scenes.look_at((0, 0, 0), (0, 1, 0))
    with pytest.raises(ValueError, match="normal"):
        scenes.plane((0, 0, 0), 1.0)
    with pytest.raises(ValueError, match="distance"):
        scenes.plane((0, 0, -1), 0.0)
    with pytest.raises(TypeError, match="distance as a number, got None"):
        scenes.plane((0, 0, -1), None)


@pytest.mark.parametrize(
    ("make", "kind", "message"),
    [
        (
            lambda: scenes.box("box", (0, 0), (1, 1, 1)),
            ValueError,
            r"expected foot as three finite numbers, got \(0, 0\)",
        ),
        (
            lambda: scenes.box("box", (0, 0, 1), (1, 1)),
            ValueError,
            r"expected size as three finite numbers, got \(1, 1\)",
        ),
        (lambda: scenes.box("box", (0, 0, 1), (1, -1, 1)), ValueError, r"three positive lengths .* got \(1, -1, 1\)"),
        (lambda: scenes.box("box", (0, 0, 1), (1, 1, 0)), ValueError, r"three positive lengths .* got \(1, 1, 0\)"),
        (lambda: scenes.box("box", (0, 0, 1), (1, 1, 1), None), TypeError, "expected turn as a number, got None"),
        (lambda: scenes.plane("abc", 1.0), TypeError, "expected normal as numbers"),
        (lambda: scenes.plane((0, 0, np.nan), 1.0), ValueError, "expected normal as three finite numbers"),
        (lambda: scenes.look_at((0, 0), (0, 0, 1)), ValueError, "expected eye as three finite numbers"),
        (lambda: scenes.room(target=(0, 0, np.inf)), ValueError, "expected target as three finite numbers"),
        (lambda: scenes.polygon("thing", [("a", "b", "c")] * 3), TypeError, "expected vertices as numbers"),
    ],
)
def test_places_and_sizes_that_are_none(make, kind, message):
    with pytest.raises(kind, match=message):
        make()


def test_a_scene_of_a_list_and_a_pose_of_lists():
    room = scenes.room()
    given = scenes.Scene(list(room.surfaces), room.camera_to_scene.tolist())
    assert given.surfaces == room.surfaces
    assert np.array_equal(given.render(small_camera()).depth, room.render(small_camera()).depth)
    pose = np.eye(4)
    scene = scenes.Scene([SHEET], pose)
    pose[0, 3] = 7.0
    assert np.array_equal(scene.camera_to_scene, np.eye(4))


@pytest.mark.parametrize(
    ("surfaces", "pose", "kind", "message"),
    [
        ((SHEET, scenes.box("box", (0, 0, 2), (1, 1, 1))), np.eye(4), TypeError, r"got tuple: .* \(floor, \*box\)"),
        ([SHEET, None], np.eye(4), TypeError, "each of surfaces as a Surface, got NoneType"),
        (SHEET, np.eye(4), TypeError, "surfaces as an iterable, got Surface"),
        ([SHEET], np.eye(4)[:3], ValueError, r"camera_to_scene of shape \(4, 4\), got \(3, 4\)"),
        ([SHEET], "pose", TypeError, "camera_to_scene as numbers"),
        ([SHEET], 1000.0 * np.eye(4), ValueError, "camera_to_scene as a rigid motion"),
    ],
)
def test_what_is_no_scene_is_refused_when_it_is_made(surfaces, pose, kind, message):
    with pytest.raises(kind, match=message):
        scenes.Scene(surfaces, pose)


@pytest.mark.parametrize(
    ("plane", "sides", "kind", "message"),
    [
        (None, np.empty((0, 4)), TypeError, "plane as numbers"),
        ([[0.0, 0.0, -1.0, 2.0]], np.empty((0, 4)), ValueError, r"plane as \(4,\) finite numbers"),
        ([0.0, 0.0, np.nan, 2.0], np.empty((0, 4)), ValueError, r"plane as \(4,\) finite numbers"),
        ([0.0, 0.0, -1.0, 2.0], [[1, 2]], ValueError, r"sides of shape \(..., 4\), got \(1, 2\)"),
        ([0.0, 0.0, -1.0, 2.0], [1, 0, 0, 1], ValueError, r"sides as \(K, 4\) finite numbers"),
    ],
)
def test_what_is_no_surface_is_refused_when_it_is_made(plane, sides, kind, message):
    with pytest.raises(kind, match=message):
        scenes.Surface("a", plane, sides)


def test_a_surface_of_lists():
    given = scenes.Surface("a", [0, 0, -1, 2], [[1, 0, 0, 0.5]])
    exact = scenes.Surface("a", np.array([0.0, 0.0, -1.0, 2.0]), np.array([[1.0, 0.0, 0.0, 0.5]]))
    made = [scenes.Scene([one], np.eye(4)).render(small_camera()).depth for one in (given, exact)]
    assert (made[0] > 0.0).any()
    assert np.array_equal(*made, equal_nan=True)


@pytest.mark.parametrize("degrees", range(0, 90, 7))
def test_a_surface_that_contains_the_camera_is_seen_by_no_pixel(degrees):
    """Whatever rounding leaves of its distance."""
    turn, eye = np.radians(degrees), np.array([0.3, -1.0, 0.2])
    along, down = np.array([np.cos(turn), 0.0, -np.sin(turn)]), np.array([0.0, 1.0, 0.0])
    sheet = scenes.polygon("sheet", [eye - along - down, eye + along - down, eye + along + down, eye - along + down])
    back = scenes.polygon("back", [(-9, -9, 5), (9, -9, 5), (9, 9, 5), (-9, 9, 5)])
    camera = rp.presets.primesense().resized(64, 48)
    rendering = scenes.Scene((sheet, back), scenes.look_at(eye, (0.1, -0.9, 3.0))).render(camera)
    assert rendering.names == ("back",)
    assert np.nanmin(rendering.depth) > 1.0


@pytest.mark.parametrize("turn", [0.0, 0.1, 0.2, 0.3, 0.5])
def test_of_surfaces_in_one_plane_the_first_is_seen(turn):
    across = np.array([np.cos(turn), 0.0, -np.sin(turn)])

    def square(name, side):
        corners = [(-side, -side), (side, -side), (side, side), (-side, side)]
        return scenes.polygon(name, [x * across + np.array([0.0, y, 2.0]) for x, y in corners])

    board, poster = square("board", 1.0), square("poster", 0.5)
    camera = rp.presets.primesense().resized(160, 120)
    alone = scenes.Scene((poster,), np.eye(4)).render(camera)
    assert scenes.Scene((board, poster), np.eye(4)).render(camera).names == ("board",)
    both = scenes.Scene((poster, board), np.eye(4)).render(camera)
    np.testing.assert_array_equal(both.labels == 1, alone.labels == 1)
