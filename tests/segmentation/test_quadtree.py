"""The paper's segmentation: the tree against the oracle, the clusters against what they are made of."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import oracle
import pytest
from matplotlib.colors import to_rgb

import rgbd_planes as rp
from rgbd_planes.evaluation import scenes
from rgbd_planes.fitting.methods import METHODS
from rgbd_planes.plotting.quadtree import OUTLINES
from rgbd_planes.segmentation.quadtree import QuadtreeFitter

OPTIONS = {"tile": 32, "max_subdivisions": 2, "max_error": 0.02, "max_missing": 0.4}


@pytest.fixture(scope="module")
def camera():
    return rp.Camera(width=150, height=110, fx=120.0, fy=121.0, cx=74.0, cy=55.0, depth_scale=1000.0)


@pytest.fixture(scope="module")
def frame(camera):
    """A room with patches of missing pixels; 150 x 110 is no multiple of 32."""
    return scenes.room().render(camera).measure(holes=0.02, patches=0.15, seed=3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("implementation", ["direct", "integral"])
def test_elements_equal_oracle(method, implementation, camera, frame):
    elements = QuadtreeFitter(camera, method=method, **OPTIONS, implementation=implementation).fit(frame)
    expected = oracle.fit_windows(frame, camera, elements.windows, method, max_missing=0.4, max_error=0.02)
    assert {0, 1, 3} <= set(elements.status.tolist())
    for i, plane in enumerate(expected):
        assert elements.valid_count[i] == plane.count
        if plane.well_posed and abs(plane.rmse_metric - 0.02) > 1e-9:
            assert elements.status[i] == plane.status
            np.testing.assert_allclose(elements.planes[i], oracle.orient(plane.plane), rtol=0, atol=1e-6)


@pytest.mark.parametrize("max_subdivisions", [0, 1, 2, 3])
def test_elements_cover_the_frame_once(max_subdivisions, camera, frame):
    elements = QuadtreeFitter(camera, tile=32, max_subdivisions=max_subdivisions).fit(frame)
    covered = np.zeros(camera.shape, int)
    for row, column, height, width in elements.windows:
        covered[row : row + height, column : column + width] += 1
    assert (covered == 1).all()
    assert set(elements.level) == set(range(max_subdivisions + 1))
    np.testing.assert_array_equal(elements.to_table()["level"], elements.level)


@pytest.mark.parametrize("implementation", ["direct", "integral"])
def test_split_is_where_the_parent_is_rough_and_only_there(implementation, camera, frame):
    elements = QuadtreeFitter(camera, **OPTIONS, implementation=implementation).fit(frame)
    sizes = 32 >> elements.level
    assert (elements.level[elements.status == rp.TileStatus.ROUGH] == 2).all()
    # A parent of any element is a square of the next coarser grid.
    split = elements.level > 0
    size = 2 * sizes[split]
    corner = elements.windows[split, :2] // size[:, None] * size[:, None]
    beyond = np.minimum(corner + size[:, None], camera.shape)
    parents = np.unique(np.column_stack([corner, beyond - corner]), axis=0)
    assert len(parents) > 10
    fits = rp.fit_windows(frame, camera, parents, max_error=0.02, max_missing=0.4)
    assert (fits.status == rp.TileStatus.ROUGH).all()


def test_too_many_missing_are_dropped_not_split(camera, frame):
    segmentation = rp.segment_quadtree(frame, camera, **OPTIONS)
    elements = segmentation.elements
    pixels = np.prod(elements.windows[:, 2:], axis=1)
    dropped = elements.status == rp.TileStatus.TOO_FEW
    assert (elements.valid_count[dropped] < 0.6 * pixels[dropped]).all()
    assert (elements.level[dropped] == 0).any()
    assert (segmentation.element_labels[elements.status != rp.TileStatus.OK] == 0).all()
    assert (segmentation.element_labels[elements.status == rp.TileStatus.OK] > 0).all()


def test_clusters_are_the_surfaces_of_a_corner(camera):
    """Three planes that no k-means could confuse come out as three clusters with the true coefficients."""
    shell = scenes.room(target=(-1.8, -1.2, 3.7))
    room = scenes.Scene(tuple(s for s in shell.surfaces if "wall" in s.name or s.name == "floor"),
                        shell.camera_to_scene)  # fmt: skip
    rendering = room.render(camera)
    assert set(rendering.names) == {"floor", "back wall", "left wall"}
    segmentation = rp.segment_quadtree(rendering.measure(noise=2e-4), camera, clusters=3, max_error=0.004)
    for label, plane in enumerate(segmentation.planes, start=1):
        errors = np.linalg.norm(rendering.planes - plane, axis=1)
        truth = int(np.argmin(errors)) + 1
        assert errors.min() < 0.02
        agreed = rendering.labels[segmentation.labels == label] == truth
        assert agreed.mean() > 0.98


def test_a_square_counts_by_its_area():
    """A large one is as many as there is room for small ones: it goes with few of these rather than with more."""
    camera = rp.Camera(width=96, height=32, fx=60.0, fy=60.0, cx=47.5, cy=15.5)
    near, middle, far = 1.0, 1.1, 1.22
    quarters = [[near, near, near, far]] * 5 + [[near, near, far, far]] * 3  # 21 and 11 small squares
    right = np.array(quarters).reshape(2, 4, 2, 2).swapaxes(1, 2).reshape(4, 8)
    small = np.concatenate([np.full((4, 4), middle), right], axis=1)
    found = rp.segment_quadtree(np.kron(small, np.ones((8, 8))), camera, 32, clusters=2, max_error=0.005)
    assert np.bincount(found.elements.level).tolist() == [1, 0, 32]
    of_depth = [{*found.labels[::8, ::8][small == depth].tolist()} for depth in (near, middle, far)]
    assert of_depth[1] == of_depth[2] != of_depth[0]


def test_a_shift_counts_by_the_depth_of_most_squares():
    """A few that are far away do not make planes alike that lie before one another."""
    camera = rp.Camera(width=64, height=64, fx=60.0, fy=60.0, cx=31.5, cy=31.5)
    turned = 1.0 / (np.cos(0.1) - np.sin(0.1) * camera.tan_x)
    depth = np.ones(camera.shape)
    depth[:, 16:32], depth[:, 32:48], depth[48:, 48:] = turned[:, 16:32], 1.2, 10.0
    labels = rp.segment_quadtree(depth, camera, 16, max_subdivisions=0, clusters=3).labels
    plain, same, shifted, far = labels[0, 0], labels[0, 16], labels[0, 32], labels[48, 48]
    assert plain == same
    assert len({plain, shifted, far}) == 3


def test_the_first_cluster_has_the_most_pixels_missing_ones_included():
    camera = rp.Camera(width=64, height=64, fx=60.0, fy=60.0, cx=31.5, cy=31.5)
    depth = np.full(camera.shape, 2.0)
    depth[:, :40] = 1.0
    depth[::5, :40] = depth[1::5, :40] = 0.0  # fewer are left than beside
    found = rp.segment_quadtree(depth, camera, 8, max_subdivisions=0, clusters=2)
    assert np.count_nonzero(depth == 1.0) < np.count_nonzero(depth == 2.0)
    np.testing.assert_allclose(found.planes[:, 3], [1.0, 2.0])
    assert (found.labels[:, :40] == 1).all()


def test_clusters_are_the_same_in_any_unit(camera, frame):
    """The distance of planes is in units of a frame's own depth."""
    camera = rp.Camera(**{**camera.to_dict(), "depth_scale": None})
    metres = np.where(frame > 0, frame / 1000.0, np.nan)
    labels = rp.segment_quadtree(metres, camera, **OPTIONS, clusters=5).labels
    for unit in (0.125, 8.0):
        options = OPTIONS | {"max_error": unit * OPTIONS["max_error"]}
        found = rp.segment_quadtree(unit * metres, camera, **options, clusters=5).labels
        assert np.mean(found != labels) < 1e-3


