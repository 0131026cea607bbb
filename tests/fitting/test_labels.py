"""Planes of the pixels of labels, wherever they lie, against the oracle."""

from dataclasses import replace

import numpy as np
import oracle
import pytest
from frames import CHANGE, METHODS, RMSE_FLOOR, assert_equals_oracle, make_camera, make_depth
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import rgbd_planes as rp

DISPARITY = {"depth_scale": None, "disparity": (-0.002, 3.0), "invalid_values": (0,)}


@settings(max_examples=60)
@given(data=st.data())
def test_equals_oracle(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    options = data.draw(st.sampled_from([{}, DISPARITY]))
    camera = make_camera(data.draw(st.sampled_from([(), (0.2, -0.5, 0.001, 0.002, 0.3)])), 31, 26, **options)
    depth = make_depth(camera, rng)
    if camera.disparity is not None:
        depth = ((1.0 / depth - 3.0) / -0.002).round().astype(np.uint16)
    elif data.draw(st.booleans()):
        depth = (1000.0 * depth).astype(np.uint16)
    depth[rng.random(depth.shape) < data.draw(st.sampled_from([0.0, 0.1, 0.7]))] = 0
    # Half planes over each other, and pixels strewn over all: also labels of no pixel, of one, and of one line.
    labels = np.zeros(camera.shape, data.draw(st.sampled_from([np.int32, np.uint8, np.int64])))
    rows, columns = np.indices(camera.shape)
    for i in range(1, data.draw(st.integers(1, 6)) + 1):
        side = rng.normal(size=3) @ np.array([rows - 13.0, columns - 15.0, np.full(rows.shape, 5.0)]).reshape(3, -1)
        labels[side.reshape(rows.shape) > 0.0] = i
    strewn = rng.random(labels.shape) < data.draw(st.sampled_from([0.0, 0.01, 0.5]))
    labels[strewn] = rng.integers(0, 9, np.count_nonzero(strewn))
    method = data.draw(st.sampled_from(METHODS))
    max_missing = data.draw(st.sampled_from([0.0, 0.5, 1.0]))
    fits = rp.fit_labels(depth, camera, labels, method, max_missing=max_missing)
    expected = oracle.fit_labels(depth, camera, labels, method, max_missing=max_missing, change=CHANGE["naive"])
    assert_equals_oracle(fits, expected, rmse_floor=RMSE_FLOOR["naive"])
    np.testing.assert_array_equal(fits.labels, labels)


CORRELATED = rp.noise.NoiseModel(correlation=((0.3, 2.0),), floor=0.5, floor_length=30.0)


@pytest.mark.parametrize("noise", [rp.noise.kinect_v1(), CORRELATED], ids=["independent", "correlated"])
@pytest.mark.parametrize("method", METHODS)
def test_rectangles_are_windows(method, noise, rng):
    camera = replace(rp.presets.kinect_v1(), noise=noise)
    depth = make_depth(camera, rng)
    windows = [[10, 20, 100, 60], [200, 0, 280, 300], [50, 400, 1, 40]]
    labels = np.zeros(camera.shape, int)
    for i, (row, column, height, width) in enumerate(windows, start=1):
        labels[row : row + height, column : column + width] = i
    found, expected = (rp.fit_labels(depth, camera, labels, method), rp.fit_windows(depth, camera, windows, method))
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_allclose(found.planes, expected.planes, rtol=1e-9, atol=1e-9)
    if noise.is_independent:
        np.testing.assert_allclose(found.plane_covariance, expected.plane_covariance, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(found.p_value, expected.p_value, rtol=1e-6)
    else:  # those of a window are interpolated between proportions, those of labels summed up by cells
        ratio = np.linalg.eigvals(np.linalg.solve(expected.alpha_covariance[:2], found.alpha_covariance[:2])).real
        np.testing.assert_allclose(ratio, 1.0, atol=0.03 if method.startswith("range") else 0.06)
        np.testing.assert_allclose(found.p_value, expected.p_value, atol=0.05)


def test_labels_of_tiles_are_their_merged_planes(rng):
    camera = replace(rp.presets.kinect_v1(), noise=rp.noise.kinect_v1())
    depth = rp.scenes.room().render(camera).measure(holes=0.1, seed=3)
    of_tiles = rng.integers(0, 20, (30, 40))
    merged = rp.merge(rp.fit_tiles(depth, camera, 16), of_tiles)
    found = rp.fit_labels(depth, camera, np.kron(of_tiles, np.ones((16, 16), int)))
    np.testing.assert_array_equal(found.valid_count, merged.valid_count)
    np.testing.assert_allclose(found.planes, merged.planes, rtol=1e-9)
    np.testing.assert_allclose(found.offset_std, merged.offset_std, rtol=1e-6)
    again = rp.merge(found, (np.arange(found.shape[0]) % 2) + 1)
    halves = rp.fit_labels(depth, camera, np.where(found.labels > 0, (found.labels - 1) % 2 + 1, 0))
    np.testing.assert_allclose(again.planes, halves.planes, rtol=1e-9)


def test_the_errors_of_a_union_are_those_of_its_own_plane(rng):
    """Whatever other unions there are: the lateral error goes with the slope."""
    camera = make_camera(noise=rp.noise.NoiseModel((1e-3,), lateral=0.5, step=0.01))
    q = np.where(np.arange(64) < 32, 0.5 + 0.0 * camera.tan_x, 0.5 + 0.5 * camera.tan_x)
    tiles = rp.fit_tiles(1.0 / (q + 1e-3 * rng.standard_normal(q.shape)), camera, 16)
    labels = np.where(np.arange(4) < 2, 1, 2) * np.ones((3, 1), int)
    both, alone = rp.merge(tiles, labels), rp.merge(tiles, labels == 2)
    np.testing.assert_array_equal(both.alpha_covariance[1], alone.alpha_covariance[0])
    assert both.p_value[1] == alone.p_value[0]


def test_three_pixels_of_tiles_without_a_plane_make_a_union():
    camera = rp.Camera(4, 4, 5.0, 5.0, 1.5, 1.5)
    depth = np.zeros((4, 4))
    depth[[0, 0, 3], [0, 3, 0]] = 1.0, 1.1, 1.2
    tiles = rp.fit_tiles(depth, camera, 2)
    union = rp.merge(tiles, [[1, 1], [1, 0]])
    assert not tiles.fitted.any()
    assert (union.status[0], union.valid_count[0]) == (rp.TileStatus.OK, 3)
    points = camera.points(depth)[depth > 0.0]
    np.testing.assert_allclose(points @ union.planes[0, :3], -union.planes[0, 3])
    assert rp.merge(tiles, [[1, 1], [0, 0]]).status[0] == rp.TileStatus.TOO_FEW


def test_true_labels_give_true_planes():
    camera = replace(rp.presets.kinect_v1(), noise=rp.noise.kinect_v1())
    rendering = rp.scenes.room().render(camera)
    found = rp.fit_labels(rendering.measure(holes=0.05, seed=5), camera, rendering.labels)
    deviation = (found.alpha + rendering.planes[:, :3] / rendering.planes[:, 3:])[..., None]
    squares = (deviation.mT @ np.linalg.solve(found.alpha_covariance, deviation)).ravel()
    assert found.fitted.all()
    assert np.mean(squares) == pytest.approx(3.0, abs=1.5)  # chi-square of 3 of 24 planes
    assert (found.p_value > 1e-4).all()


def test_a_mask_is_one_label(rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    mask = depth < np.median(depth)
    fits = rp.fit_labels(depth, camera, mask)
    assert fits.shape == (1,)
    assert fits.valid_count[0] == np.count_nonzero(mask)
    assert rp.fit_labels(depth, camera, np.zeros_like(mask)).planes.shape == (0, 4)


def test_an_image_of_a_mask_is_said_to_be_one(rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    mask = np.where(depth < np.median(depth), 255, 0).astype(np.uint8)
    with pytest.warns(UserWarning, match="the only label is 255: is it a mask") as caught:
        fits = rp.fit_labels(depth, camera, mask)
    assert caught[0].filename == __file__
    assert fits.shape == (255,)


def test_labels_in_which_255_is_none_are_not_taken_for_255_labels_in_silence(rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    labels = np.where(depth < np.median(depth), 255, 0).astype(np.uint8)
    labels[:10] = 1
    with pytest.warns(UserWarning, match=r"labels are 0 to 1, and 255: .* labels \+ np\.uint8\(1\) has 0 for none"):
        rp.fit_labels(depth, camera, labels)
    fits = rp.fit_labels(depth, camera, labels + np.uint8(1))
    assert fits.shape == (2,)
    np.testing.assert_array_equal(fits.labels == 0, labels == 255)
    labels[20] = 254  # as many as that, then
    rp.fit_labels(depth, camera, labels)


def test_a_label_without_pixels_has_no_plane(rng):
    camera = make_camera()
    labels = np.full(camera.shape, 3)
    fits = rp.fit_labels(make_depth(camera, rng), camera, labels)
    assert [rp.TileStatus(status).name for status in fits.status] == ["TOO_FEW", "TOO_FEW", "OK"]


def test_the_labels_are_copied(rng):
    camera = make_camera()
    labels = np.ones(camera.shape, np.int32)
    fits = rp.fit_labels(make_depth(camera, rng), camera, labels)
    labels[:] = 2
    assert (fits.labels == 1).all()


def test_the_labels_of_unions_are_copied_and_may_be_more_than_the_tiles(rng):
    """As those of segments, of which a tile may have several."""
    camera = make_camera()
    tiles = rp.fit_tiles(make_depth(camera, rng), camera, (24, 32))
    labels = np.array([[1, 1], [9, 0]], np.int32)
    union = rp.merge(tiles, labels)
    labels[:] = 2
    assert union.labels.tolist() == [[1, 1], [9, 0]]
    assert np.flatnonzero(union.fitted).tolist() == [0, 8]


@pytest.mark.parametrize(
    ("labels", "error", "message"),
    [
        ("labels.png", TypeError, "expected labels as an array, got str: .* reads a file"),
        (np.ones((48, 64)), TypeError, "labels must be integers, or a mask, got dtype float64"),
        (np.ones((48, 65), int), ValueError, r"the shape of the frame, \(48, 64\), got \(48, 65\)"),
        (np.ones((48, 64, 3), int), ValueError, r"got \(48, 64, 3\)$"),
        (np.ones((3, 48, 64), bool), ValueError, r"got \(3, 48, 64\): .* makes labels of masks"),
        (np.full((48, 64), -1), ValueError, r"got -1 to -1: labels \+ 1 are"),
        (np.full((48, 64), 0xFFFF00), ValueError, "got 16776960 to 16776960: np.unique"),
        (np.full((48, 64), 2**63, np.uint64), ValueError, "got 9223372036854775808 to"),
        (np.ma.masked_equal(np.ones((48, 64), int), 0), TypeError, r"fill it first, labels.filled\(0\)"),
    ],
)
def test_bad_labels_are_refused(labels, error, message):
    camera = make_camera()
    with pytest.raises(error, match=message):
        rp.fit_labels(np.ones(camera.shape), camera, labels)


def test_it_shows_itself(rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    labels = np.zeros(camera.shape, int)
    labels[8:40, :30], labels[8:40, 34:] = 1, 2
    fits = rp.fit_labels(depth, camera, labels, max_error=1e-6)
    assert repr(fits).startswith("<LabelPlanes (2,), range_explicit: 2 ROUGH, median rmse ")
    assert "2 ROUGH" in fits._repr_html_()
    figure = fits.plot(depth)
    figure.canvas.draw()
    assert figure.axes[2].get_title() == "2 labels, range_explicit"


def test_a_disparity_of_nothing_adds_nothing_to_a_union():
    """Where disparity + 1 is stored, 1/Z is 0 for the raw value 1, which an empty tile is given."""
    camera = rp.Camera(64, 48, 50.0, 50.0, 31.5, 23.5, disparity=(0.01, -0.01), noise=rp.noise.time_of_flight(0.01))
    raw = np.full(camera.shape, 51, np.uint16) + np.arange(64, dtype=np.uint16) % 3
    raw[:16, :16] = 0
    for method in ("standard_explicit", "range_explicit"):
        tiles = rp.fit_tiles(raw, camera, 16, method)
        assert tiles.valid_count[0, 0] == 0
        union = rp.merge(tiles, np.ones(tiles.shape, int))
        assert np.isfinite(union.offset_std).all()
        assert np.isfinite(tiles._reference).all()


def test_rough_by_significance_is_a_small_p_value_for_labels_and_unions(rng):
    """As for tiles: no test at 0, and by default one in a hundred."""
    camera = make_camera(depth_scale=None, noise=rp.noise.NoiseModel((2e-3,)))
    depth = make_depth(camera, rng)
    pieces = np.arange(12).reshape(3, 4) + 1
    labels, tiles = np.kron(pieces, np.ones((16, 16), int)), rp.fit_tiles(depth, camera, 16, significance=0.0)
    rough = []
    for given_level, level in ((0.0, 0.0), (None, 0.01), (0.9, 0.9)):
        for found in (
            rp.fit_labels(depth, camera, labels, significance=given_level),
            rp.merge(tiles, pieces, significance=given_level),
        ):
            np.testing.assert_array_equal(found.status == rp.TileStatus.ROUGH, found.p_value < level)
        rough.append(np.count_nonzero(found.status == rp.TileStatus.ROUGH))
    assert rough == sorted(set(rough))
    plain = replace(camera, noise=None)
    with pytest.raises(ValueError, match="significance needs a camera with a noise model"):
        rp.fit_labels(depth, plain, labels, significance=0.0)
    with pytest.raises(ValueError, match="significance needs a camera with a noise model"):
        rp.merge(rp.fit_tiles(depth, plain), pieces, significance=0.0)


def test_p_values_of_very_many_pixels_are_those_of_chi_square(rng):
    """Noise that is larger by half a percent shows in 300 000 pixels."""
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5, noise=rp.noise.NoiseModel((1e-3,)))
    q = 0.5 + 1.005e-3 * rng.standard_normal(camera.shape)
    found = rp.fit_labels(1.0 / q, camera, np.ones(camera.shape, int))
    expected = stats.chi2.sf(q.size * (found.rmse[0] / 1e-3) ** 2, q.size - 3)
    assert found.p_value[0] == pytest.approx(expected, rel=0.05)
    assert expected < 1e-2
