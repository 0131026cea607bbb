"""Normals and surface variation against the plain fit of every pixel's window."""

import importlib
import itertools
import threading
from dataclasses import replace

import numpy as np
import oracle
import pytest
from frames import DISTORTIONS, DTYPES_BY_LENS, as_dtype, make_camera, make_depth
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from PIL import Image

import rgbd_planes as rp
from rgbd_planes.cli import main as cli
from rgbd_planes.evaluation import scenes
from rgbd_planes.plotting.normals import plot_normals
from rgbd_planes.sequences import images

HOLES = ("none", "some", "most", "patches", "lines", "almost all")


def make_holes(depth, kind, rng):
    depth = depth.copy()
    if kind == "patches":
        depth[: depth.shape[0] // 3, : depth.shape[1] // 3] = 0
        depth[-5:, 7:] = 0
        depth[:, 17:20] = 0
    elif kind == "lines":  # pixels that determine a line and no plane, and planes by a hair
        depth[::3] = 0
        depth[:, 8:14] = 0
        depth[20:30] = 0
        depth[25] = 2.0
        depth[23, 16] = 2.1
    else:
        share = {"none": 0.0, "some": 0.05, "most": 0.6, "almost all": 0.85}[kind]
        depth[rng.random(depth.shape) < share] = 0
    return depth


def windows_around(pixels, camera, window):
    """The clipped window (row, column, height, width) around each (row, column)."""
    half = window // 2
    for row, column in pixels:
        top, left = max(row - half, 0), max(column - half, 0)
        bottom, right = min(row + half, camera.height - 1), min(column + half, camera.width - 1)
        yield top, left, bottom - top + 1, right - left + 1


def expected_surfaces(depth, camera, window, max_missing, pixels):
    """Normal, residual variance, surface variation and well-posedness around each pixel; NaN for none.

    A pixel need not be valid itself. A problem is well posed if it is for the oracle and its plane is clearly in front
    or behind where the pixel's ray meets it.
    """
    q = oracle.inverse_depth(depth, camera)
    windows = list(windows_around(pixels, camera, window))
    fits = oracle.fit_windows(depth, camera, windows, method="range_explicit", max_missing=max_missing)
    normals = np.full((len(pixels), 3), np.nan)
    variance, variation = np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
    well_posed = np.ones(len(pixels), bool)
    for i, (pixel, (row, column, height, width), fit) in enumerate(zip(pixels, windows, fits, strict=True)):
        if fit.status == oracle.DEGENERATE:
            part = np.s_[row : row + height, column : column + width]
            rays = (camera.tan_x[part], camera.tan_y[part], q[part])
            # It is the plane that all but passes through the camera, not the pixels, that the oracle dislikes.
            well_posed[i] = not oracle.determined("range_explicit", *(a[np.isfinite(q[part])] for a in rays))
        if fit.status != oracle.OK:
            continue
        plane = oracle.orient(fit.plane)
        alpha = -plane[:3] / plane[3]
        ray = np.array([camera.tan_x[pixel], camera.tan_y[pixel], 1.0])
        part = np.s_[row : row + height, column : column + width]
        valid = np.isfinite(q[part])
        rays = np.stack([camera.tan_x[part], camera.tan_y[part], np.ones((height, width))], axis=-1)[valid]
        well_posed[i] = fit.well_posed and abs(alpha @ ray) > 1e-6 * np.abs(alpha).max()
        if alpha @ ray <= 0.0:
            continue
        normals[i] = plane[:3]
        squares = (q[part][valid] - rays @ alpha) ** 2
        variance[i] = squares.sum() / (len(squares) - 3) if len(squares) > 3 else np.nan
        if camera.is_distorted:  # rays are no whole pixels: rounding tells where they lie all but on one line
            sides = np.linalg.svd(rays - rays.mean(axis=0), compute_uv=False)
            well_posed[i] &= sides[1] > 3e-3 * sides[0]
        mean_ray, mean_q = rays.mean(axis=0), q[part][valid].mean()
        jacobian = (np.eye(3) - np.outer(mean_ray, alpha) / mean_q) / mean_q
        spread = np.trace(jacobian @ np.cov(rays.T, bias=True) @ jacobian.T)
        across = plane[3] ** 2 * squares.mean() / mean_q**2
        variation[i] = across / (across + spread)
    return normals, variance, variation, well_posed


def compare(depth, camera, window, pixels=None, *, max_missing=0.5, num_threads=1):
    """Normals and surface variation must equal the oracle's at the given pixels, or at all."""
    if pixels is None:
        pixels = list(np.ndindex(camera.height, camera.width))
    options = {"max_missing": max_missing, "num_threads": num_threads}
    normals = rp.normals(depth, camera, window, **options)
    variation = rp.curvature(depth, camera, window, **options)
    assert normals.shape == (camera.height, camera.width, 3)
    assert variation.shape == (camera.height, camera.width)
    assert normals.dtype == variation.dtype == np.float32
    wanted, _, wanted_variation, well_posed = expected_surfaces(depth, camera, window, max_missing, pixels)
    chosen = tuple(np.array(pixels).T)
    missing = np.isnan(oracle.inverse_depth(depth, camera)[chosen])
    wanted[missing] = np.nan
    wanted_variation[missing] = np.nan
    normals, variation = normals[chosen], variation[chosen]
    np.testing.assert_array_equal(np.isnan(normals[well_posed, 0]), np.isnan(wanted[well_posed, 0]))
    compared = well_posed & np.isfinite(wanted[:, 0])
    if compared.any():
        assert oracle.angle(normals[compared], wanted[compared]).max() < 1e-7
    np.testing.assert_allclose(variation[compared], wanted_variation[compared], rtol=1e-4, atol=1e-8)
    return int(compared.sum())


@pytest.mark.parametrize("distortion", ["pinhole", "eight"])
@pytest.mark.parametrize("holes", HOLES)
@pytest.mark.parametrize("window", [3, 5, 7, 13, 31])
def test_equal_the_plain_fit_at_every_pixel(window, holes, distortion, rng):
    camera = make_camera(DISTORTIONS[distortion], width=30, height=34)
    depth = as_dtype(make_holes(make_depth(camera, rng), holes, rng), "uint16")
    few = holes in ("most", "lines", "almost all")
    assert compare(depth, camera, window, max_missing=1.0 if few else 0.5) > (0 if few else 300)


@pytest.mark.parametrize("max_missing", [0.0, 0.3, 1.0])
@pytest.mark.parametrize(("distortion", "dtype"), [pair for pair in DTYPES_BY_LENS if pair[0] != "eight"])
def test_equal_the_plain_fit_for_any_dtype_and_share(dtype, max_missing, distortion, rng):
    camera = make_camera(DISTORTIONS[distortion], width=29, height=23)
    depth = as_dtype(make_holes(make_depth(camera, rng), "some", rng), dtype)
    depth[3:9, 3:20][rng.random((6, 17)) < 0.8] = 0
    assert compare(depth, camera, 5, max_missing=max_missing) > 50


@pytest.mark.parametrize("window", range(3, 32, 2))
def test_every_window_size_equals_the_plain_fit(window, rng):
    camera = make_camera(width=43, height=47)
    depth = make_holes(make_depth(camera, rng), "some", rng)
    pixels = [tuple(pixel) for pixel in rng.integers((47, 43), size=(150, 2))]
    assert compare(depth, camera, window, pixels) > 100


@pytest.mark.parametrize("holes", ["none", "patches", "some"])
@pytest.mark.parametrize("distortion", ["pinhole", "five"])
@pytest.mark.parametrize("shape", [(150, 24), (9, 1400)], ids=["tall", "wide"])
def test_frames_larger_than_a_band_and_a_strip(shape, distortion, holes, rng):
    height, width = shape
    coefficients = tuple(0.1 * k for k in DISTORTIONS[distortion])
    camera = rp.Camera(width, height, 800.0, 790.0, 0.45 * width, 0.55 * height, coefficients)
    depth = make_holes(make_depth(camera, rng), holes, rng)
    pixels = [tuple(pixel) for pixel in rng.integers(shape, size=(400, 2))]
    # Where bands and strips meet.
    pixels += [(row, column) for row in (62, 63, 64, 65, 127, 128) for column in (0, 11, 23) if row < height]
    pixels += [(row, c) for row in (0, 4, 8) for c in (465, 466, 467, 468, 932, 933, 934, 935) if c < width]
    for window in (5, 7):
        assert compare(depth, camera, window, pixels) > 100


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (2, 2), (3, 5), (7, 4)])
def test_frames_smaller_than_the_window(shape, rng):
    camera = make_camera(width=shape[1], height=shape[0])
    depth = make_depth(camera, rng)
    for window in (3, 7, 31):
        compare(depth, camera, window)
    assert np.isfinite(rp.normals(depth, camera)).all() == (min(shape) > 1)