def test_cluster_plane_is_the_fit_to_all_its_pixels(camera, frame):
    segmentation = rp.segment_quadtree(frame, camera, clusters=4)
    q = oracle.inverse_depth(frame, camera)
    sizes = []
    for label, plane in enumerate(segmentation.planes, start=1):
        mask = segmentation.labels == label
        sizes.append(mask.sum())
        expected = oracle.fit("range_explicit", camera.tan_x[mask], camera.tan_y[mask], q[mask])
        np.testing.assert_allclose(plane, oracle.orient(expected.plane), rtol=0, atol=1e-9)
    assert sizes == sorted(sizes, reverse=True)


def test_same_seed_same_segmentation(camera, frame):
    first, second = (rp.segment_quadtree(frame, camera, seed=5) for _ in range(2))
    assert np.array_equal(first.labels, second.labels)
    assert np.array_equal(first.planes, second.planes)


def test_few_planes_need_few_clusters():
    camera = rp.Camera(width=64, height=64, fx=60.0, fy=60.0, cx=32.0, cy=32.0)
    flat = rp.segment_quadtree(np.full(camera.shape, 2.0), camera, tile=64, max_subdivisions=0)
    assert flat.labels.dtype == np.int32
    assert (flat.labels == 1).all()
    np.testing.assert_allclose(flat.planes, [[0.0, 0.0, -1.0, 2.0]], atol=1e-9)


