"""What cannot be used is refused at the door, with what was expected and what came."""

import pickle
import re
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from processes import printed_by

import rgbd_planes as rp
from bench.monte_carlo import CORRELATED
from rgbd_planes import export, noise, segmentation_export, sequences, uncertainty
from rgbd_planes.evaluation import metrics, scenes
from rgbd_planes.segmentation.quadtree import QuadtreeFitter
from rgbd_planes.sequences import images

CAMERA = rp.Camera(64, 48, 50.0, 50.0, 31.5, 23.5, depth_scale=1000.0)
DEPTH = np.full(CAMERA.shape, 1500, np.uint16)
LARGE = np.full((2, 2), 2**63, np.uint64)
FRAMES = sequences.FrameSequence([sequences.FrameEntry("0", 0.0, CAMERA, None)], lambda location: DEPTH)


class Noise:
    """A model of a user's own."""

    def __init__(self, lateral):
        self.lateral = lateral

    def sigma(self, q):
        return 1e-3 + 0.0 * q


@pytest.mark.parametrize(
    "use",
    [
        lambda camera: rp.fit_tiles(DEPTH, camera),
        lambda camera: rp.fit_windows(DEPTH, camera, [[0, 0, 8, 8]]),
        lambda camera: rp.fit_labels(DEPTH, camera, DEPTH > 0),
        lambda camera: rp.segment(DEPTH, camera),
        lambda camera: next(rp.segment_sequence([DEPTH], camera)),
        lambda camera: rp.segment_quadtree(DEPTH, camera),
        lambda camera: rp.normals(DEPTH, camera),
        lambda camera: rp.measurement_noise(DEPTH, camera),
        lambda camera: rp.estimate_noise([DEPTH], camera),
        lambda camera: scenes.room().render(camera),
        lambda camera: export.to_ros_points(DEPTH, camera),
        rp.warmup,
    ],
)
def test_what_is_no_camera_is_refused(use):
    with pytest.raises(TypeError, match="expected a Camera, got ndarray"):
        use(np.eye(3))


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ("camera.json", "got str: Camera.load reads a file"),
        (Path("camera.json"), "Camera.load reads a file"),
        (CAMERA.to_dict(), "got dict: Camera.from_dict takes one"),
        (np.eye(3), "got ndarray: Camera.from_opencv takes a matrix"),
        (DEPTH, r"got ndarray of shape \(48, 64\): is it the depth\? The camera comes after it$"),
        (None, "got NoneType$"),
    ],
)
def test_what_would_make_a_camera_is_named(camera, message):
    with pytest.raises(TypeError, match=message):
        rp.fit_tiles(DEPTH, camera)
    if camera is not None:
        with pytest.raises(TypeError, match=message):
            rp.open_sequence(".", camera)


@pytest.mark.parametrize(
    ("depth", "error", "message"),
    [
        (None, TypeError, "as an array, got NoneType: has the file been read?"),
        ("depth.png", TypeError, "as an array, got str: rgbd_planes.images.read_depth reads a file"),
        (Path("depth.png"), TypeError, "Path: rgbd_planes.images.read_depth reads a file"),
        (FRAMES[0], TypeError, "as an array, got Frame: the array is the depth of a Frame"),
        (FRAMES, TypeError, "as an array, got FrameSequence: the array is the depth of a Frame"),
        (DEPTH.tobytes(), TypeError, "expected a depth frame as an array, got bytes$"),
        (object(), TypeError, "expected a depth frame as an array, got object$"),
        (3, ValueError, r"got \(\)$"),
        (np.zeros((48, 64, 3), np.uint8), ValueError, "is it a colour image.* IMREAD_UNCHANGED$"),
        (CAMERA.points(DEPTH), ValueError, r"or points, whose depth is \[..., 2\]"),
        (DEPTH[None], ValueError, "squeeze it$"),
        ([DEPTH, DEPTH], ValueError, "TileFitter.fit_batch and segment_sequence take several frames$"),
        (DEPTH.T, ValueError, "is it transposed, or are the camera's width and height swapped"),
        (DEPTH[0], ValueError, r"of several\? TileFitter\.fit and rp\.segment take one frame$"),
        (DEPTH[::2, ::2], ValueError, "is the calibration that of another resolution"),
        (DEPTH[1:], ValueError, r"got \(47, 64\)$"),
    ],
)
def test_what_is_no_depth_frame_is_refused(depth, error, message):
    with pytest.raises(error, match=message):
        rp.fit_tiles(depth, CAMERA)


