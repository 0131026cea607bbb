"""What a notebook shows of a result."""

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

import rgbd_planes as rp
from rgbd_planes.evaluation import scenes
from rgbd_planes.plotting.colours import MISSING, STATUS_COLOURS, label_colours, normal_colours
from rgbd_planes.plotting.preview import fits_picture
from rgbd_planes.plotting.segments import label_image


@pytest.fixture(scope="module")
def tiles():
    camera = rp.Camera(width=400, height=300, fx=325.0, fy=325.0, cx=199.5, cy=149.5, depth_scale=1000.0)
    depth = scenes.room().render(camera).measure(patches=0.2, seed=2)
    return rp.fit_tiles(depth, camera, tile=(28, 30), max_error=0.02)


def picture_of(text):
    (content,) = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    with Image.open(io.BytesIO(base64.b64decode(content))) as image:
        return np.asarray(image)


def test_the_picture_has_each_tile_where_it_is(tiles):
    picture = fits_picture(tiles)
    assert picture.shape == (240, 320 + 8 + 320, 4)
    opacity = np.full(picture.shape[:2], 255)
    opacity[:, 320:328] = 0  # whatever is behind it
    assert np.array_equal(picture[..., 3], opacity)
    picture = picture[..., :3]
    for row, column in np.ndindex(tiles.shape):
        # The middle of the tile, in a picture of 320 columns for 400.
        y = int((28 * row + tiles.tile_heights[row] / 2) / 1.25)
        x = int((30 * column + tiles.tile_widths[column] / 2) / 1.25)
        status = STATUS_COLOURS[rp.TileStatus(tiles.status[row, column])]
        assert np.array_equal(picture[y, 328 + x], np.rint(255 * np.array(status)))
        normal = normal_colours(tiles.planes[row, column, :3])
        assert np.array_equal(picture[y, x], np.rint(255 * normal))
    assert (picture[:, :320] == np.rint(255 * np.array(MISSING))).all(axis=2).any()


def test_a_result_shows_itself(tiles):
    text = tiles._repr_html_()
    assert "11 x 14 tiles of 28 x 30 pixels, range_explicit" in text
    assert np.array_equal(picture_of(text), fits_picture(tiles))
    for status in rp.TileStatus:
        assert (f"&nbsp;{status.name}" in text) == (tiles.status == status).any()
    assert len(text) < 20_000


def test_a_noise_model_shows_what_it_was_found_from():
    camera = rp.presets.kinect_v1()
    found = rp.estimate_noise(rp.scenes.room().render(camera).measure(seed=1), camera)
    text = found._repr_html_()
    assert repr(found).strip("<>") in text
    height, width, _ = picture_of(text).shape
    assert 900 < width < 1100
    assert 450 < height < 600
    assert rp.noise.kinect_v1()._repr_html_() == f"<div>{repr(rp.noise.kinect_v1()).strip('<>')}</div>"