def test_fitter_serves_many_threads_and_processes(camera, frame):
    """Tables are kept between frames: for each thread its own, and none in a pickle."""
    empty = np.zeros_like(frame)
    fitter = pickle.loads(pickle.dumps(QuadtreeFitter(camera, **OPTIONS, implementation="integral")))
    frames = [frame, empty, frame[::-1], frame] * 4
    expected = [QuadtreeFitter(camera, **OPTIONS, implementation="integral").fit(f).planes for f in frames]
    with ThreadPoolExecutor(4) as pool:
        for fits, planes in zip(pool.map(fitter.fit, frames), expected, strict=True):
            np.testing.assert_array_equal(fits.planes, planes)


def test_nothing_valid_is_no_error(camera):
    segmentation = rp.segment_quadtree(np.zeros(camera.shape, np.uint16), camera)
    assert (segmentation.labels == 0).all()
    assert segmentation.planes.shape == (0, 4)
    assert "0 planes" in repr(segmentation)
    segmentation.plot(np.zeros(camera.shape, np.uint16))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tile": 30}, "tile must be 2\\*\\*max_subdivisions times .* got 30 for max_subdivisions 2"),
        ({"tile": 4}, "at least 2 pixels, got 4"),
        ({"max_subdivisions": -1}, "max_subdivisions must be at least 0, got -1"),
        ({"clusters": 0}, "clusters must be at least 1, got 0"),
        ({"method": "ransac"}, "method must be one of .* got 'ransac'"),
        ({"max_missing": 1.5}, "max_missing must be between 0 and 1, got 1.5"),
        ({"max_error": 0.0}, "max_error must be a positive length"),
    ],
)
def test_bad_arguments_are_refused(options, message, camera, frame):
    with pytest.raises(ValueError, match=message):
        rp.segment_quadtree(frame, camera, **options)


def test_figure_outlines_every_element_in_its_status_colour(camera, frame):
    from matplotlib.collections import PatchCollection
    from matplotlib.colors import to_rgba

    segmentation = rp.segment_quadtree(frame, camera)
    figure = segmentation.plot(frame)
    outlines = [c for c in figure.axes[1].collections if isinstance(c, PatchCollection)]
    drawn = {tuple(c.get_edgecolor()[0]): len(c.get_paths()) for c in outlines if len(c.get_paths())}
    status = segmentation.elements.status
    assert drawn == {to_rgba(OUTLINES[s]): np.count_nonzero(status == s) for s in OUTLINES if (status == s).any()}
    (legend,) = (axes.get_legend() for axes in figure.axes if axes.get_legend())
    for text, patch in zip(legend.get_texts(), legend.get_patches(), strict=True):
        count, name = text.get_text().split(":")[0].split()
        assert patch.get_edgecolor() == to_rgba(OUTLINES[rp.TileStatus[name]])
        assert int(count) == drawn[patch.get_edgecolor()]


def test_figure_outlines_elements_where_they_are_and_fills_them_by_cluster(camera, frame):
    segmentation = rp.segment_quadtree(frame, camera)
    elements, labels = segmentation.elements, segmentation.labels
    panel = segmentation.plot(frame).axes[1]
    squares = f"{np.count_nonzero(elements.status == rp.TileStatus.OK)} squares fitted"
    assert panel.get_title() == f"{squares}, {len(segmentation.planes)} clusters"
    drawn = np.array([path.get_extents().extents for lines in panel.collections for path in lines.get_paths()])
    where = [elements.windows[elements.status == status] for status in OUTLINES]
    top, left, height, width = np.concatenate(where).T
    squares = np.stack([left - 0.5, top - 0.5, left + width - 0.5, top + height - 0.5], axis=1)
    inset = (drawn - squares) * [1.0, 1.0, -1.0, -1.0]
    np.testing.assert_allclose(inset, inset[:, :1] * np.ones(4), atol=1e-9)
    assert (inset > 0.0).all()
    # Lines touch neither their neighbours' nor most of what they outline.
    panel.figure.draw_without_rendering()
    points = 72.0 / panel.figure.dpi * panel.get_window_extent().width / camera.width
    lines = np.concatenate([lines.get_linewidth() for lines in panel.collections]) / points
    assert (lines < 1.1 * 2.0 * inset[:, 0]).all()
    assert (inset[:, 0] + lines < 0.2 * width).all()

    picture = np.asarray(panel.get_images()[0].get_array())
    seen = frame > 0
    plain = picture[seen & (labels == 0)]
    assert (np.ptp(plain, axis=-1) == 0.0).all()  # grey, darker where it is farther
    depth = frame[seen & (labels == 0)]
    assert plain[depth <= np.quantile(depth, 0.1)].min() > plain[depth >= np.quantile(depth, 0.9)].max()
    # What is left without the grey of the depth is the cluster's colour.
    nearest, farthest = np.percentile(frame[seen] / camera.depth_scale, [0.5, 99.5])
    far = np.clip((frame / camera.depth_scale - nearest) / (farthest - nearest), 0.0, 1.0)
    np.testing.assert_allclose(plain[:, 0], 0.75 - 0.55 * far[seen & (labels == 0)])
    tint = picture - 0.45 * (0.75 - 0.55 * far)[..., None]
    tints = [tint[seen & (labels == i)] for i in range(1, len(segmentation.planes) + 1)]
    assert all(np.ptp(own, axis=0).max() < 1e-9 for own in tints)
    strongest = np.array([own[0] for own in tints[:9]])
    np.testing.assert_allclose(strongest[0], 0.55 * np.array(to_rgb("tab:blue")))
    assert len(np.unique(strongest.round(6), axis=0)) == len(strongest)