@pytest.mark.parametrize(
    ("use", "error", "message"),
    [
        (lambda: rp.fit_tiles(DEPTH, CAMERA, max_missing="a"), TypeError, "max_missing as a number, got 'a'"),
        (lambda: rp.fit_tiles(DEPTH, CAMERA, max_missing=np.nan), ValueError, "between 0 and 1, got nan"),
        (lambda: rp.fit_tiles(DEPTH, CAMERA, max_error="a"), TypeError, "max_error as a number, got 'a'"),
        (lambda: noise.NoiseModel((1e61,)), ValueError, r"noise of 0 to 1e\+60 1/m at all inverse depths, got 1e\+61"),
        (lambda: metrics.plane_errors([[0, 0, 1, 1]], [[0, 0, 0, 1]]), ValueError, r"in truth, got \[0.0, 0.0, "),
        (lambda: metrics.plane_errors([[0, 0, 1j, 1]], [[0, 0, 1, 1]]), TypeError, "predicted as .*complex128"),
        (lambda: metrics.plane_errors([[0, 0, 1, 1]], [list("0011")]), TypeError, "truth as numbers, .* of <U1"),
        (lambda: CAMERA.project(["1", "2", "3"]), TypeError, "points as numbers, got an array of <U1"),
        (lambda: CAMERA.project([{}, 2, 3]), TypeError, "points as numbers, got {}"),
        (lambda: CAMERA.project([1, None, 3]), TypeError, "points as numbers, got None"),
        (
            lambda: uncertainty.angle_between(1j * np.ones((2, 4)), np.zeros((2, 4, 4)), np.ones(4), np.zeros((4, 4))),
            TypeError,
            "as numbers, got an array of complex128",
        ),
        (lambda: segmentation_export.to_dict(rp.segment(DEPTH, CAMERA), "a"), TypeError, "of PlanePolygon, got 'a'"),
        (lambda: segmentation_export.to_dict(rp.segment(DEPTH, CAMERA), (1, 2)), TypeError, r"got \(1, 2\)"),
        (lambda: segmentation_export.to_ros_polygons(3), TypeError, "of PlanePolygon, got 3"),
        (lambda: export.to_ros_points(DEPTH, CAMERA, stamp=None), TypeError, "stamp as a number, got None"),
        (lambda: export.to_ros_points(DEPTH, CAMERA, stamp={}), TypeError, "stamp as a number, got {}"),
        (lambda: export.to_ros_points(DEPTH, CAMERA, 1.5), TypeError, "frame_id as a str, got 1.5"),
        (lambda: rp.presets.realsense_d435(640, 480), ValueError, "got 640x480: Camera.from_realsense takes"),
        (lambda: rp.fit_tiles(DEPTH, CAMERA, significance="a"), TypeError, "significance as a number, got 'a'"),
        (lambda: rp.fit_tiles(DEPTH, CAMERA, num_threads=1.5), TypeError, "whole number, or None, got 1.5"),
        (lambda: rp.fit_tiles(DEPTH, CAMERA, num_threads=True), TypeError, "whole number, or None, got True"),
        (lambda: rp.normals(DEPTH, CAMERA, num_threads=1.5), TypeError, "whole number, or None, got 1.5"),
        (lambda: rp.TileFitter(CAMERA).fit(DEPTH, DEPTH), ValueError, "out must be a result of this fitter"),
        (lambda: rp.TileFitter(CAMERA).fit_batch(iter([DEPTH])), TypeError, "got list_iterator: fit_stream"),
        (lambda: rp.TileFitter(CAMERA).fit_batch({1, 2}), TypeError, "a sequence of frames, got set"),
        (lambda: rp.estimate_noise(iter([DEPTH]), CAMERA), TypeError, "sequence of frames, got list_iterator"),
        (lambda: rp.merge(rp.fit_tiles(DEPTH, CAMERA), DEPTH), ValueError, "tile_labels has those of tiles"),
        (lambda: rp.segment(DEPTH, CAMERA, min_size=np.nan), TypeError, "whole number of pixels, got nan"),
        (lambda: rp.segment(DEPTH, CAMERA, min_size=2), ValueError, "min_size must be at least 3, got 2"),
        (lambda: rp.segment(DEPTH, CAMERA, noise="kinect_v1"), TypeError, "a NoiseModel or None, got 'kinect_v1'"),
        (lambda: rp.segment(DEPTH, CAMERA, noise=True), TypeError, "number in 1/m, a function .* got True"),
        (lambda: rp.segment(DEPTH, CAMERA, noise=lambda q: -q), ValueError, r"inverse depths, got -[\d.]+ at [\d.]+ "),
        (lambda: rp.segment(DEPTH, CAMERA, noise=np.diff), ValueError, r"of shape \(33,\), got shape \(32,\)"),
        (lambda: rp.fit_sequence("recording", "out"), TypeError, "which open_sequence makes, got str"),
        (lambda: rp.FitSettings(segments=True, tile=8).check(CAMERA), ValueError, "options of tiles, got tile"),
        (lambda: rp.FitSettings(min_size=99).check(CAMERA), ValueError, "tiles take no options of segments, got min_"),
        (lambda: rp.FitSettings(segments=True, min_size=2), ValueError, "min_size must be at least 3, got 2"),
        (lambda: rp.FitSettings(segments=True, min_size=1e3), TypeError, "whole number of pixels, got 1000.0"),
        (lambda: rp.segment(DEPTH, CAMERA, min_size=10**30), ValueError, "min_size must be below 2"),
        (lambda: rp.segment_sequence([], CAMERA, memory=1.5), TypeError, "whole number of frames, got 1.5"),
        (lambda: rp.segment_sequence(None, CAMERA), TypeError, "expected frames, as an iterable, got NoneType"),
        (lambda: rp.TileFitter(CAMERA).fit_stream(None), TypeError, "frames, as an iterable, got NoneType"),
        (lambda: rp.TileFitter(CAMERA, num_threads=2).fit_stream(3), TypeError, "as an iterable, got int"),
        (lambda: rp.FitSettings(segments="no"), TypeError, "segments as True or False, got 'no'"),
        (lambda: rp.fit_sequence(FRAMES, "out", retry=1), TypeError, "retry as True or False, got 1"),
        (lambda: rp.warmup(CAMERA, segment="no"), TypeError, "segment as True or False, got 'no'"),
        (lambda: rp.warmup(CAMERA, None), ValueError, "method must be one of .*, got None"),
        (lambda: rp.warmup(CAMERA, dtypes="metres"), TypeError, "metres"),
        (lambda: rp.Camera.from_ros({}, rectified="no"), TypeError, "rectified as True or False, got 'no'"),
        (lambda: scenes.room().render(CAMERA).measure(quantise=0), TypeError, "quantise as True or False, got 0"),
        (lambda: sequences.FrameSequence([5], np.load), TypeError, r"FrameEntry\(...\), got int"),
        (lambda: sequences.FrameSequence([], "read"), TypeError, "read as a function of a location, got str"),
        (lambda: rp.segment(DEPTH, CAMERA, noise=Noise(np.nan)), ValueError, "noise.lateral as a finite number"),
        (lambda: rp.segment(DEPTH, CAMERA, noise=Noise(-3.0)), ValueError, "noise.lateral of 0 pixels or more, got -3"),
        (lambda: rp.segment(DEPTH, CAMERA, noise=Noise("a")), TypeError, "noise.lateral as a number, got 'a'"),
        (lambda: rp.segment(DEPTH, CAMERA, noise=1e80), ValueError, r"in 1/m, up to 1e\+60, got 1e\+80"),
        (lambda: CORRELATED.statistics(np.nan), ValueError, "count of 0 to 1e.08 pixels, got nan"),
        (lambda: CORRELATED.statistics(2**63), ValueError, "count of 0 to 1e.08 pixels, got 9.22"),
        (lambda: CORRELATED.statistics(None), TypeError, "count as numbers, got None"),
        (lambda: CORRELATED.statistics(10, [4, -4]), ValueError, r"size of 1 to 1e.08 pixels, got \[4.0, -4.0\]"),
        (lambda: CORRELATED.statistics(10, [4]), ValueError, r"size of shape \(..., 2\), got \(1,\)"),
        (lambda: noise.NoiseModel(samples=[(1 + 1j, 0.1)]), ValueError, "samples as pairs"),
        (
            lambda: uncertainty.same_plane([[1.0], [2.0, 3.0]], np.eye(3), np.ones(3), np.eye(3)),
            ValueError,
            "alpha as an array, got a list of which NumPy makes none",
        ),
        (lambda: rp.Camera.from_opencv(np.eye(3), None, [[1], [2, 3]]), ValueError, "size as an array, got a list"),
        (
            lambda: uncertainty.point_distance([[1.0, 2.0], [3.0]], np.ones(4), np.zeros((4, 4))),
            ValueError,
            "points as an array, got a list of which NumPy makes none",
        ),
        (
            lambda: metrics.plane_errors([[np.nan] * 4, [0, 0, 0, 1]], [[0, 0, 1, 1]] * 2),
            ValueError,
            r"in predicted, got \[0.0, 0.0, 0.0, 1.0\]",
        ),
        (lambda: rp.fit_windows(iter([DEPTH]), CAMERA, [(0, 0, 8, 8)]), TypeError, "got list_iterator: TileFitter.fit"),
        (lambda: rp.fit_windows(DEPTH, CAMERA, iter([(0, 0, 8, 8)])), TypeError, r"shape \(K, 4\), got list_iterator"),
        (lambda: rp.segment_quadtree(DEPTH, CAMERA, tile=32.0), TypeError, "whole number of pixels, got 32.0"),
        (lambda: rp.segment_quadtree(DEPTH, CAMERA, clusters="a"), TypeError, "clusters must be a whole number"),
        (lambda: rp.segment_quadtree(DEPTH, CAMERA, seed=-1), ValueError, "seed must be at least 0, got -1"),
        (lambda: rp.merge(DEPTH, DEPTH), TypeError, "expected the planes or surfaces of a fit, got ndarray"),
        (lambda: rp.plane_polygons(DEPTH), TypeError, "expected a Segmentation or LabelPlanes, got ndarray"),
        (lambda: rp.segment(DEPTH, CAMERA).tile_labels(0), ValueError, "at least 2 x 2 pixels, got 0"),
        (lambda: scenes.room().render(CAMERA).measure(holes="a"), TypeError, "holes as a number, got 'a'"),
        (lambda: rp.measurement_noise(DEPTH, CAMERA, "a"), TypeError, "sigma_inverse_depth as a number"),
        (lambda: noise.NoiseModel((-1e-3,)), ValueError, "got -0.001 at 0.0012207 1/m"),
        (lambda: rp.Camera.from_opencv(np.eye(3), None, 64), ValueError, "size as .width, height., got 64"),
        (lambda: metrics.compare_labels(LARGE, LARGE), ValueError, r"labels of 2\*\*63 or more, got 92233"),
        (lambda: metrics.compare_labels(DEPTH, None), TypeError, "truth must be integers, or a mask, got dtype object"),
        (lambda: metrics.compare_labels(DEPTH, DEPTH).hoover("0.8"), TypeError, "tolerance as a number, got '0.8'"),
        (lambda: metrics.compare_labels(DEPTH, DEPTH).detection(None), TypeError, "iou as a number, got None"),
        (lambda: rp.segment_quadtree(DEPTH, CAMERA, 128), ValueError, r"frame of .height, width. = .48, 64.*128"),
    ],
)  # fmt: skip
def test_arguments_that_cannot_be_are_refused(use, error, message):
    with pytest.raises(error, match=message):
        use()


