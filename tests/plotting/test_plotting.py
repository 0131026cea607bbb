"""The figure of a fit: what it draws is what was fitted."""

import io
import itertools
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import rgbd_planes as rp
from rgbd_planes.evaluation import scenes
from rgbd_planes.noise_estimation.evidence import NoiseEvidence
from rgbd_planes.plotting import segments
from rgbd_planes.plotting import tiles as plotting
from rgbd_planes.plotting.normals import plot_normals
from rgbd_planes.plotting.quadtree import OUTLINES


def fitted(tile=8, **options):
    camera = rp.Camera(width=68, height=50, fx=52.5, fy=52.5, cx=33.5, cy=24.5, depth_scale=1000.0)
    depth = scenes.room().render(camera).measure(holes=0.05, seed=1)
    depth[:16, :24] = 0
    return rp.fit_tiles(depth, camera, tile=tile, **options), depth


def image_of(panel):
    return np.asarray(panel.get_images()[0].get_array())


def test_colours_of_normals_follow_the_stated_convention():
    right, up, facing = plotting.normal_colours(np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]]))
    np.testing.assert_allclose(right, [1.0, 0.5, 0.5])
    np.testing.assert_allclose(up, [0.5, 1.0, 0.5])
    np.testing.assert_allclose(facing, [0.5, 0.5, 1.0])
    none = plotting.normal_colours(np.full((2, 3), np.nan))
    assert np.isfinite(none).all()
    assert np.ptp(none) == 0.0


# Machado et al. 2009, of linear RGB: who lacks the cones for green, and who those for red.
BLIND = {
    "green": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "red": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    None: np.eye(3),
}


