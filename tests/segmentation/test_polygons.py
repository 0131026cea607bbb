"""Outlines of planes whose shape is known."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from rgbd_planes import Camera, fit_labels, segment
from rgbd_planes.camera import presets
from rgbd_planes.evaluation import scenes

shapely = pytest.importorskip("shapely")

from rgbd_planes._core.status import Reason  # noqa: E402
from rgbd_planes.camera.rays import rays_through  # noqa: E402
from rgbd_planes.segmentation.polygons import PlanePolygon, _multi, plane_polygons  # noqa: E402

CAMERA = Camera(width=160, height=120, fx=130.0, fy=130.0, cx=79.5, cy=59.5)


def board(camera: Camera) -> tuple[scenes.Rendering, np.ndarray]:
    """A tilted rectangle of 0.8 x 0.6 m before a far wall, and its corners."""
    u = np.array([0.8 * np.cos(0.5), 0.0, 0.8 * np.sin(0.5)])
    v = np.array([0.0, 0.6, 0.0])
    first = np.array([-0.4, -0.3, 1.3])
    corners = np.array([first, first + u, first + u + v, first + v])
    wall = [(-9, -9, 4.0), (9, -9, 4.0), (9, 9, 4.0), (-9, 9, 4.0)]
    scene = scenes.Scene((scenes.polygon("board", corners), scenes.polygon("wall", wall)), np.eye(4))
    return scene.render(camera), corners


def test_a_rectangle_is_found_where_it_is() -> None:
    rendering, corners = board(CAMERA)
    found = segment(rendering.depth, CAMERA)
    polygons = plane_polygons(found)
    assert len(polygons) == len(found) == 2
    own = min(polygons, key=lambda polygon: polygon.area)
    assert own.area == pytest.approx(0.48, rel=0.04)
    assert own.hull.area == pytest.approx(0.48, rel=0.04)
    sides = np.linalg.norm(np.diff(own.corners(), axis=0), axis=1)
    assert own.sides == pytest.approx([0.8, 0.6], rel=0.04)
    assert own.sides == pytest.approx(sorted(sides[:2])[::-1])
    for corner in corners:
        assert np.linalg.norm(own.corners() - corner, axis=1).min() < 0.03
    # The wall has a hole where the board is.
    wall = max(polygons, key=lambda polygon: polygon.area)
    assert len(wall.metric.geoms) == 1
    assert len(wall.metric.geoms[0].interiors) == 1
    assert repr(wall).endswith(" m², 1 part, 1 hole>")
    view = (160 / 130 * 4.0) * (120 / 130 * 4.0)
    shadow = shapely.Polygon((corners / corners[:, 2:] * 4.0)[:, :2]).area
    assert wall.area == pytest.approx(view - shadow, rel=0.01)
    assert wall.hull.area == pytest.approx(view, rel=0.01)


def test_a_plane_ends_before_its_horizon() -> None:
    """Of a label that goes on beyond it, where nothing is measured, too: no corner is behind the camera."""
    q = 0.5 * CAMERA.tan_y - 0.02
    made = fit_labels(np.where(q > 0.02, 1.0 / q, 0.0), CAMERA, np.ones(CAMERA.shape, int), max_missing=1.0)
    (polygon,) = plane_polygons(made)
    of_corners = 1.0 / np.concatenate([ring[:, 2] for part in polygon.rings() for ring in part])
    assert of_corners.min() > 0.999e-3 * q.max()


@pytest.mark.parametrize("shape", [(6, 1), (1, 6)])
def test_a_frame_of_one_row_or_column_behind_a_lens_has_an_area(shape) -> None:
    """A pixel is as wide there as that of a pinhole, and half of it belongs to either side."""
    camera = Camera(shape[1], shape[0], 30.0, 30.0, 0.3, 0.3, distortion=(-0.06, -0.11, 0.0003, -0.004, -0.001))
    made = fit_labels(1.0 / (0.4 * camera.tan_x - 0.2 * camera.tan_y + 1.0), camera, np.ones(shape, int))
    (polygon,) = plane_polygons(made)
    assert polygon.area == pytest.approx(6.0 / 30.0**2, rel=0.1)
    assert len(polygon.triangles()) >= 2


@pytest.mark.parametrize("distance", [0.002, 0.005, 0.02])
def test_the_outline_of_a_plane_seen_along_its_surface_contains_its_pixels(distance) -> None:
    """However near to the camera's centre it passes."""
    camera = Camera(64, 48, 600.0, 600.0, 31.5, 23.5)
    q = (camera.tan_x - 0.01) / (distance * np.hypot(1.0, 0.01))
    depth = np.where((q > 0.4) & (q < 4.0), 1.0 / q, 0.0)
    (polygon,) = plane_polygons(fit_labels(depth, camera, (depth > 0.0).astype(int)), tolerance=0.0)
    points = polygon.to_plane(camera.points(depth)[depth > 0.0])
    assert shapely.contains_xy(polygon.metric, *points.T).all()