@pytest.mark.parametrize("kind", [np.array, np.float32, Fraction, Decimal])
def test_numbers_of_other_kinds(kind):
    """They are used as the floats that they are checked as."""
    noisy = replace(CAMERA, noise=noise.kinect_v1())
    depth = scenes.plane((0.2, 0.1, -1.0), 1.5).render(noisy).measure(seed=1)
    scene = scenes.plane((0.0, 0.0, -1.0), kind(2.0)).render(CAMERA)
    assert (scene.depth == 2.0).all()
    measured = scene.measure(noise=kind(0.0), holes=kind(0.25), patches=kind(0.25), baseline=kind(0.0))
    assert np.array_equal(measured, scene.measure(noise=0.0, holes=0.25, patches=0.25, baseline=0.0))
    assert noise.stereo(kind(0.5), 64.0, kind(0.25)) == noise.stereo(0.5, 64.0, 0.25)
    sigma = rp.measurement_noise(DEPTH, CAMERA, kind(0.125))
    assert np.array_equal(sigma, rp.measurement_noise(DEPTH, CAMERA, 0.125))
    for options in ({"significance": 0.25}, {"max_missing": 0.25}, {"max_error": 0.25}):
        given = {name: kind(value) for name, value in options.items()}
        found = rp.fit_tiles(depth, noisy, 8, **given).status
        assert np.array_equal(found, rp.fit_tiles(depth, noisy, 8, **options).status)
        found = rp.fit_labels(depth, noisy, depth > 0, **given).status
        assert np.array_equal(found, rp.fit_labels(depth, noisy, depth > 0, **options).status)
    segmented = rp.segment(depth, CAMERA, noise=kind(0.0078125))
    assert np.array_equal(segmented.labels, rp.segment(depth, CAMERA, noise=0.0078125).labels)
    pytest.importorskip("shapely")
    (found,) = rp.plane_polygons(segmented, tolerance=kind(0.5), min_part=kind(20.0))
    (wanted,) = rp.plane_polygons(segmented, tolerance=0.5, min_part=20.0)
    assert found.image.equals(wanted.image)