def as_seen(colours, cones):
    """CIELAB of sRGB colours, as seen without these cones."""
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.transpose(BLIND[cones]), 0.0, 1.0) @ np.array(
        [[0.4339, 0.2126, 0.0178], [0.3762, 0.7152, 0.1094], [0.1899, 0.0722, 0.8728]]
    )
    x, y, z = np.moveaxis(np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


@pytest.mark.parametrize("cones", BLIND)
def test_what_is_on_no_plane_looks_like_no_label(cones):
    labels, none = as_seen(segments.label_colours(400), cones), as_seen(np.array(segments.NO_PLANE), cones)
    assert np.linalg.norm(labels - none, axis=-1).min() > 10.0
    assert none[0] < labels[:, 0].min() - 5.0


@pytest.mark.parametrize("cones", BLIND)
def test_colours_of_statuses_differ_for_the_colour_blind(cones):
    """In every light that a tile may have; two colours that are 10 apart do not look alike."""
    light = np.linspace(0.6, 1.15, 12)[:, None]
    seen = [
        as_seen(np.minimum(light * plotting.STATUS_COLOURS[status], 1.0), cones)
        if status in (rp.TileStatus.OK, rp.TileStatus.ROUGH)
        else as_seen(np.array(plotting.STATUS_COLOURS[status])[None], cones)
        for status in rp.TileStatus
    ]
    for i, one in enumerate(seen):
        for other in seen[:i]:
            assert np.linalg.norm(one[:, None] - other, axis=-1).min() > 25.0
    # The paper's figure has outlines.
    lines = [as_seen(np.array(to_rgb(colour)), cones) for colour in OUTLINES.values()]
    assert min(np.linalg.norm(a - b) for i, a in enumerate(lines) for b in lines[:i]) > 25.0


@pytest.mark.parametrize("tile", [8, (7, 11), 3, (50, 68)])
def test_panels_show_depth_normals_and_statuses_where_they_belong(tile, tmp_path):
    tiles, depth = fitted(tile, max_error=0.02)
    figure = tiles.plot(depth)
    assert isinstance(figure, Figure)
    panels = [axes for axes in figure.axes if axes.get_title()]
    assert len(panels) == 3

    shown = image_of(panels[0])
    assert np.array_equal(np.ma.getmaskarray(shown) | ~np.isfinite(shown), depth == 0)
    np.testing.assert_allclose(shown[depth > 0], depth[depth > 0] / 1000.0)

    normals, statuses = image_of(panels[1]), image_of(panels[2])
    height, width = tiles.tile
    for row, column in np.ndindex(tiles.shape):
        here = np.s_[row * height : (row + 1) * height, column * width : (column + 1) * width]
        expected = plotting.normal_colours(tiles.planes[row, column, :3])
        assert (normals[here] == expected).all()
        colour = np.array(plotting.STATUS_COLOURS[rp.TileStatus(tiles.status[row, column])])
        drawn = statuses[here].reshape(-1, 3)
        assert (drawn == drawn[0]).all()
        # Light changes how bright a colour is, not which.
        np.testing.assert_allclose(np.cross(drawn[0], colour), 0.0, atol=0.03)
    texts = [text.get_text() for axes in figure.axes if axes.get_legend() for text in axes.get_legend().get_texts()]
    present = np.unique(tiles.status)
    assert sorted(texts) == sorted(
        f"{np.count_nonzero(tiles.status == s)}  {rp.TileStatus(s).name}: {plotting.STATUS_MEANINGS[rp.TileStatus(s)]}"
        for s in present
    )
    figure.savefig(tmp_path / "figure.png", dpi=40)
    assert (tmp_path / "figure.png").stat().st_size > 1000


def test_normals_have_one_legend():
    tiles, depth = fitted()
    camera = tiles.camera
    surfaces = plot_normals(depth, camera, rp.normals(depth, camera), rp.curvature(depth, camera))
    for figure in (tiles.plot(depth), surfaces):
        (ball,) = (
            axes
            for below in figure.axes
            for axes in below.child_axes
            if [text.get_text() for text in axes.texts] == ["up", "down", "facing left", "facing right"]
        )
        colours = image_of(ball)[:, :, :3]
        facing, right, up = colours[100, 100], colours[100, 199], colours[1, 100]
        normals = np.array([[0.0, 0.0, -1.0], [0.99, 0.0, -0.141], [0.0, -0.99, -0.141]])
        np.testing.assert_allclose([facing, right, up], plotting.normal_colours(normals), atol=0.01)
        figure.draw_without_rendering()
        above, below, left, right = (text.get_window_extent() for text in ball.texts)
        assert above.y0 > left.y1 > below.y1  # pixels of a figure count upwards
        assert left.x1 < above.x0 < right.x0


def test_without_a_frame_the_planes_own_depth_is_drawn():
    camera = rp.Camera(width=68, height=50, fx=52.5, fy=-52.5, cx=33.5, cy=24.5)
    truth = scenes.plane((0.2, 0.3, -1.0), 2.0).render(camera).depth
    shown = image_of(rp.fit_tiles(truth, camera, tile=8).plot().axes[0])
    np.testing.assert_allclose(shown, truth, rtol=1e-9)


def test_the_scale_of_one_depth_is_in_metres():
    """Rounding errors apart, or a millimetre: no scale of millionths with the metre added at its end."""
    camera = rp.Camera(width=68, height=50, fx=52.5, fy=52.5, cx=33.5, cy=24.5)
    depth = np.ones(camera.shape)
    normals = plot_normals(depth, camera, rp.normals(depth, camera), rp.curvature(depth, camera))
    for figure in (rp.fit_tiles(depth, camera, tile=8).plot(depth), normals):
        figure.draw_without_rendering()
        drawn = [inner for axes in figure.axes for inner in (axes, *axes.child_axes)]
        (scale,) = (axes.xaxis for axes in drawn if "metres" in axes.get_xlabel())
        assert scale.get_offset_text().get_text() == ""
        assert scale.get_major_ticks()[1].label1.get_text().startswith("1.0")


@pytest.mark.parametrize(("strays", "ends"), [((), "neither"), ((0.3,), "min"), ((9.0,), "max"), ((0.3, 9.0), "both")])
def test_the_scale_of_depth_says_at_which_end_there_is_more(strays, ends):
    camera = rp.Camera(width=68, height=50, fx=52.5, fy=52.5, cx=33.5, cy=24.5)
    depth = np.ones(camera.shape)
    depth[:, 34:] = 2.0
    depth[0, : len(strays)] = strays
    (image,) = rp.fit_tiles(depth, camera, tile=8).plot(depth).axes[0].get_images()
    assert image.colorbar.extend == ends
    assert image.get_clim() == (1.0, 2.0)  # which a few pixels do not change


def test_rounding_is_no_curvature():
    camera = rp.Camera(width=68, height=50, fx=52.5, fy=52.5, cx=33.5, cy=24.5)
    depth = 1.0 / (0.5 + 0.1 * camera.tan_x)
    figure = plot_normals(depth, camera, rp.normals(depth, camera), rp.curvature(depth, camera))
    (image,) = figure.axes[2].get_images()
    shown = image.norm(image.get_array())
    assert not np.ma.getmaskarray(shown).any()
    assert (shown < 0.01).all()


@pytest.mark.parametrize(("low", "high"), [(1e-6, 1.0), (1.1e-4, 0.21), (1e-6, 1e-5), (3e-5, 3e-4), (9e-4, 0.9)])
def test_the_scale_of_curvature_has_round_numbers(low, high):
    camera = rp.Camera(width=68, height=50, fx=52.5, fy=52.5, cx=33.5, cy=24.5)
    depth = np.ones(camera.shape)
    curvature = np.geomspace(low, high, depth.size).reshape(depth.shape).astype(np.float32)
    figure = plot_normals(depth, camera, rp.normals(depth, camera), curvature)
    figure.draw_without_rendering()
    (scale,) = (axes for below in figure.axes for axes in below.child_axes if "variance" in axes.get_xlabel())
    shown = [float(label.get_text()) for label in scale.get_xticklabels()]
    np.testing.assert_allclose(shown, scale.get_xticks())  # no label is rounded
    assert 3 <= len(shown) <= 8
    assert all(f"{value:.0e}"[0] in "1235" and float(f"{value:.0e}") == value for value in shown)
    boxes = [label.get_window_extent() for label in scale.get_xticklabels()]
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))