def test_only_right_angles_are_made_whole() -> None:
    """All other corners of a triangle of pixels are the middles of their sides."""
    made = fit_labels(np.full(CAMERA.shape, 2.0), CAMERA, np.tri(*CAMERA.shape, dtype=int))
    (outline,) = plane_polygons(made, tolerance=0.0)[0].image.geoms
    corners = np.array(outline.exterior.coords)[:-1]
    assert corners[(corners % 1.0 == 0.5).all(axis=1)].tolist() == [[-0.5, CAMERA.height - 0.5]]


def test_coordinates_are_in_the_plane() -> None:
    found = segment(board(CAMERA)[0].depth, CAMERA)
    assert len(found) == 2
    for own in plane_polygons(found):
        assert not np.shares_memory(own.plane, found.planes)
        assert own.axes @ own.axes.T == pytest.approx(np.eye(2), abs=1e-12)
        assert own.axes @ own.plane[:3] == pytest.approx([0.0, 0.0], abs=1e-12)
        assert own.axes[0, 0] > 0
        assert own.axes[1, 1] > 0
        for rings in own.rings():
            for ring in rings:
                assert ring @ own.plane[:3] + own.plane[3] == pytest.approx(np.zeros(len(ring)), abs=1e-9)
        triangles = own.triangles()
        areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
        assert 0.5 * areas.sum() == pytest.approx(own.area, rel=1e-6)


def seen(normal: tuple[float, float, float], camera: Camera) -> PlanePolygon:
    """The outline of the only plane in sight."""
    (own,) = plane_polygons(segment(scenes.plane(normal, 1.0).render(camera).depth, camera))
    return own


@pytest.mark.parametrize("sign_y", [1, -1])
@pytest.mark.parametrize("sign_x", [1, -1])
@pytest.mark.parametrize("normal", [(0.2, 0.1, -1.0), (0.0, -1.0, -0.2), (1.0, 0.0, -0.1), (-1.0, 0.0, -0.1)])
def test_axes_and_rings_go_as_the_image_does(normal: tuple[float, float, float], sign_x: int, sign_y: int) -> None:
    camera = replace(CAMERA, fx=sign_x * CAMERA.fx, fy=sign_y * CAMERA.fy)
    own = seen(normal, camera)
    centre = own.to_space([own.metric.centroid.coords[0]])
    assert own.to_plane(centre + 0.3 * own.plane[:3]) == pytest.approx(np.array(own.metric.centroid.coords))
    middle, right, down = camera.project(np.concatenate([centre, centre + 1e-3 * own.axes]))
    assert right[0] > middle[0]
    assert sign_x * sign_y * (down[1] - middle[1]) > 0.0
    outer = own.rings()[0][0]
    for ring in (outer, own.corners(), own.corners(own.hull)):
        assert np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0) @ own.plane[:3] > 0.0


def test_rectangle_of_a_hull_with_corners_nearly_on_a_line() -> None:
    """GEOS 3.14 finds a rectangle without any area around these."""
    hull = [
        (1.136811883378852, 2.8547527131767696), (1.7052178250682781, 4.282129069765155),
        (3.4104356501365563, 8.56425813953031), (6.252465358583686, 15.701139922472233),
        (23.896908949430458, 17.98647625983212), (18.779086438000665, 8.954937297525753),
    ]  # fmt: skip
    metric = shapely.MultiPolygon([shapely.Polygon(hull)])
    own = replace(seen((0.0, 0.0, -1.0), CAMERA), metric=metric)
    assert own.rectangle.area == pytest.approx(276.9709262746113)
    assert own.rectangle.buffer(1e-9).contains(metric)