def test_a_batch_shows_its_first_frame(tiles):
    depth = np.full(tiles.camera.shape, 2000, np.uint16)
    batch = rp.TileFitter(tiles.camera).fit_batch([depth, depth // 2])
    text = batch._repr_html_()
    assert "2 frames of 19 x 25 tiles" in text
    assert "of the first frame" in text
    assert np.array_equal(picture_of(text), fits_picture(batch[0]))
    with pytest.raises(ValueError, match="got a batch"):
        fits_picture(batch)


def test_a_quadtree_shows_itself():
    camera = rp.presets.kinect_v1()
    found = rp.segment_quadtree(rp.scenes.room().render(camera).measure(holes=0.05, seed=1), camera)
    text = found._repr_html_()
    counts = f"{len(found.planes)} planes of {len(found.elements.windows)} elements, range_explicit: "
    assert f"<div>QuadtreeSegmentation: {counts}" in text
    picture = picture_of(text)[..., :3]
    assert picture.shape == (240, 648, 3)
    labels = found.labels[::2, ::2]
    for label in range(len(found.planes) + 1):
        assert len(np.unique(picture[:, :320][labels == label], axis=0)) == 1
    assert len(np.unique(picture[:, :320].reshape(-1, 3), axis=0)) == len(found.planes) + 1
    for status in rp.TileStatus:
        assert (f"&nbsp;{status.name}" in text) == (found.elements.status == status).any()


def test_segments_show_themselves_as_large_as_tiles(tiles):
    depth = scenes.room().render(tiles.camera).measure(seed=2)
    found = rp.segment(depth, tiles.camera)
    picture = picture_of(found._repr_html_())
    assert picture.shape == (240, 320, 3)  # of 300 x 400
    rows, columns = np.arange(240) * 5 // 4, np.arange(320) * 5 // 4
    assert np.array_equal(picture, np.rint(255 * label_image(found)[rows[:, None], columns]))


@pytest.mark.parametrize(("width", "height"), [(448, 336), (348, 261), (736, 552), (321, 50)])
def test_frames_of_any_size_show_themselves(width, height):
    camera = rp.Camera(width, height, 400.0, 400.0, 0.5 * width, 0.5 * height, depth_scale=1000.0)
    depth = np.full(camera.shape, 2000, np.uint16)
    picture = picture_of(rp.segment(depth, camera)._repr_html_())
    assert abs(picture.shape[0] * width / height - picture.shape[1]) <= width / height
    assert picture_of(rp.fit_tiles(depth, camera)._repr_html_()).shape[0] == picture.shape[0]


def test_nothing_measured_is_said():
    camera = rp.Camera(64, 48, 50.0, 50.0, 31.5, 23.5, depth_scale=1000.0)
    found = rp.segment(np.zeros(camera.shape, np.uint16), camera)
    assert repr(found) == "<Segmentation: 0 planes, nothing measured of 64 x 48>"
    assert found.plot().axes[0].get_title() == "0 planes, nothing measured"
    text = found._repr_html_()
    assert "The largest" not in text
    assert "on no plane" in text


def test_tracked_segments_show_themselves_by_their_ids(tiles):
    depth = scenes.room().render(tiles.camera).measure(seed=2)
    first, second = rp.segment_sequence([depth[:, ::-1], depth], tiles.camera, memory=0)
    text = second._repr_html_()
    assert f"newest id {second.ids.max()}" in text
    assert f"&nbsp;{second.ids[np.argmax(second.segmentation.sizes)]}:&nbsp;" in text
    colours = np.rint(255 * label_colours(int(second.ids.max())))[second.ids - 1]
    shown = np.unique(picture_of(text).reshape(-1, 3), axis=0)
    assert {tuple(colour) for colour in colours} <= {tuple(colour) for colour in shown.astype(float)}
    assert first.ids.max() < second.ids.max()


def test_windows_show_themselves(tiles):
    depth = np.full(tiles.camera.shape, 2000, np.uint16)
    depth[:60, :60] = 0
    windows = rp.fit_windows(depth, tiles.camera, [[100, 100, 150, 200], [0, 0, 50, 50], [150, 150, 50, 50]])
    text = windows._repr_html_()
    assert "WindowPlanes (3,), range_explicit: 2 OK, 1 TOO_FEW" in text
    picture = picture_of(text)
    assert np.array_equal(picture, fits_picture(windows))
    status = picture[:, 328:, :3] / 255.0
    for (y, x), colour in (
        ((10, 10), STATUS_COLOURS[rp.TileStatus.TOO_FEW]),
        ((100, 200), STATUS_COLOURS[rp.TileStatus.OK]),
        ((220, 300), MISSING),
    ):
        np.testing.assert_allclose(status[y, x], colour, atol=0.003)


def test_the_smallest_of_several_windows_is_on_top(tiles):
    depth = np.full(tiles.camera.shape, 2000, np.uint16)
    depth[160:180, 160:180] = 0
    large, small = [100, 100, 150, 200], [160, 160, 20, 20]
    for windows in ([large, small], [small, large]):
        status = fits_picture(rp.fit_windows(depth, tiles.camera, windows))[:, 328:, :3] / 255.0
        for y, x, shown in ((136, 136, rp.TileStatus.TOO_FEW), (100, 200, rp.TileStatus.OK)):
            np.testing.assert_allclose(status[y, x], STATUS_COLOURS[shown], atol=0.003)


def test_small_frames_are_shown_as_they_are():
    camera = rp.Camera(100, 60, 80.0, 80.0, 49.5, 29.5, depth_scale=1000.0)
    depth = np.full(camera.shape, 2000, np.uint16)
    assert fits_picture(rp.fit_tiles(depth, camera)).shape == (60, 100 + 8 + 100, 4)
    assert picture_of(rp.segment(depth, camera)._repr_html_()).shape == (60, 100, 3)


def test_the_largest_planes_are_listed(tiles):
    """With their numbers, colours, sizes and distances; those of a tracked frame by their ids."""
    depth = scenes.room().render(tiles.camera).measure(seed=2)
    _, second = rp.segment_sequence([depth[:, ::-1], depth], tiles.camera, memory=0)
    found = second.segmentation
    assert len(found) > 4
    largest = np.argsort(-found.sizes, kind="stable")[:4]
    for result, numbers in ((found, np.arange(1, len(found) + 1)), (second, second.ids)):
        colours = np.rint(255 * label_colours(int(numbers.max()))).astype(int)[numbers - 1]
        expected = [
            (",".join(map(str, colours[i])), str(numbers[i]), str(found.sizes[i]), f"{found.planes[i, 3]:.3f}")
            for i in largest
        ]
        pattern = (
            r"rgb\(([\d,]+)\)\">&#9632;</span>&nbsp;(\d+):&nbsp;(\d+)&nbsp;pixels,&nbsp;d&nbsp;=&nbsp;([\d.]+)&nbsp;m;"
        )
        assert re.findall(pattern, result._repr_html_()) == expected


def test_names_of_results_are_text_and_no_tags(tiles):
    depth = scenes.room().render(tiles.camera).measure(seed=2)
    (tracked,) = rp.segment_sequence([depth], tiles.camera)
    for result in (tiles, tracked.segmentation, tracked):
        assert f"<div>{type(result).__name__}" in result._repr_html_().replace("<div><div>", "<div>")
        assert f"<{type(result).__name__}" not in result._repr_html_()


def test_normals_of_a_mirrored_image_are_shown_as_in_the_image():
    """Red is to the right of what is seen, whatever the sign of fx."""
    pictures = []
    for fx, slope in ((80.0, 0.3), (-80.0, -0.3)):
        camera = rp.Camera(100, 60, fx, 80.0, 49.5, 29.5)
        pictures.append(fits_picture(rp.fit_tiles(1.0 / (0.5 + slope * camera.tan_x), camera)))
    assert np.array_equal(*pictures)