@pytest.mark.parametrize("shape", [(1280, 16), (16, 1280)])
def test_figures_of_frames_that_are_far_from_square_fit_on_a_page(shape):
    height, width = shape
    camera = rp.Camera(width, height, 1000.0, 1000.0, (width - 1) / 2, (height - 1) / 2)
    depth = scenes.plane((0.1, 0.2, -1.0), 2.0).render(camera).depth
    normals = plot_normals(depth, camera, rp.normals(depth, camera), rp.curvature(depth, camera))
    others = (rp.fit_tiles(depth, camera, 8), rp.segment(depth, camera), rp.segment_quadtree(depth, camera, 16))
    for figure in (normals, *(fitted.plot(depth) for fitted in others)):
        assert 0.08 <= figure.get_figheight() / figure.get_figwidth() <= 2.0
        figure.savefig(io.BytesIO())


def test_figures_of_low_frames_are_low():
    camera = rp.Camera(1024, 64, 300.0, 300.0, 511.5, 31.5)
    depth = scenes.plane((0.1, 0.2, -1.0), 2.0).render(camera).depth
    for fitted in (rp.fit_tiles(depth, camera, 8), rp.segment(depth, camera)):
        figure = fitted.plot(depth)
        figure.draw_without_rendering()
        text = [axes.title.get_window_extent() for axes in figure.axes if axes.get_title()]
        images = [axes.get_window_extent() for axes in figure.axes if axes.images]
        assert all(0.0 <= box.y0 <= box.y1 <= figure.bbox.height for box in (*text, *images))
        pixels = sum(axes.get_window_extent().height for axes in figure.axes[:1])
        assert pixels == pytest.approx(images[0].width / 16, rel=0.1)
        assert figure.bbox.height < pixels + 1.3 * figure.dpi