@pytest.mark.filterwarnings("ignore:many pixels are 65535")
@settings(max_examples=40)
@given(
    height=st.integers(1, 20),
    width=st.integers(1, 20),
    window=st.sampled_from([3, 5, 9, 17]),
    missing=st.floats(0, 1),
    max_missing=st.floats(0, 1),
    dtype=st.sampled_from(["uint16", "float32", "float64"]),
    distorted=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_equal_the_plain_fit_on_any_frame(height, width, window, missing, max_missing, dtype, distorted, seed):
    rng = np.random.default_rng(seed)
    camera = make_camera(DISTORTIONS["eight"] if distorted else (), width=width, height=height)
    depth = as_dtype(rng.uniform(0.3, 9.0, (height, width)), dtype)
    depth[rng.random(depth.shape) < missing] = rng.choice([0, 65535] if dtype == "uint16" else [0, np.nan, -1])
    compare(depth, camera, window, max_missing=max_missing)


@pytest.mark.parametrize("disparity", [(2e-4, 0.05), (-3e-4, 0.9)])
def test_disparity_equals_the_plain_fit(disparity, rng):
    camera = make_camera(width=30, height=25, depth_scale=None, disparity=disparity, invalid_values=(7,))
    raw = np.round((1.0 / make_depth(camera, rng) - disparity[1]) / disparity[0])
    raw = np.clip(raw, 0, 65535).astype(np.uint16)
    raw[rng.random(raw.shape) < 0.2] = 7
    assert compare(raw, camera, 5) > 100


def test_real_frames(real_frame, rng):
    depth, camera = real_frame
    pixels = [tuple(pixel) for pixel in rng.integers(depth.shape, size=(150, 2))]
    for window in (5, 9):
        compare(depth, camera, window, pixels)


@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_a_plane_has_its_normal_everywhere_towards_the_camera(distortion):
    camera = make_camera(DISTORTIONS[distortion])
    normal = np.array([0.3, -0.5, -0.7])
    rendering = scenes.plane(normal, 1.4).render(camera)
    normals = rp.normals(rendering.depth, camera, 9)
    assert oracle.angle(normals, normal / np.linalg.norm(normal)).max() < 2e-7
    assert rp.curvature(rendering.depth, camera, 9).max() < 1e-9
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    assert ((normals * rays).sum(axis=-1) < 0).all()


@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_unit_length_and_towards_the_camera_on_rough_data(distortion, rng):
    camera = make_camera(DISTORTIONS[distortion])
    depth = rng.uniform(0.2, 9.0, camera.shape)
    depth[rng.random(depth.shape) < 0.5] = 0
    normals = rp.normals(depth, camera, 3, max_missing=1.0)
    there = np.isfinite(normals[..., 0])
    assert 0.3 < there.mean() < 0.6
    np.testing.assert_array_equal(np.isfinite(rp.curvature(depth, camera, 3, max_missing=1.0)), there)
    np.testing.assert_allclose(np.linalg.norm(normals[there], axis=-1), 1.0, atol=2e-7)
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    assert ((normals * rays).sum(axis=-1)[there] < 0).all()


@pytest.mark.parametrize("distortion", ["pinhole", "five"])
@pytest.mark.parametrize("wild", [1e-3, 1e-9, 1e-25])
def test_a_wild_value_spoils_only_its_own_windows(distortion, wild, rng):
    camera = make_camera(DISTORTIONS[distortion], width=40, height=140)
    depth = make_depth(camera, rng)
    depth[30, 12] = depth[75, 30] = np.nan
    clean = rp.normals(depth, camera, 5)
    depth[30, 12] = depth[75, 30] = wild
    spoilt = rp.normals(depth, camera, 5)
    own = np.zeros(camera.shape, bool)
    own[28:33, 10:15] = own[73:78, 28:33] = True
    assert oracle.angle(clean, spoilt)[~own].max() < 1e-6
    assert (clean != spoilt)[own].any()


@pytest.mark.parametrize("distortion", ["pinhole", "five"])
@pytest.mark.parametrize("avoid_edges", [False, True])
@pytest.mark.parametrize("holes", ["some", "most"])  # the latter with windows that have too few pixels
def test_the_same_bits_for_any_number_of_threads(distortion, avoid_edges, holes, rng):
    camera = make_camera(DISTORTIONS[distortion], width=90, height=300)
    depth = as_dtype(make_holes(make_depth(camera, rng), holes, rng), "uint16")
    for compute in (rp.normals, rp.curvature):
        results = [
            compute(depth, camera, 9, avoid_edges=avoid_edges, num_threads=n).tobytes() for n in (1, 2, 3, 5, 64, None)
        ]
        assert len(set(results)) == 1


def test_a_hole_is_seen_by_threads_whose_first_rows_have_none(rng):
    camera = make_camera(width=90, height=300)
    depth = make_depth(camera, rng)
    for row in range(50, 300, 64):  # in the middle of the rows that are one thread's at least
        depth[row - 10 : row, 30:50] = 0
    assert len({rp.normals(depth, camera, 9, num_threads=n).tobytes() for n in (1, 2, 5)}) == 1


@pytest.mark.parametrize("distortion", ["pinhole", "five"])
def test_threads_end_at_the_edge_of_a_wide_image(distortion, rng):
    """Where the room for a row holds pixels of another strip, unless the last row was beyond the image."""
    camera = rp.Camera(1400, 130, 800.0, 790.0, 630.0, 71.5, tuple(0.1 * k for k in DISTORTIONS[distortion]))
    depth = make_depth(camera, rng)
    assert len({rp.normals(depth, camera, 5, num_threads=n).tobytes() for n in (1, 3)}) == 1


def test_eight_threads_at_once(rng):
    camera = make_camera(width=90, height=200)
    depth = make_depth(camera, rng)
    wanted = rp.normals(depth, camera).tobytes()
    results = []
    threads = [
        threading.Thread(target=lambda: results.append(rp.normals(depth, camera, num_threads=2).tobytes()))
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [wanted] * 8


def test_the_frame_is_left_as_it_was(rng):
    camera = make_camera()
    depth = make_depth(camera, rng)
    before = depth.copy()
    rp.normals(depth, camera, avoid_edges=True)
    np.testing.assert_array_equal(depth, before)


def test_a_scale_whose_square_is_beyond_all_numbers(rng):
    camera = replace(make_camera(), depth_scale=1e200)
    codes = rng.integers(1, 9, camera.shape).astype(np.uint16)
    with pytest.warns(UserWarning, match="in other units"):
        assert rp.normals(codes, camera, avoid_edges=True).shape == (*camera.shape, 3)


def test_surface_variation_is_the_share_of_the_smallest_eigenvalue(rng):
    """To first order, so on a window that is small for its distance."""
    camera = rp.Camera(40, 240, 525.0, 525.0, 20.0, 200.0).cropped(0, 0, 40, 40)
    depth = 1.0 / (0.5 + 0.2 * camera.tan_x - 0.4 * camera.tan_y + 2e-4 * rng.standard_normal(camera.shape))
    window = 9
    variation = rp.curvature(depth, camera, window)
    points = sliding_window_view(camera.points(depth), (window, window), axis=(0, 1)).reshape(32, 32, 3, -1)
    points = points - points.mean(axis=-1, keepdims=True)
    eigenvalues = np.linalg.eigvalsh(points @ points.swapaxes(-1, -2))
    usual = eigenvalues[..., 0] / eigenvalues.sum(axis=-1)
    np.testing.assert_allclose(variation[4:-4, 4:-4], usual, rtol=0.03)


@pytest.mark.parametrize("distortion", ["pinhole", "five"])
@pytest.mark.parametrize("holes", ["none", "some", "most"])
def test_avoiding_edges_takes_the_calmest_window_beside(distortion, holes, rng):
    camera = make_camera(DISTORTIONS[distortion], width=34, height=30)
    metres = make_depth(camera, rng, noise=1e-3)
    metres[8:20, 9:25] *= 0.6  # a step in depth, beside the creases
    depth = make_holes(metres, holes, rng)
    window, half = 7, 3
    shape = camera.shape
    normals, variance, variation, _ = (
        array.reshape(*shape, *array.shape[1:])
        for array in expected_surfaces(depth, camera, window, 0.5, list(np.ndindex(shape)))
    )
    ratio = np.exp(2 * 3.09 / np.sqrt(window**2 - 3))
    usual = np.nanmedian(variance)  # of all pixels in so small a frame
    wanted, wanted_variation = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
    clear = np.zeros(shape, bool)  # of ties that rounding decides
    moved = 0
    for row, column in np.argwhere(np.isfinite(oracle.inverse_depth(depth, camera))):
        own = variance[row, column]
        rows = np.clip([row - half, row, row + half], 0, shape[0] - 1)
        columns = np.clip([column - half, column, column + half], 0, shape[1] - 1)
        others = {(r, c): variance[r, c] for r in rows for c in columns if np.isfinite(variance[r, c])}
        best = min(others, key=others.get, default=None)
        if best is None or not (np.isnan(own) or own > ratio * max(others[best], usual)):
            best = row, column
        runners_up = [v for place, v in others.items() if place != best]
        clear[row, column] = all(abs(v / variance[best] - 1) > 1e-4 for v in runners_up)
        clear[row, column] &= np.isnan(own) or all(abs(own / ratio / v - 1) > 1e-4 for v in [*others.values(), usual])
        ray = camera.tan_x[row, column], camera.tan_y[row, column], 1.0
        if normals[best] @ ray < 0:
            wanted[row, column], wanted_variation[row, column] = normals[best], variation[best]
            moved += best != (row, column)
    result = rp.normals(depth, camera, window, avoid_edges=True)
    assert clear.sum() > 0.3 * clear.size
    assert moved > 50
    np.testing.assert_array_equal(np.isnan(result[clear, 0]), np.isnan(wanted[clear, 0]))
    compared = clear & np.isfinite(wanted[..., 0])
    assert oracle.angle(result[compared], wanted[compared]).max() < 1e-7
    np.testing.assert_allclose(
        rp.curvature(depth, camera, window, avoid_edges=True)[compared], wanted_variation[compared], rtol=1e-4
    )


def test_avoiding_edges_helps_at_edges_and_leaves_planes_alone():
    camera = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=1000.0)
    rendering = scenes.room().render(camera)
    depth = rendering.measure(noise=3e-4, seed=3)
    truth = rendering.planes[rendering.labels - 1, :3]
    blocks = sliding_window_view(np.pad(rendering.labels, 3, mode="edge"), (7, 7))
    near_edge = (blocks != rendering.labels[..., None, None]).any(axis=(2, 3))
    plain, clear = (oracle.angle(rp.normals(depth, camera, 7, avoid_edges=choice), truth) for choice in (False, True))
    assert np.median(clear[near_edge]) < 0.3 * np.median(plain[near_edge])
    assert np.median(clear[~near_edge]) < 1.05 * np.median(plain[~near_edge])


@pytest.mark.parametrize(("window", "distance"), [(7, 3.0), (15, 5.0)])
@pytest.mark.parametrize("is_disparity", [False, True])
def test_steps_of_rounding_are_no_edges(window, distance, is_disparity):
    """On a slope without noise they are terraces, each of which is flatter than the slope is."""
    unit = {"disparity": (-0.0030711, 3.3309)} if is_disparity else {"depth_scale": 300.0 / distance**2}
    camera = rp.Camera(160, 120, 290.0, 290.0, 79.5, 59.5, **unit)
    rendering = scenes.plane((0.3, 0.1, -1.0), distance).render(camera)
    depth = rendering.measure(noise=0.0)
    plain, clear = (
        oracle.angle(rp.normals(depth, camera, window, avoid_edges=choice), rendering.planes[0, :3])
        for choice in (False, True)
    )
    assert np.mean(clear) < 1.01 * np.mean(plain)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("window", [5, 7, 11])
def test_steps_of_the_sensor_are_no_edges_either(window, noise):
    """A Kinect's steps of an eighth of a pixel of disparity, in a frame of millimetres."""
    camera = rp.Camera(320, 240, 580.0, 580.0, 159.5, 119.5, depth_scale=1000.0)
    wall = scenes.plane((0.3, 0.2, -1.0), 2.5).render(camera)
    step = 1.0 / (8.0 * 580.0 * 0.075)
    measured = 1.0 / wall.measure(noise=noise, seed=1).astype(float) * 1000.0
    depth = np.rint(1000.0 / (step * np.rint(measured / step))).astype(np.uint16)
    plain, clear = (rp.normals(depth, camera, window, avoid_edges=choice) for choice in (False, True))
    of_plain, of_clear = (np.nanmean(oracle.angle(found, wall.planes[0, :3])) for found in (plain, clear))
    assert of_clear < 1.05 * of_plain
    faces_the_camera = (clear[..., 2] < -0.9999).mean()  # as the terraces do, not the wall
    assert faces_the_camera < 0.02 + 1.1 * (plain[..., 2] < -0.9999).mean()


@pytest.mark.parametrize(
    ("window", "missing", "share"), [(3, 0.0, 0.01), (3, 0.2, 0.06), (7, 0.0, 0.001), (7, 0.2, 0.005)]
)
def test_chance_makes_edges_of_few_pixels_as_documented(window, missing, share, rng):
    """Of a wall: hardly of one where noise is the same everywhere."""
    camera = rp.Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
    noise = np.where(np.arange(640) < 400, 3e-5, 1.5e-3)
    for sigma, least, most in ((noise, 0.6 * share, 1.6 * share), (noise[-1], 0.0, 0.2 * share)):
        depth = 1.0 / (0.5 + sigma * rng.standard_normal(camera.shape))
        depth[rng.random(camera.shape) < missing] = np.nan
        plain, clear = (rp.normals(depth, camera, window, avoid_edges=c)[:, 410:] for c in (False, True))
        both = np.isfinite(plain[..., 0] + clear[..., 0])
        assert least <= np.mean((plain != clear).any(axis=-1)[both]) <= most


@pytest.mark.parametrize(
    ("window", "error", "message"),
    [
        (4, ValueError, "window must be odd, from 3 to 31 pixels, got 4"),
        (1, ValueError, "got 1"),
        (33, ValueError, "got 33"),
        (7.0, TypeError, "window must be a whole number of pixels, got 7.0"),
        (True, TypeError, "got True"),
        ((7, 7), TypeError, "whole number"),
    ],
)
def test_bad_windows_are_refused(window, error, message):
    camera = make_camera()
    with pytest.raises(error, match=message.replace("(", r"\(")):
        rp.normals(np.ones(camera.shape), camera, window)


def test_bad_arguments_are_refused():
    camera = make_camera()
    depth = np.ones(camera.shape)
    with pytest.raises(TypeError, match="expected a Camera, got dict"):
        rp.normals(depth, {})
    with pytest.raises(ValueError, match="max_missing must be between 0 and 1"):
        rp.curvature(depth, camera, max_missing=1.5)
    with pytest.raises(TypeError, match="expected avoid_edges as True or False, got 'no'"):
        rp.normals(depth, camera, avoid_edges="no")
    rp.normals(depth, camera, avoid_edges=np.bool_(False))
    with pytest.raises(ValueError, match="num_threads must be at least 1"):
        rp.normals(depth, camera, num_threads=0)
    with pytest.raises(ValueError, match="expected a depth frame of shape"):
        rp.normals(depth[1:], camera)
    with pytest.raises(ValueError, match="depth_scale"):
        rp.normals(depth.astype(np.uint16), make_camera(depth_scale=None))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder to work in with a depth frame and its camera."""
    monkeypatch.chdir(tmp_path)
    camera = make_camera()
    images.write_png("depth.png", scenes.room().render(camera).measure(holes=0.05, seed=1))
    camera.save("camera.json")
    return tmp_path


def test_command_writes_normals_and_a_figure(folder, capsys):
    arguments = "normals depth.png --camera camera.json --window 9 --avoid-edges --max-missing 0.3 --threads 2"
    assert cli.main([*arguments.split(), "--out", "n.npy", "--figure", "n.png"]) == 0
    depth, camera = images.read_depth("depth.png"), rp.Camera.load("camera.json")
    wanted = rp.normals(depth, camera, 9, avoid_edges=True, max_missing=0.3)
    np.testing.assert_array_equal(np.load("n.npy"), wanted)
    share = np.isfinite(wanted[..., 0]).mean()
    out = capsys.readouterr().out
    assert f"64 x 48 pixels, windows of 9 x 9: normals at {100 * share:.1f} % of the pixels." in out
    with Image.open("n.png") as picture:
        assert picture.width > 1000
        assert np.ptp(np.asarray(picture.convert("L"))) > 200


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--window 8", "window must be odd"),
        ("--max-missing 2", "--max-missing must be between 0 and 1"),
        ("--out n.txt", "expected a name that ends in .npy"),
        ("--figure nowhere/n.png", "there is no folder"),
    ],
)
def test_command_says_what_is_wrong(folder, capsys, options, message):
    assert cli.main(["normals", "depth.png", "--camera", "camera.json", *options.split()]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert sorted(path.name for path in folder.iterdir()) == ["camera.json", "depth.png"]


@pytest.mark.parametrize("options", [[], ["--avoid-edges"]])
def test_figure_says_that_edges_look_flat_unless_they_are_avoided(folder, monkeypatch, options):
    figures = []
    command = importlib.import_module("rgbd_planes.cli.normals")
    monkeypatch.setattr(command, "write_figure", lambda figure, path: figures.append(figure))
    assert cli.main(["normals", "depth.png", "--camera", "camera.json", "--figure", "normals.png", *options]) == 0
    texts = [axes.get_xlabel() for below in figures[0].axes for axes in below.child_axes]
    (text,) = (text for text in texts if "variance" in text)
    assert ("edges look flat" in text) == (not options)
    assert "noise looks curved" in text


def test_figure_of_a_frame_with_nothing_in_it():
    camera = make_camera()
    depth = np.zeros(camera.shape)
    figure = plot_normals(depth, camera, rp.normals(depth, camera), rp.curvature(depth, camera))
    assert figure._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize(("low", "high"), [(0.0012, 0.083), (0.002, 0.008), (0.2, 0.22), (1e-9, 0.3)])
def test_labels_of_the_curvature_are_legible(low, high):
    camera = make_camera()
    curvature = np.geomspace(low, high, camera.width * camera.height, dtype=np.float32)
    depth = np.ones(camera.shape)
    figure = plot_normals(depth, camera, rp.normals(depth, camera), curvature.reshape(camera.shape))
    figure.draw_without_rendering()
    (axis,) = (axes.xaxis for below in figure.axes for axes in below.child_axes if "var" in axes.get_xlabel())
    least, most = axis.get_view_interval()
    ticks = sorted([*axis.get_major_ticks(), *axis.get_minor_ticks()], key=lambda tick: tick.get_loc())
    boxes = [
        tick.label1.get_window_extent()
        for tick in ticks
        if tick.label1.get_text() and 0.999 * least <= tick.get_loc() <= 1.001 * most
    ]
    assert len(boxes) >= 2
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))


def test_figure_has_the_curvature_of_the_same_windows(folder, monkeypatch):
    figures = []
    command = importlib.import_module("rgbd_planes.cli.normals")
    monkeypatch.setattr(command, "write_figure", lambda figure, path: figures.append(figure))
    arguments = "normals depth.png --camera camera.json --window 9 --avoid-edges --max-missing 0.3 --figure n.png"
    assert cli.main(arguments.split()) == 0
    depth, camera = images.read_depth("depth.png"), rp.Camera.load("camera.json")
    shown = np.ma.filled(figures[0].axes[2].get_images()[0].get_array(), np.nan)
    np.testing.assert_array_equal(shown, rp.curvature(depth, camera, 9, avoid_edges=True, max_missing=0.3))


def test_steps_of_metres_that_were_integers_are_no_edges_either():
    camera = rp.Camera(1280, 40, 2320.0, 2320.0, 639.5, 19.5, depth_scale=250.0)
    metres = rp.Camera(1280, 40, 2320.0, 2320.0, 639.5, 19.5)
    raw = scenes.plane((0.3, 0.1, -1.0), 3.0).render(camera).measure(noise=0.0)
    plain = rp.normals(raw, camera, 7)
    for depth, same in ((raw, camera), ((raw / 250.0).astype(np.float32), metres), (raw / 250.0, metres)):
        np.testing.assert_allclose(rp.normals(depth, same, 7, avoid_edges=True), plain, atol=1e-3)


@pytest.mark.parametrize("depth_range", [(0.0, 3.0), (1.5, 8.0)], ids=["too far", "too near"])
def test_avoiding_edges_gives_no_normal_where_nothing_is_measured(depth_range):
    """Beside what is beyond the range there are windows that would do."""
    camera = rp.Camera(64, 48, 50.0, 50.0, 31.5, 23.5, depth_scale=1000.0, depth_range=depth_range)
    raw = np.full(camera.shape, 2000, np.uint16)
    beyond = np.zeros(camera.shape, bool)
    beyond[10:14, 20:24] = beyond[30, 40] = True
    raw[beyond] = 5000 if depth_range[1] < 5.0 else 1000
    normals = rp.normals(raw, camera, avoid_edges=True)
    np.testing.assert_array_equal(np.isnan(normals[..., 0]), beyond)


def test_avoiding_edges_gives_no_normal_away_from_the_camera(rng):
    camera = rp.Camera(64, 48, 30.0, 30.0, 31.5, 23.5)
    depth = rng.uniform(0.001, 1.0, camera.shape) ** -3.0
    depth[20:] = rng.uniform(1.0, 1.001, (28, 64))  # by which the rest is unusual
    normals = rp.normals(depth, camera, 3, avoid_edges=True)
    there = np.isfinite(normals[..., 0])
    assert 0.95 < there.mean() < 1.0
    rays = np.dstack([camera.tan_x, camera.tan_y, np.ones(camera.shape)])
    assert ((normals * rays).sum(axis=-1)[there] < 0).all()


@pytest.mark.parametrize("convert", [np.uint16, lambda raw: raw / 1000.0], ids=["integers", "metres"])
def test_edges_are_avoided_in_frames_without_noise(convert):
    """There no window but those across edges has a residual: that is not what is usual."""
    camera = rp.Camera(160, 120, 150.0, 150.0, 79.5, 59.5, depth_scale=1000.0)
    raw = np.full(camera.shape, 2000.0)
    raw[40:80, 50:110], raw[10:30, 10:45] = 1500.0, 1900.0
    found = rp.normals(convert(raw), camera, avoid_edges=True)
    np.testing.assert_allclose(found, np.broadcast_to([0.0, 0.0, -1.0], found.shape), atol=1e-5)
    rendering = scenes.room().render(rp.presets.primesense())
    angles = [
        oracle.angle(
            rp.normals(rendering.depth, rendering.camera, avoid_edges=avoid), rendering.planes[rendering.labels - 1, :3]
        )
        for avoid in (False, True)
    ]
    wrong = [np.mean(angle[rendering.labels > 0] > np.radians(10.0)) for angle in angles]
    assert wrong[1] < 0.1 * wrong[0]