def test_a_baseline_in_millimetres():
    with pytest.warns(UserWarning, match="in metres, but 55 m is longer than any sensor's: millimetres"):
        noise.stereo(55, 640)


def test_a_focal_length_in_millimetres():
    with pytest.warns(UserWarning, match="in pixels, but 1.93 is shorter than any sensor's: millimetres"):
        noise.stereo(0.055, 1.93)
    noise.stereo(0.055, 64.0)  # warnings are errors here


def test_a_depth_scale_in_place_of_a_step():
    with pytest.warns(UserWarning, match="in metres, but 1000 m is larger than any sensor's: .*, or the depth_scale"):
        noise.quantised(noise.kinect_v1(), 1000.0)
    noise.quantised(noise.kinect_v1(), 0.1)  # warnings are errors here
    noise.quantised(noise.kinect_v1(), replace(CAMERA, depth_scale=1.0))


def test_an_error_that_is_larger_than_any_float():
    unlimited = rp.fit_tiles(DEPTH, CAMERA, max_error=10**400)
    assert np.array_equal(unlimited.status, rp.fit_tiles(DEPTH, CAMERA).status)
    with pytest.raises(ValueError, match="positive length"):
        rp.fit_tiles(DEPTH, CAMERA, max_error=-(10**400))


@pytest.mark.filterwarnings("ignore:the noise that is given")
def test_p_values_of_the_largest_noise():
    """They are numbers: the square of a variance is one."""
    noisy = replace(CAMERA, noise=noise.NoiseModel((1e60,), correlation=((0.5, 2.0),), floor=2.0, falloff=50.0))
    tiles = rp.fit_tiles(DEPTH, noisy)
    assert (tiles.p_value == 1.0).all()
    for fits in (rp.merge(tiles, np.ones(tiles.shape, int)), rp.fit_labels(DEPTH, noisy, DEPTH > 0)):
        assert fits.p_value[0] > 0.999
    assert (rp.fit_windows(DEPTH, noisy, [[0, 0, 48, 48]]).p_value == 1.0).all()