def test_a_floor_that_nearly_reaches_the_horizon_does_not_go_on_far_beyond_its_pixels() -> None:
    camera = Camera(width=80, height=60, fx=65.5, fy=65.5, cx=39.5, cy=29.5)
    near, far = [(-30, 0.1, 0.5), (30, 0.1, 0.5)], [(30, 0.1, 8.0), (-30, 0.1, 8.0)]
    floor = scenes.polygon("floor", [*near, *far])
    wall = scenes.polygon("wall", [*far, (-30, -30, 8.0), (30, -30, 8.0)])
    found = segment(scenes.Scene((floor, wall), np.eye(4)).render(camera).depth, camera)
    own = plane_polygons(found)[int(np.argmin(found.planes[:, 1]))]
    fitted = found.fitted_depth()[found.labels == own.label]
    assert fitted.max() > 10.0
    assert own.corners(own.hull)[:, 2].max() <= 2.001 * fitted.max()


@pytest.mark.parametrize("tolerance", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("size", [(120, 160), (12, 12), (30, 10)])
def test_a_rectangle_of_pixels_is_one(size: tuple[int, int], tolerance: float) -> None:
    found = segment(np.full(CAMERA.shape, 2.0), CAMERA)
    height, width = size
    found.labels[height:] = found.labels[:, width:] = 0
    (own,) = plane_polygons(found, tolerance=tolerance)
    assert own.image.equals(shapely.box(-0.5, -0.5, width - 0.5, height - 0.5))
    assert own.area == pytest.approx(height * width * (2.0 / 130.0) ** 2)
    hole = found.labels[3:9, 2:8]
    hole[:] = 0
    (own,) = plane_polygons(found, tolerance=tolerance)
    assert own.image.area == pytest.approx(height * width - 36)


@pytest.mark.parametrize("tolerance", [0.0, 1.0])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("joined", [False, True])
def test_rectangles_that_touch_at_a_corner_keep_their_edges(joined: bool, mirrored: bool, tolerance: float) -> None:
    """Also where they are one part, by a way around."""
    found = segment(np.full(CAMERA.shape, 2.0), CAMERA)
    found.labels[:] = 0
    labels = found.labels[:, ::-1] if mirrored else found.labels
    labels[20:40, 20:40] = labels[40:60, 40:60] = 1
    if joined:
        labels[10:20, 20:70] = labels[10:60, 60:70] = 1
    (own,) = plane_polygons(found, tolerance=tolerance)
    assert own.image.is_valid
    assert own.metric.is_valid
    assert len(own.image.geoms) == (1 if joined else 2)
    assert own.image.area == pytest.approx(np.count_nonzero(labels))


def test_parts_and_holes_of_fewer_pixels_are_left_out() -> None:
    depth = scenes.plane((0.0, 0.0, -1.0), 1.0).render(CAMERA).depth
    found = segment(depth, CAMERA)
    found.labels[20:24, 20:24] = 0  # 16 pixels
    found.labels[40:43, 40:45] = 0  # 15
    (own,) = plane_polygons(found, min_part=16.0)
    assert len(own.image.geoms[0].interiors) == 1
    (own,) = plane_polygons(found, min_part=1e5)  # more than all its pixels: the largest part stays
    assert len(own.image.geoms) == 1
    found.labels[12:18] = 0
    for labels in (found.labels, np.flipud(found.labels).copy()):
        found.labels[:] = labels
        (own,) = plane_polygons(found, min_part=1e5)
        (part,) = own.image.geoms
        assert part.area > 0.8 * CAMERA.width * CAMERA.height


@pytest.mark.parametrize("holes", [0.05, 0.25, 0.4])
def test_scattered_missing_pixels_take_no_area(holes: float) -> None:
    camera = replace(CAMERA, depth_scale=1000.0)
    rendering, _ = board(camera)
    polygons = plane_polygons(segment(rendering.measure(holes=holes), camera))
    near, wall = sorted(polygons, key=lambda polygon: polygon.image.area)
    truth = np.bincount(rendering.labels.ravel())[1:]
    assert near.image.area == pytest.approx(truth.min(), rel=0.06)
    assert wall.image.area == pytest.approx(truth.max(), rel=0.02)
    # The only hole is where the board is.
    assert [len(part.interiors) for own in (near, wall) for part in own.image.geoms] == [0, 1]


def test_only_gaps_that_are_missing_and_narrow_are_the_plane_s() -> None:
    found = segment(np.full(CAMERA.shape, 2.0), CAMERA)
    for left, reason in ((20, Reason.MISSING), (100, Reason.UNCLAIMED)):
        for gap in (np.s_[:, left : left + 3], np.s_[30:36, left + 10 : left + 13]):
            found.labels[gap], found.reason[gap] = 0, reason
    wide = np.s_[50:54, 50:54]
    found.labels[wide], found.reason[wide] = 0, Reason.MISSING
    (own,) = plane_polygons(found)
    assert own.image.equals(
        shapely.box(-0.5, -0.5, 99.5, 119.5).difference(shapely.box(49.5, 49.5, 53.5, 53.5))
        | shapely.box(102.5, -0.5, 159.5, 119.5).difference(shapely.box(109.5, 29.5, 112.5, 35.5))
    )
    (own,) = plane_polygons(found, min_part=0.0)
    assert own.image.area == pytest.approx(found.labels.sum())


def test_gaps_of_a_low_strip_may_be_wider_than_it_is_high() -> None:
    found = segment(np.full(CAMERA.shape, 2.0), CAMERA)
    found.labels[:], found.reason[:] = 0, Reason.UNCLAIMED
    found.labels[40:43, 20:140] = 1
    gap = np.s_[40:43, 60:68]  # of fewer than 10 x 10 pixels
    found.labels[gap], found.reason[gap] = 0, Reason.MISSING
    (own,) = plane_polygons(found, min_part=100.0)
    assert own.image.equals(shapely.box(19.5, 39.5, 139.5, 42.5))


def test_outline_without_simplification_covers_every_pixel() -> None:
    found = segment(board(CAMERA)[0].depth, CAMERA)
    assert len(found) == 2
    for own in plane_polygons(found, tolerance=0.0, min_part=0.0):
        rows, columns = np.nonzero(found.labels == own.label)
        assert shapely.contains_xy(own.image, columns, rows).all()
        rows, columns = np.nonzero(found.labels != own.label)
        assert not shapely.contains_xy(own.image, columns, rows).any()
        assert own.image.area == pytest.approx(found.sizes[own.label - 1], rel=0.02)


FISHEYE = Camera.from_opencv(
    [[150.0, 0.0, 179.5], [0.0, 150.0, 179.5], [0.0, 0.0, 1.0]], [0.01, -0.005, 0.0, 0.0], (360, 360),
    distortion_model="fisheye",
)  # fmt: skip


@pytest.mark.parametrize("camera", [presets.azure_kinect_nfov(), presets.kinect_v2(), FISHEYE], ids=str)
@pytest.mark.parametrize("tolerance", [0.0, 0.5, 2.0])
def test_a_lens_bends_edges_in_the_plane(camera: Camera, tolerance: float) -> None:
    """Straight edges of the image are curves there: the outline's area is that of its pixels."""
    camera = replace(camera, depth_scale=None)
    mask = np.zeros(camera.shape, bool)
    mask[60:-60, 60:-60] = True
    mask[150:-150, 150:-150] = False
    noise = np.random.default_rng(0).normal(0.0, 1e-4, camera.shape)
    found = segment(np.where(mask, 2.0 + noise, 0.0), camera)
    assert np.array_equal(found.labels == 1, mask)
    (outline,) = plane_polygons(found, tolerance=tolerance)

    # Corners of pixels are where four centres meet.
    x, y = (0.5 * (t[:-1, :-1] + t[1:, :-1] + t[:-1, 1:] + t[1:, 1:]) for t in (camera.tan_x, camera.tan_y))
    falling, rising = (
        (x[1:, 1:] - x[:-1, :-1], y[1:, 1:] - y[:-1, :-1]),
        (x[1:, :-1] - x[:-1, 1:], y[1:, :-1] - y[:-1, 1:]),
    )
    quads = 0.5 * np.abs(falling[0] * rising[1] - falling[1] * rising[0])
    assert outline.area == pytest.approx(quads[mask[1:-1, 1:-1]].sum(), rel=1e-2)
    for part in outline.metric.geoms:
        for ring in (part.exterior, *part.interiors):
            places = np.linspace(0.0, ring.length, 2000)
            points = outline.to_space([ring.interpolate(place).coords[0] for place in places])
            off = shapely.distance(outline.image.boundary, shapely.points(camera.project(points)))
            assert off.max() < max(0.25 * tolerance, 0.02)


def test_tolerance_saves_corners() -> None:
    found = segment(board(CAMERA)[0].depth, CAMERA)
    assert len(found) == 2
    every, few = (plane_polygons(found, tolerance=tolerance) for tolerance in (0.0, 2.0))
    for one, other in zip(every, few, strict=True):
        assert shapely.get_num_coordinates(other.image) < 0.3 * shapely.get_num_coordinates(one.image)
        assert one.image.hausdorff_distance(other.image) < 3.0


def test_no_triangle_is_without_area() -> None:
    found = segment(scenes.plane((0.2, -0.1, -1.0), 2.0).render(CAMERA).depth, CAMERA)
    for seed in range(4):
        found.labels[:] = np.random.default_rng(seed).random(CAMERA.shape) < 0.8
        (own,) = plane_polygons(found, min_part=3.0)
        first, second, third = np.moveaxis(own.triangles(), 1, 0)
        doubled = np.cross(second - first, third - first) @ own.plane[:3]
        assert doubled.min() > 1e-12 * own.area
        assert 0.5 * doubled.sum() == pytest.approx(own.area)


@pytest.mark.parametrize("tolerance", [1.0, 3.0])
def test_thin_parts_keep_their_area(tolerance: float) -> None:
    found = segment(np.full(CAMERA.shape, 2.0), CAMERA)
    found.labels[:] = 0
    found.labels[40:100, 10:100] = 1
    found.labels[20, 20:90] = 1  # one pixel wide
    found.labels[20:90, 120:122] = 1
    (own,) = plane_polygons(found, tolerance=tolerance)
    assert sorted(part.area for part in own.image.geoms) == pytest.approx([70.0, 140.0, 5400.0], rel=0.02)


def test_parts_are_simplified_each_for_itself(rng: np.random.Generator) -> None:
    found = segment(np.full(CAMERA.shape, 2.0), CAMERA)
    found.labels[:] = gaussian_filter(rng.normal(size=CAMERA.shape), 3.0) > 0.05
    (every,), (few,) = (plane_polygons(found, tolerance=tolerance) for tolerance in (0.0, 1.0))
    assert len(few.image.geoms) > 10
    assert few.image.equals(every.image.simplify(1.0))


def test_parts_that_would_cross_keep_clear_of_each_other() -> None:
    """Wavy stripes with narrow gaps: each simplified for itself, some would reach into the next one."""
    rows, columns = np.indices(CAMERA.shape)
    found = segment(np.full(CAMERA.shape, 2.0), CAMERA)
    found.labels[:] = (rows + 10.0 * np.sin(columns / 5.0)) % 12.0 >= 2.0
    (every,), (few,) = (plane_polygons(found, tolerance=tolerance) for tolerance in (0.0, 4.0))
    corners, all_corners = (set(map(tuple, shapely.get_coordinates(made.image))) for made in (few, every))
    assert len(few.image.geoms) == len(every.image.geoms) > 10
    assert len(corners) < 0.5 * len(all_corners)
    assert corners <= all_corners  # none is where two edges cross


def test_what_is_made_valid_keeps_all_of_its_parts() -> None:
    """Where parts overlap, what is valid is a collection of polygons, in a geometry of their own, and of lines."""
    crossing = shapely.MultiPolygon([shapely.box(0, 0, 2, 2), shapely.box(1, 0, 3, 2), shapely.box(5, 0, 6, 2)])
    made = _multi(crossing, crossing)
    assert made.is_valid
    assert made.area == pytest.approx(8.0)


def test_dictionary_is_json() -> None:
    own = plane_polygons(segment(board(CAMERA)[0].depth, CAMERA))[0]
    read = json.loads(json.dumps(own.to_dict()))
    assert read["label"] == 1
    assert np.array(read["rectangle"]).shape == (4, 3)
    assert np.array(read["outline"][0][0]).shape[1] == 3


def test_rays_between_pixels() -> None:
    rays = rays_through(CAMERA, [(79.5, 59.5), (0.0, 0.0), (159.5, -0.5)])
    assert rays[0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
    assert rays[1] == pytest.approx([CAMERA.tan_x[0, 0], CAMERA.tan_y[0, 0], 1.0])
    assert rays[2] == pytest.approx([80.0 / 130.0, -60.0 / 130.0, 1.0])


def test_bad_arguments_are_refused() -> None:
    found = segment(np.full(CAMERA.shape, 1.0), CAMERA)
    with pytest.raises(ValueError, match="tolerance must not be negative"):
        plane_polygons(found, tolerance=-1.0)
    with pytest.raises(ValueError, match="min_part must not be negative"):
        plane_polygons(found, min_part=float("nan"))
    (outline,) = plane_polygons(found)
    with pytest.raises(ValueError, match=r"expected points of shape \(\.\.\., 3\), got \(1, 2\)"):
        outline.to_plane([[200.0, 300.0]])  # of a pixel
    with pytest.raises(TypeError, match="masked"):
        outline.to_plane(np.ma.masked_invalid([[0.0, 0.0, np.nan]]))
    with pytest.raises(ValueError, match=r"expected coordinates of shape \(\.\.\., 2\), got \(3,\)"):
        outline.to_space([0.0, 0.0, 1.0])
    with pytest.raises(TypeError, match=r"a shapely Polygon, got MultiPolygon: rings\(\) has those"):
        outline.corners(outline.metric)  # type: ignore[arg-type]


def test_a_plane_without_pixels_has_an_empty_outline() -> None:
    found = segment(board(CAMERA)[0].depth, CAMERA)
    found.labels[found.labels == 1] = 0
    gone, left = plane_polygons(found)
    assert (gone.label, gone.area, gone.rings(), gone.corners().shape) == (1, 0.0, [], (0, 3))
    assert gone.triangles().shape == (0, 3, 3)
    np.testing.assert_array_equal(gone.sides, [0.0, 0.0])
    assert repr(gone) == "<PlanePolygon 1: 0 m², 0 parts, 0 holes>"
    assert left.area == pytest.approx(0.48, rel=0.04)


def test_a_camera_of_one_column_sees_one_column_of_the_plane() -> None:
    found = segment(np.full(CAMERA.shape, 2.0), CAMERA)
    camera = replace(CAMERA, width=1, cx=0.0)
    narrow = replace(found, camera=camera, labels=found.labels[:, :1], reason=found.reason[:, :1])
    (own,) = plane_polygons(narrow)
    assert own.area == pytest.approx(CAMERA.height * (2.0 / CAMERA.fx) ** 2, rel=0.01)
    assert own.hull.area == pytest.approx(own.area)


@pytest.mark.parametrize("holes", [0.0, 0.25])
def test_parts_of_one_plane_have_one_outline(holes: float) -> None:
    """As of a wall with something in front of it, after `fit_labels` to both of its parts."""
    camera = replace(CAMERA, depth_scale=1000.0)
    labels = np.zeros(camera.shape, int)
    labels[:, :60], labels[:, 100:] = 1, 1
    labels[50:60, 70:80] = 3  # of 2 there is none
    depth = scenes.plane((0.2, 0.1, -1.0), 2.0).render(camera).measure(holes=holes)
    of_labels = fit_labels(depth, camera, np.where(depth > 0, labels, 0))
    wall, small = plane_polygons(of_labels)
    assert (wall.label, small.label) == (1, 3)
    np.testing.assert_array_equal(wall.plane, of_labels.planes[0])
    assert len(wall.image.geoms) == 2
    assert wall.image.area == pytest.approx(120 * 120, rel=0.01)


def test_no_plane_no_polygon() -> None:
    assert plane_polygons(segment(np.zeros(CAMERA.shape), CAMERA)) == []


def test_dictionary_has_the_hull_and_the_rectangle() -> None:
    depth = np.full(CAMERA.shape, 2.0)
    depth[:60, :80] = 1.0  # leaves an L of the wall, whose hull is no rectangle
    board_, wall = plane_polygons(segment(depth, CAMERA))
    for own, corners in ((board_, 4), (wall, 5)):
        made = own.to_dict()
        assert len(made["hull"]) == corners
        np.testing.assert_array_equal(made["hull"], own.corners(own.hull))
        np.testing.assert_array_equal(made["rectangle"], own.corners())


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_wall_along_the_optical_axis_has_its_first_axis_along_it(side: float) -> None:
    own = seen((side, 0.0, 0.0), CAMERA)
    np.testing.assert_allclose(own.axes, [[0.0, 0.0, side], [0.0, 1.0, 0.0]], atol=1e-6)