def test_real_frame_equals_oracle(real_frame):
    depth, camera = real_frame
    elements = rp.segment_quadtree(depth, camera, max_error=0.02).elements
    chosen = np.linspace(0, len(elements.status) - 1, 60).astype(int)
    expected = oracle.fit_windows(depth, camera, elements.windows[chosen], "range_explicit", max_error=0.02)
    for i, plane in zip(chosen, expected, strict=True):
        assert elements.valid_count[i] == plane.count
        if plane.well_posed:
            assert elements.status[i] == plane.status
            np.testing.assert_allclose(elements.planes[i], oracle.orient(plane.plane), rtol=0, atol=1e-7)


def test_planes_that_are_infinitely_far_away(rng, recwarn):
    """As where a simulator writes a large number for the sky."""
    camera = rp.Camera(64, 48, 60.0, 60.0, 31.5, 23.5, depth_range=(0.0, np.inf))
    depth = rp.scenes.room().render(camera).depth
    depth[rng.random(depth.shape) < 0.3] = 1e20
    assert len(rp.segment_quadtree(depth, camera, 8, "range_implicit").planes) > 0
    assert not [str(warning.message) for warning in recwarn]


def test_plots_without_a_frame():
    """As the other results: it draws the fitted planes' own depth."""
    camera = rp.presets.kinect_v1()
    depth = rp.scenes.room().render(camera).measure(holes=0.05, seed=1)
    figure = rp.segment_quadtree(depth, camera).plot()
    figure.canvas.draw()
    assert figure.axes[0].get_title() == "Depth of the fitted planes"


def test_a_square_whose_pixels_determine_no_plane_is_split():
    camera = rp.Camera(32, 32, 30.0, 30.0, 15.5, 15.5)
    depth = np.zeros(camera.shape)
    depth[:, 3] = depth[16:, 16:] = 2.0
    elements = rp.segment_quadtree(depth, camera, 16, max_missing=1.0).elements
    degenerate = elements.status == rp.TileStatus.DEGENERATE
    assert elements.level[degenerate].tolist() == [2] * 8  # along the column


@pytest.mark.parametrize("implementation", ["direct", "integral"])
@pytest.mark.parametrize("method", METHODS)
def test_elements_of_one_column_have_no_plane(method, implementation):
    """Nor have their unions: sums over a whole frame leave rounding errors there, which are no scatter."""
    camera = rp.Camera(577, 480, 525.0, 525.0, 319.5, 239.5, depth_scale=1000.0)
    depth = scenes.room().render(camera).measure(seed=1)
    elements = QuadtreeFitter(camera, method=method, implementation=implementation).fit(depth)
    of_column = elements.windows[:, 3] == 1
    assert np.bincount(elements.level[of_column]).tolist() == [0, 0, 60]
    assert (elements.status[of_column] == rp.TileStatus.DEGENERATE).all()
    unions = rp.merge(elements, np.where(of_column, elements.windows[:, 0] // 16 + 1, 0))
    assert (unions.status == rp.TileStatus.DEGENERATE).all()


def test_other_seeds_begin_elsewhere():
    """Of as many clusters as there are kinds of planes k-means may find others."""
    camera = rp.presets.primesense()
    depth = scenes.room().render(camera).measure(holes=0.05, seed=1)
    labels = [rp.segment_quadtree(depth, camera, clusters=12, seed=seed).labels for seed in range(3)]
    assert any((other != labels[0]).any() for other in labels[1:])