def test_whole_numbers_of_numpy():
    """Those of 8 bits would overflow as soon as something is counted with them."""
    few, many = np.int8(2), np.uint8(16)
    fits = rp.fit_tiles(DEPTH, CAMERA, many, num_threads=few)
    np.testing.assert_array_equal(fits.planes, rp.fit_tiles(DEPTH, CAMERA, 16).planes)
    windows = np.repeat([[0, 0, 8, 8]], 300, axis=0)
    assert rp.fit_windows(DEPTH, CAMERA, windows, num_threads=few).fitted.all()
    found = rp.segment_quadtree(DEPTH, CAMERA, many, max_subdivisions=few)
    np.testing.assert_array_equal(found.labels, rp.segment_quadtree(DEPTH, CAMERA, 16).labels)
    for edges in (True, np.True_):
        normals = rp.normals(DEPTH, CAMERA, np.uint8(17), avoid_edges=edges, num_threads=few)
        np.testing.assert_array_equal(normals, rp.normals(DEPTH, CAMERA, 17, avoid_edges=True))


@pytest.mark.parametrize(
    ("name", "use"),
    [
        ("labels", lambda labels: rp.merge(rp.fit_tiles(DEPTH, CAMERA), labels[:3, :4])),
        ("predicted", lambda labels: metrics.compare_labels(labels, labels.data)),
        ("truth", lambda labels: metrics.compare_labels(labels.data, labels)),
        ("image", lambda labels: images.write_png("labels.png", labels)),
        ("windows", lambda windows: rp.fit_windows(DEPTH, CAMERA, windows[:, :4])),
        ("points", lambda points: CAMERA.project(points[:, :3])),
        ("predicted", lambda planes: metrics.plane_errors(planes[:, :4], planes.data[:, :4])),
        ("truth", lambda planes: metrics.plane_errors(planes.data[:, :4], planes[:, :4])),
        ("planes", lambda planes: rp.uncertainty.transform_planes(planes[:, :4], np.eye(4), np.eye(4))),
    ],
)
def test_masked_arrays_are_refused(use, name, tmp_path, monkeypatch):
    """The masked ones would count as if they were not."""
    monkeypatch.chdir(tmp_path)
    labels = np.ma.masked_equal(np.tile(np.array([1, 2], np.uint8), (64, 32)), 2)
    with pytest.raises(TypeError, match=rf"got a masked array: fill it first, {name}\.filled\(0\)"):
        use(labels)
    assert not any(tmp_path.iterdir())


