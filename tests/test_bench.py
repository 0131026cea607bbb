"""The benchmark counts what it says it counts, and its report holds what it measured. No time is asserted."""

import json
from collections import Counter

import monte_carlo
import numpy as np
import pytest
from scipy import stats

import rgbd_planes as rp
from bench import (
    batch_throughput,
    first_call,
    limits,
    measured,
    methods,
    operations,
    readme,
    report,
    roofline,
    sequence,
    tracking,
    uncertainty_real,
)
from bench.__main__ import main
from rgbd_planes.kernels import summed_area


@pytest.fixture(scope="module")
def quick_run(tmp_path_factory):
    """The folder that a quick run wrote, on rendered frames, and what it measured."""
    folder = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sequence, "REAL_DATA", folder / "none")
        assert main(["--out", str(folder), "--quick"]) == 0
    return folder, json.loads((folder / "paper.json").read_text())


def test_numbers_count_and_compute():
    tally = Counter()
    a, b = (operations.Number(value, tally) for value in (3.0, 4.0))
    result = (1.0 + a * b - 2.0) / (8.0 / b) + (a - b) * 2.0 + a / operations.Unit(2.0)
    assert float(result) == (1 + 12 - 2) / 2 + -2 + 1.5
    assert tally == {"additions": 5, "multiplications": 2, "divisions": 2, "conversions": 1}
    assert a < b
    assert 3.0 <= a <= 3.0
    assert a == 3.0
    assert a != b


def test_counted_ratios_are_the_papers():
    """44N/20N, 39N/15N and 8NM²/4NM², from counts."""
    counts = operations.count_all()
    per_pixel = {
        (form, space): count.paper_convention for form, pair in counts.items() for space, count in pair.items()
    }
    assert per_pixel["implicit", "standard"] == 44
    assert per_pixel["implicit", "range"] == 20
    assert per_pixel["explicit", "standard"] == 39
    assert per_pixel["explicit", "range"] == 15
    assert counts["naive"]["standard"].arguments == 8
    assert counts["naive"]["range"].arguments == 4


def test_executed_operations():
    """Two additions a table and pixel; the products of the scatter matrix; one division either way."""
    standard = operations.count(summed_area.standard_tables, 9)
    assert (standard.additions, standard.multiplications) == (18, 8)
    assert (standard.divisions, standard.conversions) == (0, 1)
    in_range = operations.count(summed_area.range_tables, 3)
    assert (in_range.additions, in_range.multiplications) == (6, 2)
    assert (in_range.divisions, in_range.conversions) == (1, 0)


@pytest.mark.parametrize("disparity", [False, True])
@pytest.mark.parametrize("implementation", ["integral", "naive"])
@pytest.mark.parametrize("method", methods.TABLES)
def test_what_is_timed_is_the_librarys_fit(method, implementation, disparity):
    windows = methods.windows(20)
    fit = methods.Fit(method, windows, implementation, disparity)
    fit.frame()
    frame, camera = methods.sensor(disparity)
    expected = rp.fit_windows(frame.raw, camera, windows, method)
    assert expected.fitted.all()
    np.testing.assert_allclose(fit.arrays["planes"], expected.planes, rtol=0, atol=1e-6)


def test_sensor_is_the_papers():
    frame, camera = methods.sensor()
    assert frame.raw.shape == (480, 640)
    tiles = rp.fit_tiles(frame.raw, camera, 40)
    sigma = np.median(tiles.rmse)
    assert sigma == pytest.approx(1.425e-3, rel=0.05)
    disparity, disparity_camera = methods.sensor(disparity=True)
    again = rp.fit_tiles(disparity.raw, disparity_camera, 40)
    angles = np.degrees(np.arccos(np.clip((again.planes * tiles.planes)[..., :3].sum(-1), -1, 1)))
    assert np.median(angles) < 0.5


def test_report_holds_every_claim(quick_run):
    folder, result = quick_run
    text = (folder / "report.md").read_text()
    assert set(result["op_count"]) == {"implicit", "explicit", "naive"}
    for key, title, _ in report.CLAIMS:
        claim = result["time"][key]
        new, old = claim["seconds"]
        assert claim["measured"] == pytest.approx(100.0 * (new / old - 1.0))
        assert claim["ratio"] == pytest.approx(old / new)
        assert f"| {title} |" in text
    for name in report.FIGURES:
        assert f"({name}.png)" in text
        assert (folder / f"{name}.png").stat().st_size > 5000
    assert result["segmentation"]["source"] == "rendered frames of a furnished room"
    assert result["machine"]["quick"] is True


def test_noise_of_rendered_tiles_is_the_models(quick_run):
    """The way the residual is taken gives back the noise that was put in, at every depth."""
    bins = quick_run[1]["noise"]["sets"]["rendered"]
    assert len(bins) >= 4
    for row in bins:
        assert row["sigma"][1] == pytest.approx(1.425e-3, rel=0.1)