@pytest.mark.parametrize("shape", [(600, 60), (640, 160), (480, 640), (80, 1600)])
def test_words_of_legends_do_not_cover_each_other(shape):
    height, width = shape
    camera = rp.Camera(width, height, 525.0, 525.0, (width - 1) / 2, (height - 1) / 2, depth_scale=1000.0)
    depth = scenes.room().render(camera).measure(seed=1)
    figure = rp.fit_tiles(depth, camera, 8).plot(depth)
    figure.draw_without_rendering()
    (ball,) = (inner for axes in figure.axes for inner in axes.child_axes if inner.texts)
    boxes = [text.get_window_extent() for text in ball.texts]
    assert len(boxes) == 4
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    assert max(box.height for box in boxes) < 0.2 * ball.get_window_extent().height


@pytest.mark.parametrize("shape", [(96, 1280), (480, 640), (640, 96)])
def test_numbers_of_planes_do_not_cover_each_other(shape):
    height, width = shape
    camera = rp.Camera(width, height, 525.0, 525.0, (width - 1) / 2, (height - 1) / 2, depth_scale=1000.0)
    depth = scenes.room().render(camera).measure(seed=1)
    found = rp.segment(depth, camera)
    figure = found.plot(depth)
    figure.draw_without_rendering()
    texts = figure.axes[0].texts
    boxes = [text.get_bbox_patch().get_window_extent() for text in texts]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    assert texts[0].get_text() == str(np.argmax(found.sizes) + 1)
    assert len(texts) >= min(len(found), 5)


@pytest.mark.parametrize(("side", "numbers"), [(4, ["1"]), (6, ["1", "2"])])
def test_planes_that_are_small_in_the_image_have_no_number(side, numbers):
    """25 pixels of 160 x 120 are as many as 400 of 640 x 480."""
    camera = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5)
    depth = np.full(camera.shape, 2.0)
    depth[:, 80:] = 3.0
    labels = np.ones(camera.shape, np.int32)
    labels[90 : 90 + side, 130 : 130 + side] = 2
    figure = replace(rp.segment(depth, camera, noise=1e-3), labels=labels).plot()
    assert [text.get_text() for text in figure.axes[0].texts] == numbers


@pytest.mark.parametrize("shape", [(1, 40), (40, 1)])
def test_a_segmented_frame_of_one_row_or_column_behind_a_lens(shape):
    camera = rp.Camera(shape[1], shape[0], 52.5, 52.5, 0.3, 0.2, distortion=(0.1, 0.0, 0.0, 0.0))
    depth = np.full(shape, 2.0)
    rp.segment(depth, camera, noise=0.01).plot(depth).draw_without_rendering()


@pytest.mark.parametrize("fy", [52.5, -52.5])
@pytest.mark.parametrize("lens", [(), (0.1, -0.05, 0.0, 0.0)])
def test_a_plane_has_one_brightness(fy, lens, rng):
    """Whatever pixels are missing, and however a lens bends it: a speckle would be taken for another plane."""
    model = {"distortion": lens, "distortion_model": "fisheye" if lens else "brown_conrady"}
    camera = rp.Camera(width=68, height=50, fx=52.5, fy=fy, cx=33.5, cy=24.5, **model)
    alpha = np.array([0.3, 0.2, 0.6])
    q = alpha[0] * camera.tan_x + alpha[1] * camera.tan_y + alpha[2]
    q[rng.random(q.shape) < 0.3] = np.nan
    light = segments._relief(q, camera, 1e-2)[2:-2, 2:-2]
    expected = 1.0 + 0.12 * (alpha[0] / 52.5 + alpha[1] / fy) / 1e-2
    assert expected < 1.12
    np.testing.assert_allclose(light, expected, atol=0.004)