def test_labels_that_count_something_else():
    """Each up to the largest would have a row, or int32 not hold them."""
    tiles = rp.fit_tiles(DEPTH, CAMERA)
    for label in (-1, DEPTH.size + 1, 200_000_000, 2**31, 2**32 + 1):
        hint = (
            "labels + 1 are, if -1 is none" if label == -1 else "np.unique(labels, return_inverse=True)[1] + 1 numbers"
        )
        message = re.escape(f"1 to K, got {label} to {label}: {hint}")
        with pytest.raises(ValueError, match=message):
            rp.merge(tiles, np.full(tiles.shape, label))
        with pytest.raises(ValueError, match=message):
            rp.fit_labels(DEPTH, CAMERA, np.full(CAMERA.shape, label))
    some = np.full(CAMERA.shape, 2**31)
    some[:2, :3] = 0
    with pytest.raises(ValueError, match=re.escape("np.unique(labels, return_inverse=True)[1] numbers others")):
        rp.fit_labels(DEPTH, CAMERA, some)
    # Of segments there may be more than tiles, and of windows that overlap more than pixels.
    assert rp.merge(tiles, np.full(tiles.shape, DEPTH.size)).fitted.tolist() == [False] * (DEPTH.size - 1) + [True]
    windows = rp.fit_windows(DEPTH, CAMERA, np.tile([0, 0, 8, 8], (DEPTH.size + 1, 1)))
    assert rp.merge(windows, np.arange(1, DEPTH.size + 2)).fitted.all()