def test_readme_table_replaces_the_old_one(quick_run, tmp_path):
    folder, result = quick_run
    page = tmp_path / "README.md"
    page.write_text("# a\n\n<!-- bench:paper -->\nold\n<!-- /bench -->\n\nrest\n")
    arguments = [str(folder / "paper.json"), "--readme", str(page)]
    assert readme.main(arguments) == 0
    text = page.read_text()
    assert "old" not in text
    assert text.startswith("# a\n\n<!-- bench:paper -->\n| | paper | here |")
    assert text.endswith("<!-- /bench -->\n\nrest\n")
    ratio = result["time"]["sat_implicit"]["measured"]
    assert f"| −45 % | {ratio:+.0f} % |".replace("-", "−") in text
    readme.main(arguments)
    assert page.read_text() == text


def test_readme_without_markers_is_an_error():
    with pytest.raises(ValueError, match=r"expected one block .* found 0"):
        readme.with_table("nothing here", "table")


def test_the_page_is_what_was_measured():
    page, results = measured.PAGE.read_text(), json.loads(measured.RESULTS.read_text())
    assert measured.page_of(page, results) == page, "run python -m bench.measured --page"
    with_other = results | {"batch": results["batch"] | {"frames": 1}}
    assert measured.page_of(page, with_other) != page
    text = readme.README.read_text()
    assert measured.readme_of(text, results) == text, "run python -m bench.measured --page"


def test_what_every_section_measures_comes_to_the_page(tmp_path, monkeypatch):
    """Whatever kind of thing it returns; tables of times name the processor."""
    results = json.loads(measured.RESULTS.read_text())
    for name, section in measured.SECTIONS.items():
        monkeypatch.setattr(section, "measure", lambda name=name: json.loads(json.dumps(results[name])))
    monkeypatch.setattr(roofline, "figure", lambda result: None)
    monkeypatch.setattr(measured, "processor", lambda: "abacus")
    for name in ("PAGE", "README", "RESULTS"):
        file = getattr(measured, name)
        (tmp_path / file.name).write_text(file.read_text())
        monkeypatch.setattr(measured, name, tmp_path / file.name)
    assert measured.main([]) == 0
    kept = json.loads(measured.RESULTS.read_text())
    for name in measured.SECTIONS:
        assert kept[name] == (results[name] | {"processor": "abacus"} if name in measured.TIMED else results[name])
    assert measured.PAGE.read_text().count("Measured on abacus.") == len(measured.TIMED)
    assert measured.README.read_text().count("Measured on abacus.") == 1


def test_limits_of_the_machine_are_measured(tmp_path):
    result = roofline.measure(repeats=1)
    assert result["processor"]
    assert all(row["ns"] > 0.0 for row in result["rows"])
    shown = roofline.table(result)
    assert result["processor"] in shown
    assert f"`range_explicit` takes {result['rows'][2]['ns']:.2f} ns with tiles of 20" in shown
    roofline.figure(result, tmp_path / "roofline.png")
    assert (tmp_path / "roofline.png").stat().st_size > 5000


def test_shares_of_few_tiles_say_little():
    """None of 384 may be three in a thousand, none of 2000 may not; the interval is that of its definition."""
    wrong = uncertainty_real.wrong_beyond_chance
    assert not wrong(0.0, 384)
    assert wrong(0.0, 2000)
    assert not wrong(0.05, 300)
    assert wrong(0.05, 1162)
    low, high = uncertainty_real.interval(0.05, 300)
    k, n = np.arange(301), np.array([[low], [high]])
    at = stats.binom.pmf(k, 300, n)
    np.testing.assert_allclose([at[0, 15:].sum(), at[1, :16].sum()], 0.025, rtol=1e-6)


def test_few_angles_are_no_measurement(monkeypatch):
    """However many tiles there are: those of small parts, and those that are rejected, have no angle."""
    one = uncertainty_real.RealSet("a", rp.presets.kinect_v1(), [], [], [])
    monkeypatch.setattr(uncertainty_real, "real_sets", lambda: [one])
    monkeypatch.setattr(rp, "estimate_noise", lambda frames, camera: rp.noise.kinect_v1())
    for angles, expected in ((49, None), (50, 2.0)):
        result = uncertainty_real.RealResult(1000, angles, 0.01, 0.001, 0.3, angle=2.0, angle_of_all=1.5)
        monkeypatch.setattr(uncertainty_real, "real_result", lambda *given, made=result: made)
        for row in uncertainty_real.measure():
            assert (row["rejected"], row["angle"], row["own_angle"]) == (0.01, expected, expected)


def test_many_measurements_in_one_frame_are_of_the_same_pixels():
    one = monte_carlo.tile_camera(5, rp.noise.kinect_v1(), left=150, top=100)
    many = monte_carlo.repeat(one, 3)
    assert np.array_equal(many.tan_x, np.tile(one.tan_x, (3, 3)))
    assert np.array_equal(many.tan_y, np.tile(one.tan_y, (3, 3)))