def test_colours_are_of_the_image_whatever_the_sign_of_fy():
    normal = np.array([0.0, -0.6, -0.8])  # of a floor
    camera = rp.Camera(width=68, height=50, fx=52.5, fy=52.5, cx=33.5, cy=24.5)
    upwards = rp.Camera(width=68, height=50, fx=52.5, fy=-52.5, cx=33.5, cy=24.5)
    floor = rp.fit_tiles(scenes.plane(normal, 1.5).render(camera).depth, camera, tile=8)
    mirrored = rp.fit_tiles(scenes.plane(normal * [1, -1, 1], 1.5).render(upwards).depth, upwards, tile=8)
    for panel in (1, 2):
        pictures = [image_of(tiles.plot().axes[panel]) for tiles in (floor, mirrored)]
        np.testing.assert_allclose(*pictures, atol=1e-9)


def test_light_comes_from_above_and_from_the_left():
    camera = rp.Camera(width=64, height=48, fx=52.5, fy=52.5, cx=31.5, cy=23.5)

    def brightness(normal):
        fits = rp.fit_tiles(scenes.plane(normal, 1.5).render(camera).depth, camera, tile=(48, 64), max_missing=0.9)
        assert fits.fitted.all()
        return image_of(fits.plot().axes[2]).sum(axis=-1)[0, 0]

    assert brightness((0.0, -0.6, -0.8)) > 1.2 * brightness((0.0, 0.6, -0.8))  # a floor, and a ceiling
    assert brightness((-0.6, 0.0, -0.8)) > 1.1 * brightness((0.6, 0.0, -0.8))  # what faces left, and right


def test_missing_pixels_have_one_colour_in_the_papers_figure():
    tiles, depth = fitted()
    figure = rp.segment_quadtree(depth, tiles.camera, 8).plot(depth)
    squares = image_of(figure.axes[1])
    grey = (squares == plotting.MISSING).all(axis=-1)
    assert np.array_equal(grey, depth == 0)
    (legend,) = (axes.get_legend() for axes in figure.axes if axes.get_legend())
    assert "missing" in legend.get_title().get_text()


def test_every_status_and_none_of_them_ok():
    tiles, depth = fitted()
    tiles.status[:] = np.arange(tiles.status.size).reshape(tiles.shape) % 4
    figure = tiles.plot(depth)
    assert [len(axes.get_legend().get_texts()) for axes in figure.axes if axes.get_legend()] == [4]
    empty = rp.fit_tiles(np.zeros_like(depth), tiles.camera, tile=8)
    assert (empty.status == rp.TileStatus.TOO_FEW).all()
    empty.plot(np.zeros_like(depth)).canvas.draw()
    empty.plot().canvas.draw()


def test_drawn_into_a_part_of_a_figure():
    tiles, depth = fitted()
    figure = Figure((12, 8), layout="constrained")
    upper, lower = figure.subfigures(2, 1)
    assert tiles.plot(depth, upper) is upper
    tiles.plot(None, lower)
    figure.canvas.draw()
    assert len(upper.axes) == len(lower.axes) > 0


def some_evidence(maps, cells):
    curve = np.ones(6)
    return NoiseEvidence(
        frames=2, windows=100, sizes=np.array([6, 8, 12, 24, 48, 96]), residuals=curve, expected=curve,
        inverse_depth=np.linspace(0.3, 1.0, 6), sigma=1e-3 * curve, sigma_fit=1e-3 * curve,
        p_values=np.linspace(0.0, 1.0, 100), noise_map=np.ones(maps), edge_growth=1.3,
        flatness=np.full(cells, 1e-3), flatness_count=np.full(cells, 100), flatness_std=np.full(cells, 1e-4),
    )  # fmt: skip