def test_results_keep_what_was_asked():
    """Also when the caller goes on to change it."""
    windows = np.array([[0, 0, 8, 8], [8, 8, 16, 16]])
    fits = rp.fit_windows(DEPTH, CAMERA, windows)
    labels = np.ones(2, np.int32)
    merged = rp.merge(fits, labels)
    windows[:], labels[:] = 0, 0
    assert fits.windows.tolist() == [[0, 0, 8, 8], [8, 8, 16, 16]]
    assert merged.labels.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("made", "name", "value"),
    [
        (rp.TileFitter(CAMERA), "camera", replace(CAMERA, fx=60.0)),
        (rp.TileFitter(CAMERA), "tile", (8, 8)),
        (rp.TileFitter(CAMERA), "method", "standard_pca"),
        (rp.TileFitter(CAMERA), "implementation", "naive"),
        (rp.TileFitter(CAMERA), "max_error", 0.01),
        (pickle.loads(pickle.dumps(rp.TileFitter(CAMERA))), "tile", (8, 8)),
        (QuadtreeFitter(CAMERA), "max_error", 0.01),
        (pickle.loads(pickle.dumps(QuadtreeFitter(CAMERA))), "method", "standard_pca"),
        (rp.PlaneTracker(), "memory", 90),
    ],
)
def test_what_is_prepared_from_its_arguments_refuses_others(made, name, value):
    before = dict(vars(made))
    with pytest.raises(AttributeError, match=rf"change of a {type(made).__name__}, got {name} = .*: make a new one"):
        setattr(made, name, value)
    assert vars(made) == before


@pytest.mark.parametrize(
    "value", [np.True_, np.array(True), np.complex64(0.5), bytearray(b"0.5"), memoryview(b"0.5"), np.ma.masked]
)
def test_what_python_takes_for_a_number(value):
    with pytest.raises(TypeError, match="max_missing as a number"):
        rp.fit_tiles(DEPTH, CAMERA, max_missing=value)
    with pytest.raises(TypeError, match="expected fx as a number"):
        replace(CAMERA, fx=value)


@pytest.mark.parametrize("values", [np.ma.array([65535, 7], mask=[True, False]), np.array([7 + 1j]), b"77"])
def test_what_numpy_takes_for_numbers(values):
    with pytest.raises(TypeError, match=r"invalid_values|masked array"):
        replace(CAMERA, invalid_values=values)


@pytest.mark.parametrize("tile", [b"88", bytearray(b"88")])
def test_two_bytes_are_no_size_of_a_tile(tile):
    with pytest.raises(TypeError, match="tile must be a whole number of pixels or"):
        rp.fit_tiles(DEPTH, CAMERA, tile)


def test_faces_of_points_that_are_not_there(tmp_path):
    for faces in ([[0, 1, 3]], [[0, 1, -1]], [[0, 1]], [[0.0, 1.0, 2.0]], [[0] * 256]):
        with pytest.raises(ValueError, match="faces must be"):
            export.write_ply(tmp_path / "mesh.ply", np.eye(3), faces=faces)
    assert list(tmp_path.iterdir()) == []


def test_points_and_what_they_have_are_as_many(tmp_path):
    for arrays, message in (
        ({"points": np.zeros((3, 2))}, r"points of shape \(..., 3\), got \(3, 2\)"),
        ({"points": np.eye(3), "normals": np.eye(3)[:2]}, r"normals of shape \(..., 3\), 3 in all"),
        ({"points": np.eye(3), "colours": np.zeros((3, 4))}, r"colours of .* got \(3, 4\)"),
    ):
        with pytest.raises(ValueError, match=message):
            export.write_ply(tmp_path / "points.ply", **arrays)
    assert list(tmp_path.iterdir()) == []
    nowhere = np.where(np.eye(3) > 0, np.nan, 1.0)[:, [0, 0, 0]]
    export.write_ply(tmp_path / "points.ply", nowhere, colours=nowhere)
    assert b"element vertex 2" in (tmp_path / "points.ply").read_bytes()