def test_limits_of_uncertainties_are_those_that_the_page_states():
    masks = limits.masks()
    found = [limits.of_masks(mask) for mask in masks.values()]
    assert min(least for least, _ in found) == pytest.approx(0.87, abs=0.03)
    assert max(most for _, most in found) == pytest.approx(1.1, abs=0.05)
    assert limits.of_windows() == pytest.approx((0.6, 3.6), rel=0.1)
    assert limits.of_fisheyes(105.0)[0] == pytest.approx(7.0 / 8.0, rel=0.1)
    assert limits.of_fisheyes(70.0)[0] == pytest.approx(1.0 / 3.0, rel=0.1)
    assert limits.of_standard_methods(1.5, 2.4) == pytest.approx((0.75, 1.3), rel=0.1)
    assert limits.of_standard_methods(1.0, 9.0) == pytest.approx((1.0 / 16.0, 5.0), rel=0.1)
    for metres, explicit, pca in ((1.0, 1.4, 1.5), (2.0, 2.7, 3.3)):
        alpha = np.array([0.1, 0.05, 1.0]) / metres
        for method, expected in (("range_explicit", 1.0), ("standard_explicit", explicit), ("standard_pca", pca)):
            tiles = limits.tiles_of(limits._frame(rp.noise.kinect_v1()), alpha, 16, method)
            assert limits.squared_errors(tiles, alpha) == pytest.approx(expected, rel=0.1)
    assert [limits.of_cut_tiles(side) for side in (8, 32)] == pytest.approx([2.4, 4.6], rel=0.1)
    assert limits.of_lateral_errors(2)[0] == pytest.approx(0.45, rel=0.15)
    assert limits.of_lateral_errors(8)[1] == pytest.approx(0.013, abs=0.003)
    assert limits.of_neighbours(4) == pytest.approx((0.01, 0.08), rel=0.2)
    *_, tiles, _, _, _, _, last = limits.report(400)
    assert tiles.startswith("  tiles of 24 pixels, 60 % correlated over 2: ")
    assert last.startswith("  two tiles of 16 x 16, 320 pixels apart: ")


def test_rings_show_what_the_model_lacks(rng):
    """Of noise that grows off the axis: by the model all are alike, by one that does not know there is too much."""
    camera = rp.Camera(320, 240, 200.0, 200.0, 159.5, 119.5)
    noise = rp.noise.NoiseModel((1.4e-3,), falloff=4.0)
    q = 0.5 + 0.1 * camera.tan_x + 0.05 * camera.tan_y
    depth = 1.0 / (q + noise.sigma(q, camera.tan_x, camera.tan_y) * rng.standard_normal(q.shape))
    data = uncertainty_real.RealSet("a", camera, [], [depth], [np.ones(camera.shape, int)])
    for residual, rejected in uncertainty_real.real_result(data, noise, 8).rings:
        assert residual == pytest.approx(1.0, abs=0.02)
        assert rejected < 0.03
    plain = uncertainty_real.real_result(data, rp.noise.NoiseModel((1.4e-3,)), 8).rings
    assert 1.0 < plain[0][0] < plain[1][0] < plain[2][0]
    assert plain[2][1] > 0.3


def test_changes_of_ids_are_counted(monkeypatch):
    views = tracking.turning(8.0)[:4]
    row = tracking.changes(views)
    assert row["frames"] == 4
    assert row["seen"] > row["large"] > 30
    assert row["changed"] <= 2

    def with_new_ids(frames, camera):
        for i, tracked in enumerate(rp.segment_sequence(frames, camera)):
            yield rp.TrackedSegmentation(tracked.segmentation, tracked.ids + 1000 * np.int32(i))

    monkeypatch.setattr(tracking, "segment_sequence", with_new_ids)
    every = tracking.changes(views)
    assert every["changed"] == row["seen"] - row["surfaces"]


def test_a_batch_is_measured():
    pytest.importorskip("pyarrow")
    result = batch_throughput.measure(frames=64, rounds=1)
    assert result["throughput"]["fit_batch"] == [1.0, 1.0, 1.0]
    assert set(result["throughput"]) == {"fit_batch", "out", "memory", "long", "png", "bare"}
    assert result["work"]["memory"]["write"] + result["work"]["memory"]["fit"] > 0.5
    assert 30_000 < result["bytes_per_frame"] < 50_000
    assert "256 frames" in batch_throughput.table(result)


def test_a_batch_is_of_whole_calls():
    """Or the time of some frames would be that of more."""
    for frames in (100, 0):
        with pytest.raises(ValueError, match=f"expected frames in multiples of 64, got {frames}"):
            batch_throughput.measure(frames=frames, rounds=1)


def test_a_first_call_is_measured():
    result = first_call.measure(rounds=1, compiling=False)
    assert set(result) == {"numba", *first_call.CALLS}
    for name in first_call.CALLS:
        assert 0.0 < result[name]["import"][0] < result[name]["first call"][0]
    assert "1 processes each" in first_call.table(result)