@pytest.mark.parametrize("shape", [(480, 640), (512, 512), (640, 480), (640, 360)])
def test_the_figure_of_noise_says_all_of_it_for_narrow_images(shape):
    height, width = shape
    evidence = some_evidence(maps=(height // 12, width // 12), cells=(height // 8, width // 8))
    figure = evidence.plot()
    figure.draw_without_rendering()
    for axes in figure.axes:
        for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
            box = text.get_window_extent()
            assert box.x0 >= 0.0, text.get_text()
            assert box.x1 <= figure.bbox.width, text.get_text()


def test_outlines_are_between_the_pixels_of_their_parts():
    tiles, depth = fitted((16, 24))  # of which the last ones are cut off
    down, across = ([line[0] for line in lines.get_segments()] for lines in tiles.plot(depth).axes[2].collections)
    assert np.array_equal(np.array(down)[:, 0], [23.5, 47.5])
    assert np.array_equal(np.array(across)[:, 1], [15.5, 31.5, 47.5])
    camera = rp.Camera(width=640, height=80, fx=525.0, fy=525.0, cx=319.5, cy=39.5)
    assert not rp.fit_tiles(np.ones(camera.shape), camera, (2, 40)).plot().axes[2].collections  # they would hide all
    wide = rp.Camera(width=1280, height=80, fx=525.0, fy=525.0, cx=639.5, cy=39.5)  # drawn as wide as one of 640
    assert [len(rp.fit_tiles(np.ones(c.shape), c, 8).plot().axes[2].collections) for c in (camera, wide)] == [2, 0]
    windows = [[3, 5, 20, 30], [0, 0, 50, 68]]
    (outlines,) = rp.fit_windows(depth, tiles.camera, windows).plot(depth).axes[2].collections
    boxes = [path.get_extents().extents.tolist() for path in outlines.get_paths()]
    assert boxes == [[4.5, 2.5, 34.5, 22.5], [-0.5, -0.5, 67.5, 49.5]]


def test_the_share_of_missing_pixels_is_said():
    tiles, depth = fitted()
    depth = np.where(np.arange(depth.size).reshape(depth.shape) % 10 < 3, 0, 1500).astype(np.uint16)
    labels = [inner.get_xlabel() for axes in tiles.plot(depth).axes for inner in axes.child_axes]
    assert any("missing, 30.0 % of the pixels" in label for label in labels)


def test_evidence_is_drawn_as_it_is():
    camera = rp.Camera(width=320, height=240, fx=262.5, fy=262.5, cx=159.5, cy=119.5, depth_scale=1000.0)
    evidence = rp.estimate_noise(scenes.room().render(camera).measure(seed=2), camera).evidence
    by_depth, by_size = evidence.plot().axes[:2]
    tiles, model = by_depth.get_lines()
    order = np.argsort(1.0 / evidence.inverse_depth)
    for line, sigma in ((tiles, evidence.sigma), (model, evidence.sigma_fit)):
        x, y = np.transpose(sorted(zip(*line.get_data(), strict=True)))
        np.testing.assert_allclose(x, 1.0 / evidence.inverse_depth[order])
        np.testing.assert_allclose(y, 1e3 * sigma[order])
    seen, expected, independent = (line.get_data() for line in by_size.get_lines())
    np.testing.assert_allclose(seen, (evidence.sizes, evidence.residuals))
    np.testing.assert_allclose(expected, (evidence.sizes, evidence.expected))
    at_12 = np.flatnonzero(evidence.sizes == 12)[0]
    of_independent = np.sqrt((1.0 - 3.0 / evidence.sizes**2) / (1.0 - 3.0 / 12**2))
    np.testing.assert_allclose(independent[1], evidence.residuals[at_12] * of_independent)


def test_maps_of_evidence_are_drawn_where_it_lies(rng):
    evidence = some_evidence(maps=(3, 4), cells=(5, 6))
    flatness, count = 1e-3 * rng.standard_normal((5, 6)), rng.integers(16, 100, (5, 6))
    flatness[0, 1], count[2, 3] = np.nan, 15  # no large plane there, and one of too few pixels
    evidence = replace(
        evidence, noise_map=rng.uniform(0.5, 2.0, (3, 4)), flatness=flatness, flatness_count=count,
        flatness_std=np.where(np.isfinite(flatness), 2e-4, np.nan), p_values=rng.random(100) ** 2,
    )  # fmt: skip
    figure = evidence.plot()
    noise, bias = (axes for axes in figure.axes if axes.get_xlabel().startswith("grey"))
    assert np.array_equal(image_of(noise), evidence.noise_map)
    expected = np.where(count < 16, np.nan, 1e3 * flatness)
    np.testing.assert_allclose(np.ma.filled(bias.get_images()[0].get_array(), np.nan), expected)
    lowest, highest = bias.get_images()[0].get_clim()
    assert highest == -lowest > 1.1  # 1e-3 / m, of which there is as much
    assert "±0.2e-3 / m" in bias.get_xlabel()
    assert "one frame" not in bias.get_xlabel()
    assert noise.get_xlabel().endswith("the model's noise grows 1.3-fold towards the edge")
    bars = figure.axes[2].patches
    assert sum(bar.get_height() * bar.get_width() for bar in bars) == pytest.approx(1.0)
    assert bars[0].get_height() == pytest.approx(np.count_nonzero(evidence.p_values < 0.05) / 100 / 0.05)
    figure = replace(evidence, frames=1).plot()
    assert "of one frame" in figure.axes[-1].get_xlabel()
    figure = replace(evidence, flatness=np.full((5, 6), np.nan)).plot()
    assert [len(axes.child_axes) for axes in figure.axes[-2:]] == [1, 0]  # no scale of nothing


def test_scales_have_arrows_where_values_are_beyond_them(rng):
    evidence = some_evidence(maps=(3, 4), cells=(50, 60))
    flatness = 1e-3 * rng.standard_normal((50, 60))
    flatness[0, 0] = -2e-2
    noise_map = np.where(np.arange(12).reshape(3, 4) == 5, 9.0, 1.0)
    figure = replace(evidence, noise_map=noise_map, flatness=flatness).plot()
    noise, bias = (axes.images[0].colorbar for axes in figure.axes if axes.get_xlabel().startswith("grey"))
    assert (noise.extend, bias.extend) == ("max", "both")
    camera = rp.Camera(width=80, height=60, fx=65.0, fy=65.0, cx=39.5, cy=29.5, depth_scale=1000.0)
    depth = scenes.room().render(camera).measure(seed=2)
    depth[0, 0] = 40_000
    normals, curvature = rp.normals(depth, camera), rp.curvature(depth, camera)
    metres, _, bent = plot_normals(depth, camera, normals, curvature).axes[:3]
    assert metres.images[0].colorbar.extend == "both"
    assert bent.images[0].colorbar.extend == "both"


def test_axes_in_the_place_of_a_figure():
    tiles, depth = fitted()
    axes = Figure().add_subplot()
    evidence = NoiseEvidence.__new__(NoiseEvidence)  # which is not looked at
    found = rp.segment(depth, tiles.camera)
    for plot in (partial(tiles.plot, depth), partial(found.plot, depth), evidence.plot):
        with pytest.raises(TypeError, match=r"^expected a Figure, got Axes$"):
            plot(axes)


def test_a_notebook_shows_it_without_pyplot():
    tiles, depth = fitted()
    assert tiles.plot(depth)._repr_png_().startswith(b"\x89PNG")


def test_what_cannot_be_drawn():
    tiles, depth = fitted()
    batch = rp.TileFitter(tiles.camera, 8).fit_batch(np.stack([depth, depth]))
    for of in (None, depth, np.stack([depth, depth])):
        with pytest.raises(ValueError, match=r"plot tiles\[i\]"):
            batch.plot(of)
    batch[1].plot()
    with pytest.raises(ValueError, match="shape"):
        plotting.plot_fits(tiles, np.ones((3, 3)))


def test_no_global_state_of_matplotlib():
    program = (
        "import io, sys, rgbd_planes as rp; from rgbd_planes import scenes;"
        "camera = rp.Camera(width=32, height=24, fx=30.0, fy=30.0, cx=15.5, cy=11.5);"
        "assert 'matplotlib' not in sys.modules and 'PIL' not in sys.modules;"
        "depth = scenes.room().render(camera).depth;"
        "rp.fit_tiles(depth, camera, tile=8).plot(depth).savefig(io.BytesIO());"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment)


def test_windows_are_drawn_where_they_are_and_the_smallest_on_top():
    tiles, depth = fitted()
    windows = [[20, 30, 12, 10], [2, 3, 40, 50], [0, 0, 10, 20]]
    fits = rp.fit_windows(depth, tiles.camera, windows, max_error=0.02)
    assert len(np.unique(fits.status)) > 1
    figure = fits.plot(depth)
    panels = [axes for axes in figure.axes if axes.get_title()]
    assert panels[2].get_title() == "3 windows, range_explicit"
    normals = image_of(panels[1])
    for pixel, index in (((25, 35), 0), ((40, 5), 1), ((5, 6), 2), ((1, 1), 2)):
        assert np.array_equal(normals[pixel], plotting.normal_colours(fits.planes[index, :3]))
    for panel in panels[1:]:
        assert np.array_equal(image_of(panel)[45, 60], plotting.MISSING)
    (outlines,) = panels[2].collections
    corners = [path.vertices.min(axis=0).tolist() for path in outlines.get_paths()]
    assert corners == [[29.5, 19.5], [2.5, 1.5], [-0.5, -0.5]]
    own = image_of(fits.plot().axes[0])
    assert np.array_equal(np.isfinite(own), np.isfinite(normals[..., 0]) & (normals != plotting.MISSING).any(-1))
    rp.fit_windows(depth, tiles.camera, []).plot(depth).canvas.draw()


def test_evidence_lies_inside_of_its_panels():
    """Whichever of the measured and the model is higher."""
    evidence = some_evidence(maps=(3, 4), cells=(5, 6))
    for scale in (0.2, 5.0):
        other = replace(evidence, sigma=scale * evidence.sigma, residuals=scale * evidence.residuals)
        for axes in other.plot().axes[:2]:
            low, high = axes.get_ylim()
            values = np.concatenate([line.get_ydata() for line in axes.get_lines()])
            assert low <= values.min() <= values.max() < high <= 2.0 * values.max()


def test_evidence_without_a_large_plane_has_no_bias():
    evidence = some_evidence(maps=(3, 4), cells=(5, 6))
    figure = replace(evidence, flatness_count=np.full((5, 6), 15), edge_growth=1.0).plot()
    noise, bias = (axes for axes in figure.axes if axes.get_xlabel().startswith("grey"))
    assert np.ma.getmaskarray(bias.get_images()[0].get_array()).all()
    assert (noise.get_xlabel(), bias.get_xlabel()) == ("grey: nothing flat there", "grey: no large plane")
    figure.draw_without_rendering()


def test_pixels_on_no_plane_are_grey_and_missing_ones_white():
    camera = rp.Camera(64, 48, 52.5, 52.5, 31.5, 23.5)
    depth = np.full(camera.shape, 2.0)
    depth[:10] = np.random.default_rng(1).uniform(1.0, 4.0, (10, 64))
    depth[30:35, 20:30] = np.nan
    found = rp.segment(depth, camera, noise=1e-3)
    shown = segments.label_image(found)
    missing = found.reason == rp.Reason.MISSING
    assert np.array_equal(missing, np.isnan(depth))
    assert (shown[missing] == 1.0).all()
    on_none = (found.labels == 0) & ~missing
    assert np.count_nonzero(on_none) > 300
    assert (shown[on_none] == segments.NO_PLANE).all()
    for label in range(1, len(found) + 1):
        assert (shown[found.labels == label] == segments.label_colours(len(found))[label - 1]).all()
    assert (segments.label_image(found, depth)[missing] == 1.0).all()