def test_frames_need_a_camera():
    with pytest.raises(TypeError, match="expected a Camera, got str"):
        sequences.FrameSequence([sequences.FrameEntry("a", 0.0, "camera", 0)], np.zeros)
    with pytest.raises(TypeError, match="expected the name of a FrameEntry as a string, got 7"):
        sequences.FrameSequence([sequences.FrameEntry(7, 0.0, CAMERA, 0)], np.zeros)
    with pytest.raises(TypeError, match="expected the timestamp of a FrameEntry as a number, got None"):
        sequences.FrameSequence([sequences.FrameEntry("7", None, CAMERA, 0)], np.zeros)
    with pytest.raises(TypeError, match="expected frames, as an iterable, got int"):
        sequences.FrameSequence(5, np.zeros)
    for use in (rp.FitSettings().rows_of_frame, rp.FitSettings(segments=True).check):
        with pytest.raises(TypeError, match="expected a Camera, got str"):
            use("camera.json")
    with pytest.raises(TypeError, match="expected a sequence of frames, got dict"):
        rp.TileFitter(CAMERA).fit_batch({"a": DEPTH})
    with pytest.raises(ValueError, match="expected the scheduler's address as tcp://host:port, got 5"):
        rp.fit_sequence(FRAMES, "out", scheduler=5)
    with pytest.raises(TypeError, match="expected progress as a function of a Progress, got 3"):
        rp.fit_sequence(FRAMES, "out", progress=3)


@pytest.mark.parametrize("change", [{"fx": 61.0}, {"distortion": (0.1, 0.0, 0.0, 0.0, 0.0)}, {"depth_scale": 5000.0}])
def test_frames_of_another_camera_are_refused(change):
    """Where the caller gives one camera for all."""
    camera = replace(CAMERA, depth_scale=1000.0)
    depth = np.full(camera.shape, 1000, np.uint16)
    frame = sequences.Frame(depth, replace(camera, **change), 0.0, "7.png")
    message = "expected frames of the camera that is given, got 7.png, whose own camera"
    for use in (
        lambda frames: rp.TileFitter(camera).fit_batch(frames),
        lambda frames: list(rp.TileFitter(camera).fit_stream(frames)),
        lambda frames: rp.estimate_noise(frames, camera),
        lambda frames: next(rp.segment_sequence(frames, camera)),
    ):
        with pytest.raises(ValueError, match=message):
            use([frame])
    same = replace(frame, camera=replace(camera, noise=noise.kinect_v1(), depth_range=(0.2, 9.0)))
    assert rp.TileFitter(camera).fit_batch([same]).fitted.all()


def test_underflow_is_no_error_where_others_are():
    """As after np.seterr(all="raise"), in a process of its own: tables are made once."""
    code = """
import numpy as np, rgbd_planes as rp
camera = rp.Camera(320, 240, 280.0, 280.0, 159.5, 119.5, depth_scale=1000.0)
depth = rp.scenes.room().render(camera).measure(seed=1)
np.seterr(all="raise")
noise = rp.noise.NoiseModel((2e-3,), correlation=((0.3, 2.0),))
rp.fit_tiles(depth, camera.with_noise(noise)).p_value
print(len(rp.segment(depth, camera)) > 0, rp.estimate_noise([depth], camera).sigma(0.5) > 0.0)
"""
    assert printed_by(code, PYTHONWARNINGS="ignore").split() == ["True", "True"]


def test_scores_of_a_segmentation_are_told_apart():
    """Not compared array by array, of which the truth is ambiguous."""
    labels = np.ones(CAMERA.shape, int)
    first, second = metrics.compare_labels(labels, labels), metrics.compare_labels(labels, labels)
    for one, other in ((first, second), (first.hoover(), second.hoover()), (first.detection(), second.detection())):
        assert one == one
        assert one != other
        assert hash(one) != hash(other)


@pytest.mark.parametrize("maker", [noise.kinect_v1, noise.stereo, noise.time_of_flight])
@pytest.mark.parametrize(
    "use", [lambda maker: replace(CAMERA, noise=maker), lambda maker: rp.segment(DEPTH, CAMERA, noise=maker)]
)
def test_a_function_that_makes_a_noise_model_is_none(maker, use):
    with pytest.raises(TypeError, match=rf"got the function {maker.__name__}: {maker.__name__}\(\.\.\.\) makes one"):
        use(maker)
