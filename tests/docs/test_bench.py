"""The benchmark counts what it says it counts, and its report holds what it measured. No time is asserted."""

import dataclasses
import json
from collections import Counter
from functools import partial

import numpy as np
import pytest
from scipy import stats

import rgbd_planes as rp
from bench import (
    batch_throughput,
    chi_square,
    curved_scenes,
    figures,
    first_call,
    fitting,
    limits,
    measured,
    methods,
    monte_carlo,
    operations,
    peers,
    plots,
    polyhedra,
    prior_kernels,
    prior_work,
    readme,
    real_sensors,
    report,
    roofline,
    segmentation,
    segmentation_stages,
    sequence,
    timing,
    tracking,
    uncertainty_real,
    uncertainty_simulation,
    user_tasks,
)
from bench.__main__ import main
from bench.floor import floor
from rgbd_planes.kernels.moments import summed_area
from rgbd_planes.kernels.statistics.distributions.chi_square import CORRECTION


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
    assert per_pixel["tang", "standard"] == 42
    assert per_pixel["erdogan", "standard"] == 14


def test_executed_operations():
    """Two additions a table and pixel; the products of the scatter matrix; one division either way."""
    standard = operations.count(summed_area.frame_tables, True, 9)
    assert (standard.additions, standard.multiplications) == (18, 8)
    assert (standard.divisions, standard.conversions) == (0, 1)
    in_range = operations.count(summed_area.frame_tables, None, 3)
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


@pytest.mark.parametrize("is_tang", [True, False])
def test_prior_work_fits_the_same_planes(is_tang):
    frame, camera = methods.sensor(not is_tang)
    tiles = rp.fit_tiles(frame.raw, camera, 40)
    row, column = np.indices(tiles.shape).reshape(2, -1) * 40
    fit = prior_work.PriorFit(np.column_stack([row, column, np.full((len(row), 2), 40)]), is_tang)
    fit.planes()
    # Tang's sums are of rounded terms about the origin; Erdogan's are whole numbers, and exact.
    atol = 1e-11 if is_tang else 1e-12
    np.testing.assert_allclose(fit.alpha(), tiles.alpha.reshape(-1, 3), rtol=0, atol=atol)


@pytest.mark.parametrize("kernel", [prior_kernels.tang_tables, prior_kernels.erdogan_tables])
def test_tables_of_prior_work_are_its_normal_equations(kernel):
    frame, camera = methods.sensor()
    q = np.where(frame.values.raw > 0, 1000.0 / np.maximum(frame.values.raw, 1), 0.0)
    there = frame.values.raw > 0
    u, v = camera.tan_x * there, camera.tan_y * there
    raw = frame.values.raw.astype(float)
    terms = (
        (u * u, u * v, u, v * v, v, u * q, v * q, q) if kernel is prior_kernels.tang_tables else (u * raw, v * raw, raw)
    )
    tables = np.empty((481, 641, len(terms)))
    kernel(frame.values, (camera.tan_x, camera.tan_y), None, tables)
    assert not tables[0].any()
    assert not tables[:, 0].any()
    for k, term in enumerate(terms):
        np.testing.assert_allclose(
            tables[1:, 1:, k], term.cumsum(0).cumsum(1), rtol=1e-9, atol=1e-9 * np.abs(term).sum()
        )


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
    assert set(result["op_count"]) == {"implicit", "explicit", "naive", "tang", "erdogan"}
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
    seconds, frames = (result["segmentation"][name] for name in ("seconds", "frames"))
    for form in ("implicit", "explicit"):  # of a flight of five minutes, 30 frames a second
        saved = (seconds[f"standard_{form}"] - seconds[f"range_{form}"]) / frames * 9000
        assert result["time"][f"flight_seconds_saved_{form}"]["measured"] == pytest.approx(saved)
    assert result["machine"]["quick"] is True


def test_noise_of_rendered_tiles_is_the_models(quick_run):
    """The way the residual is taken gives back the noise that was put in, at every depth."""
    bins = quick_run[1]["noise"]["sets"]["rendered"]
    assert len(bins) >= 4
    for row in bins:
        assert row["sigma"][1] == pytest.approx(1.425e-3, rel=0.1)


def test_the_papers_table_replaces_the_old_one(quick_run, tmp_path):
    folder, result = quick_run
    page = tmp_path / "README.md"
    page.write_text("# a\n\n<!-- bench:paper -->\nold\n<!-- /bench -->\n\nrest\n")
    arguments = [str(folder / "paper.json"), "--page", str(page)]
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


def test_the_pages_are_what_was_measured():
    results = json.loads(measured.RESULTS.read_text())
    with_other = results | {"batch": results["batch"] | {"frames": 1}}
    for page in {measured.page_of(name) for name in measured.SECTIONS}:
        text = (measured.DOCS / page).read_text()
        assert measured.text_of(page, text, results) == text, "run python -m bench.measured --page"
        assert (measured.text_of(page, text, with_other) != text) == (page == measured.page_of("batch"))
    text = readme.README.read_text()
    assert measured.readme_of(text, results) == text, "run python -m bench.measured --page"


def test_what_every_section_measures_comes_to_its_page(tmp_path, monkeypatch):
    """Whatever kind of thing it returns; tables of times name the processor."""
    results = json.loads(measured.RESULTS.read_text())
    for name, section in measured.SECTIONS.items():
        monkeypatch.setattr(section, "measure", lambda name=name: json.loads(json.dumps(results[name])))
    monkeypatch.setattr(roofline, "figure", lambda result: None)
    monkeypatch.setattr(measured, "processor", lambda: "abacus")
    pages = {measured.page_of(name) for name in measured.SECTIONS}
    for file in (*pages, "measured.json"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text((measured.DOCS / file).read_text())
    (tmp_path / "images").mkdir()
    (tmp_path / "README.md").write_text(measured.README.read_text())
    monkeypatch.setattr(measured, "DOCS", tmp_path)
    monkeypatch.setattr(measured, "RESULTS", tmp_path / "measured.json")
    monkeypatch.setattr(measured, "README", tmp_path / "README.md")
    assert measured.main([]) == 0
    kept = json.loads(measured.RESULTS.read_text())
    for name in measured.SECTIONS:
        assert kept[name] == (results[name] | {"processor": "abacus"} if name in measured.TIMED else results[name])
    assert sum((tmp_path / page).read_text().count("Measured on abacus.") for page in pages) == len(measured.TIMED)
    assert measured.README.read_text().count("Measured on abacus.") == 1
    assert {path.stem for path in (tmp_path / "images").iterdir()} == set(plots.PLOTS)


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

    def wrong(share: float, tiles: int) -> bool:
        return uncertainty_real.wrong_beyond_chance(*uncertainty_real.interval(share, tiles))

    assert not wrong(0.0, 384)
    assert wrong(0.0, 2000)
    assert not wrong(0.05, 300)
    assert wrong(0.05, 1162)
    low, high = uncertainty_real.interval(0.05, 300)
    k, n = np.arange(301), np.array([[low], [high]])
    at = stats.binom.pmf(k, 300, n)
    np.testing.assert_allclose([at[0, 15:].sum(), at[1, :16].sum()], 0.025, rtol=1e-6)


def test_images_that_differ_say_less_than_their_tiles(rng):
    """Of images whose shares differ, the interval holds the true share as often as it says; of like ones, and of none
    rejected, it is that of their tiles; a single one says nothing.
    """
    held = 0
    for _ in range(400):
        shares = rng.beta(2.0, 18.0, size=8)
        tiles = rng.integers(500, 1500, size=8)
        images = list(zip(tiles.tolist(), rng.binomial(tiles, shares).tolist(), strict=True))
        low, high = uncertainty_real.interval_of_images(images)
        held += low <= 0.1 <= high
    assert 0.89 < held / 400 < 0.99
    alike = uncertainty_real.interval_of_images([(500, 25)] * 4)
    assert alike == uncertainty_real.interval(0.05, 2000)
    assert uncertainty_real.interval_of_images([(1000, 0)] * 2) == uncertainty_real.interval(0.0, 2000)
    assert uncertainty_real.interval_of_images([(1000, 20)]) == (0.0, 1.0)


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
    assert limits.of_tiles(16) == pytest.approx((0.98, 1.02), abs=0.01)
    assert limits.of_holes() == pytest.approx((0.58, 3.5), rel=0.05)
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
    *_, tiles, _, long, _, _, _, _, last = limits.report(400)
    assert tiles.startswith("  tiles of 24 pixels, 60 % correlated over 2: ")
    assert long.startswith("  windows of 16 x 128, with a floor: ")
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


def test_tiles_near_the_border_of_a_plane_are_told_apart(rng):
    """Where noise grows towards the border of a labelled plane, that shows; elsewhere nothing does."""
    labels = np.ones((160, 240), np.int64)
    labels[:, 120:] = 2
    distance = uncertainty_real.from_border(labels)
    assert distance[80, [119, 120, 118, 100, 0]].tolist() == [1.0, 1.0, 2.0, 20.0, 120.0]
    assert np.isinf(uncertainty_real.from_border(np.ones((4, 5), np.int64))).all()
    camera = rp.Camera(240, 160, 200.0, 200.0, 119.5, 79.5)
    noise = rp.noise.NoiseModel((1.4e-3,))
    for more, low, high in ((1.0, 0.0, 0.05), (1.5, 0.5, 1.0)):
        error = noise.coefficients[0] * np.where(distance < 16.0, more, 1.0) * rng.standard_normal(labels.shape)
        data = uncertainty_real.RealSet("a", camera, [], [1.0 / (0.5 + error)], [labels])
        nearest, between, farther = uncertainty_real.real_result(data, noise, 8).borders
        assert low <= nearest <= high
        assert low <= between <= high
        assert farther < 0.03


def test_changes_of_ids_are_counted(monkeypatch):
    views = tracking.turning(8.0)[:4]
    row = tracking.changes(views)
    assert row["frames"] == 4
    assert row["seen"] > row["large"] > 30
    assert row["large_changed"] <= row["changed"] <= 2

    def with_new_ids(frames, camera):
        for i, tracked in enumerate(rp.segment_sequence(frames, camera)):
            yield rp.TrackedSegmentation(tracked.segmentation, tracked.ids + 1000 * np.int32(i))

    monkeypatch.setattr(tracking, "segment_sequence", with_new_ids)
    every = tracking.changes(views)
    assert every["changed"] == row["seen"] - row["surfaces"]
    assert 0 < every["large_changed"] < row["large"] < every["changed"]


def test_a_batch_is_measured():
    pytest.importorskip("pyarrow")
    result = batch_throughput.measure(frames=64, rounds=1)
    assert result["throughput"]["fit_batch"] == [1.0, 1.0, 1.0]
    assert set(result["throughput"]) == {"fit_batch", "out", "memory", "long", "png", "bare"}
    assert result["work"]["memory"]["write"] + result["work"]["memory"]["fit"] > 0.5
    assert 30_000 < result["bytes_per_frame"] < 50_000
    taken = result["milliseconds"]  # of one round, so that the median is what it took
    for which, quartiles in result["throughput"].items():
        assert quartiles == pytest.approx(3 * [taken["fit_batch"] / taken[which]])
    assert result["bare_share"] == pytest.approx(taken["bare"] / taken["fit_batch"] / result["threads"])
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


@pytest.mark.parametrize("flushed", [False, True])
def test_work_is_timed_once_a_round_after_two_runs_that_are_not(flushed):
    """Or after what flushes the caches."""
    calls = []
    work = {name: partial(calls.append, name) for name in ("a", "b")}
    times = timing.in_turns(work, 5, partial(calls.append, "before") if flushed else None)
    round_ = ["before", "a", "before", "b"] if flushed else [*"aaabbb"]
    assert calls == [*"ab", *(5 * round_)]
    assert all(taken.fastest <= taken.median for taken in times.values())


def test_times_of_parts_and_of_sums():
    whole = timing.Times(2.0, 3.0)
    assert whole.shared_by(4) == (0.5, 0.75)
    assert whole.plus(timing.Times(1.0, 0.5)) == (3.0, 3.5)
    assert timing.change(1.0, 4.0) == -75.0


def test_times_are_written_in_units_that_fit_them():
    written = {2.0: "2 s", 1.0: "1 s", 0.01234: "12.3 ms", 4.5e-5: "45 µs", 3e-8: "30 ns"}
    assert {seconds: report._duration(seconds) for seconds in written} == written
    assert [report._percent(value) for value in (-45.2, 15.0, None)] == ["−45 %", "+15 %", ""]


def test_the_papers_figure_shows_how_much_less_time_range_space_takes():
    seconds = {
        "standard_implicit_integral": [2.0, 4.0], "range_implicit_integral": [1.5, 1.0],
        "standard_explicit_integral": [1.0, 1.0], "range_explicit_integral": [0.5, 0.9],
    }  # fmt: skip
    series = {"runtime_comparison": {"planes": [1, 200], "seconds": seconds}}
    (panel,) = figures.integral_percent_faster_vs_iterations({"series": series}).axes
    shown = {line.get_label(): line.get_data() for line in panel.get_lines()}
    for form, expected in (("implicit", [25.0, 75.0]), ("explicit", [50.0, 10.0])):
        np.testing.assert_allclose(shown[form], ([1, 200], expected))


@pytest.mark.parametrize(
    ("form", "method"), [("pca", "standard_pca"), ("z", "standard_explicit"), ("1/z", "range_explicit")]
)
def test_what_fits_are_compared_with_gives_their_planes(form, method):
    """Of whole tiles, of which all is there that a plane needs."""
    camera = rp.Camera(90, 70, 80.0, 75.0, 44.0, 35.0, depth_scale=1000.0)
    depth = rp.scenes.room().render(camera).measure(holes=0.1, seed=1)
    found = fitting.numpy_fit(depth, camera, 20, form)()
    expected = rp.fit_tiles(depth, camera, 20, method).planes[:3, :4].reshape(-1, 4)
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_angles_are_those_to_the_true_planes():
    frame = fitting.case(160, 120, holes=0.0)
    labels = frame.labels.reshape(12, 10, 16, 10)
    truth = frame.planes[np.maximum(labels[:, 0, :, 0], 1) - 1].reshape(-1, 4)
    assert fitting.median_angle(truth, frame, 10) == pytest.approx(0.0, abs=1e-6)
    across = np.cross(truth[:, :3], [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    turned = np.cos(0.02) * truth[:, :3] + np.sin(0.02) * across
    assert fitting.median_angle(np.column_stack([turned, truth[:, 3]]), frame, 10) == pytest.approx(np.degrees(0.02))


def test_tiles_of_a_labelled_plane_are_compared_with_all_of_it(tmp_path):
    """Those that lie wholly inside; of planes that are large enough."""
    camera = rp.Camera(80, 60, 65.0, 65.0, 39.5, 29.5, depth_scale=10_000.0)
    camera.save(tmp_path / "camera.json")
    q = 0.4 + 0.1 * camera.tan_x + 0.2 * camera.tan_y
    labels = np.ones(camera.shape, np.uint8)
    labels[:, 45:] = 2
    labels[50:, :15] = 3  # 150 pixels
    labels[:5] = 0
    depth = np.rint(10_000.0 / np.where(labels == 2, q + 0.3 * camera.tan_x, q)).astype(np.uint16)
    for name, image in (("depth", depth), ("labels", labels)):
        (tmp_path / name).mkdir()
        rp.images.write_png(tmp_path / name / "0.png", image)
    found = real_sensors.angles(tmp_path, 10)
    assert [part.shape for part in found] == [(4 * 5 - 2, 3), (3 * 5, 3)]
    assert np.concatenate(found).max() < 0.1


def test_angles_to_a_labelled_plane_are_in_degrees(tmp_path):
    """Of tiles on both sides of a fold that has one label, to the plane between them."""
    camera = rp.Camera(80, 60, 65.0, 65.0, 39.5, 29.5, depth_scale=10_000.0)
    camera.save(tmp_path / "camera.json")
    depth = np.rint(10_000.0 / (0.4 + 0.2 * np.abs(camera.tan_x + 0.0 * camera.tan_y))).astype(np.uint16)
    for name, image in (("depth", depth), ("labels", np.ones(camera.shape, np.uint8))):
        (tmp_path / name).mkdir()
        rp.images.write_png(tmp_path / name / "0.png", image)
    (found,) = real_sensors.angles(tmp_path, 10)
    np.testing.assert_allclose(found[:, 0], np.degrees(np.arctan2(0.2, 0.4)), atol=0.1)


def test_moved_frames_see_the_same_points():
    camera = rp.Camera(12, 9, 10.0, 11.0, 5.0, 4.5, depth_scale=1000.0)
    rng = np.random.default_rng(1)
    depth = rng.integers(500, 5000, camera.shape).astype(np.uint16)
    frame = segmentation.Frame("a", depth, camera, rng.integers(0, 9, camera.shape).astype(np.int32))

    def points(x, y, one):
        return set(zip(*(a.ravel().tolist() for a in (x.round(9), y.round(9), one.depth, one.truth)), strict=True))

    whole, found = points(camera.tan_x, camera.tan_y, frame), list(segmentation.moved([frame]))
    assert len(found) == 12
    for i, one in enumerate(found):
        x, y = one.camera.tan_x, one.camera.tan_y
        seen = points(*((x, y), (-x, y), (y, x))[i % 3], one)
        assert seen <= whole
        assert len(seen) == one.depth.size == (12 - i // 3) * (9 - i // 3)


def scores(regions, correct, noise=0.0):
    zeros = dict.fromkeys((field.name for field in dataclasses.fields(segmentation.Scores)), 0.0)
    counts = {"regions": regions, "correct_80": correct, "correct_90": correct / 2, "noise": noise}
    return segmentation.Scores(**zeros | counts)


def test_shares_are_of_all_regions():
    """However many of them a frame has; the other scores are means of frames."""
    row = segmentation.summary("a", [scores(10, 9.0, 1.0), scores(30, 15.0, 2.0)])
    assert (row["frames"], row["regions"], row["noise"]) == (2, 20.0, 1.5)
    assert (row["correct_80"], row["correct_90"]) == (24 / 40, 12 / 40)


def test_settings_are_chosen_on_other_frames_than_they_are_scored_on(monkeypatch, capsys):
    """Of eight frames each is best by a setting that is useless for the others."""
    camera = rp.Camera(8, 8, 8.0, 8.0, 3.5, 3.5, depth_scale=1000.0)
    frame = segmentation.Frame("a", np.ones((8, 8), np.uint16), camera, np.ones((8, 8), np.int32))
    frames = [dataclasses.replace(frame, name=str(i)) for i in range(8)]
    settings = [segmentation.Rules(bend_deviations=float(i)) for i in range(9)]
    monkeypatch.setattr(segmentation, "SETTINGS", settings)
    monkeypatch.setattr(segmentation, "PARTITIONS", 20)

    def by_rules(of, rules):
        own, for_all = float(of.name) == rules.bend_deviations, rules.bend_deviations == 8.0
        return scores(10, 10.0 if own else 6.0 if for_all else 0.0)

    monkeypatch.setattr(segmentation, "_by_rules", by_rules)
    assert [row.correct_80 for row in segmentation.cross_validate(frames)] == pytest.approx([6.0] * 8)
    assert "60.0% to 60.0%" in capsys.readouterr().out


def test_a_peer_is_scored_by_its_best_setting():
    truth = np.ones((20, 20), np.int32)
    truth[:, 10:] = 2
    frame = segmentation.Frame("a", np.ones((20, 20)), methods.sensor()[1], truth)
    ways = [lambda of: np.ones_like(of.truth), lambda of: of.truth, lambda of: 0 * of.truth]
    (row,) = segmentation.best_of(ways, [frame])
    assert (row.correct_80, row.correct_90, row.missed) == (2, 2, 0)


@pytest.mark.parametrize("sharing", [False, True])
def test_the_floor_is_the_sums_of_all_tiles(sharing, rng):
    raw = rng.integers(500, 5000, (12, 18)).astype(np.uint16)
    tan_x, tan_y = rng.normal(size=18), rng.normal(size=12)
    tiles = np.full((4, 2, 3), np.nan)
    floor(raw, tan_x, tan_y, 6, sharing, np.empty((3, 18)), tiles)
    q = 1.0 / raw
    sums = [of.reshape(2, 6, 3, 6).sum(axis=(1, 3)) for of in (q, q * tan_x, q * tan_y[:, None], q * q)]
    np.testing.assert_allclose(tiles, sums, rtol=1e-12)


def test_a_batch_of_the_floor_is_all_its_frames(monkeypatch):
    seen = []
    monkeypatch.setattr(peers, "floor", lambda frame, *rest: seen.append(int(frame)))
    peers.floor_of_batch(np.arange(7), 3)()
    assert sorted(seen) == list(range(7))


def test_ratios_to_peers_are_of_times_beside_them(monkeypatch):
    """Of what takes twice the time of the baseline, and half of that of the floor; and of half the time by threads."""
    seconds = {peers.BASE: 2e-3, peers.FLOOR: 8e-3, "a": 4e-3}
    monkeypatch.setattr(peers, "systems", lambda frame, tile: (dict.fromkeys(seconds), {"a": 0.5}))
    monkeypatch.setattr(peers, "take_turns", lambda functions, repeats: {n: np.full(4, seconds[n]) for n in functions})
    *_, row = peers.compare(fitting.case(160, 120), 10, 4)
    assert (row["tile"], row["system"], row["median_deg"]) == (10, "a", 0.5)
    assert [row["median_ms"], row["fastest_ms"]] == pytest.approx([4.0, 4.0])
    for name, expected in (("of_baseline", 2.0), ("faster_than_baseline", 0.5), ("of_floor", 0.5)):
        assert row[name] == pytest.approx([expected] * 3)
    monkeypatch.setattr(peers, "take_turns", lambda functions, repeats: {n: np.full(4, 1e-3) for n in functions})
    assert dict(peers.scaling(True)["size"])["640x480"] == pytest.approx(1e6 / (640 * 480))
    monkeypatch.setattr(peers.of_normals, "OPENCV", False)
    halved = {"0": np.full(4, 2e-3), "1": np.full(4, 1e-3)}
    monkeypatch.setattr(peers, "take_turns", lambda functions, repeats: {n: halved[n[-1]] for n in functions})
    for row in peers.with_all_threads(fitting.case(160, 120), 10, 4):
        assert row["speedup"] == pytest.approx([2.0] * 3)


def test_simulated_planes_err_as_predicted(monkeypatch):
    """By the fit in 1/Z, whose errors are those of the bound; the others' are larger."""
    names = {"TILES": (10,), "DEPTHS": (1.0,), "INCIDENCES": (0, 60), "HOLES": (0.0, 0.3)}
    for name, values in names.items():
        monkeypatch.setattr(uncertainty_simulation, name, values)
    cells = uncertainty_simulation.simulate(1600)
    assert [(c.method, c.incidence, c.holes) for c in cells] == [
        (method, incidence, holes)
        for incidence in (0, 60)
        for holes in (0.0, 0.3)
        for method in uncertainty_simulation.METHODS
    ]
    for cell in cells:
        assert (cell.depth, cell.tile, cell.runs) == (1.0, 10, 1600)
        one = monte_carlo.tile_camera(10, None, left=150, top=100)
        rays = np.stack([one.tan_x, one.tan_y, np.ones(one.shape)], axis=-1).reshape(-1, 3)
        alpha = monte_carlo.plane_through_middle(one, 1.0, cell.incidence)
        covariance = 1.425e-3**2 * np.linalg.inv(rays.T @ rays)
        normal = alpha / np.linalg.norm(alpha)
        tilt = np.trace(covariance) - normal @ covariance @ normal
        expected = np.degrees(np.sqrt(tilt) / np.linalg.norm(alpha))
        assert cell.predicted_degrees == pytest.approx(expected / np.sqrt(1.0 - cell.holes), rel=0.1)
        if cell.method == "range_explicit":
            assert [cell.angle_ratio, cell.offset_ratio, cell.angle_plain] == pytest.approx([1.0] * 3, abs=0.06)
            assert cell.nees == pytest.approx(1.0, abs=0.1)
            assert cell.nees_error == pytest.approx((cell.nees - 1.0) * 3.0 / np.sqrt(6.0 / 1600))
            assert cell.chi_square == pytest.approx(1.0, abs=0.03)
            freedom = 97 if cell.holes == 0.0 else round(100 * 0.7) - 3
            assert cell.chi_square_error == pytest.approx(
                (cell.chi_square - 1.0) * np.sqrt(1600 * freedom / 2), rel=0.1
            )
            assert cell.efficiency == pytest.approx(0.97, abs=0.06)
            assert cell.bias < 4.0
            assert cell.offset_short == pytest.approx(cell.offset_short_expected, abs=0.1)
    steep = {cell.method: cell for cell in cells if cell.incidence == 60 and cell.holes == 0.0}
    assert steep["standard_explicit"].efficiency < 0.9
    assert steep["standard_pca"].bias > steep["range_explicit"].bias


def test_the_report_of_simulations_sums_up_its_cells():
    cells = [
        uncertainty_simulation.Cell(
            *(method, incidence, 1.0, 10, 0.0),
            runs=400 + incidence,
            predicted_degrees=degrees,
            bias=1.0 if incidence < 45 else 9.0,
            angle_ratio=1.5 if degrees > 10.0 else 1.01,
            offset_ratio=0.99,
            nees=1.1,
            nees_error=1.0 if incidence == 0 else -3.0,
            chi_square=1.2,
            chi_square_error=2.0,
            efficiency=1.0 - 0.01 * incidence,
            angle_plain=degrees,
            offset_plain=(1.0 if incidence >= 30 else 2.0) + 0.001 * incidence,
            offset_short=3.0 if incidence >= 30 else 4.0,
            offset_short_expected=5.0 if incidence >= 30 else 6.0,
        )
        for degrees in (0.1, 0.5, 2.0, 5.0, 20.0)
        for incidence in uncertainty_simulation.INCIDENCES
        for method in uncertainty_simulation.METHODS
    ]
    lines = uncertainty_simulation.simulation_report(cells)
    assert lines[2].startswith("30 planes: ")
    assert "400 measurements of each or more" in lines[2]
    for method in uncertainty_simulation.METHODS:
        shares = "50.0 % | 1.01–1.5 | 0.99–0.99 | 80.0 % | 1.1–1.1 | 16.7 % | 1.2–1.2 | 100.0 %"
        assert f"| {method} | {shares} | 0.625 (0.25) |" in lines
        by_incidence = "1.000 | 0.850 | 0.700 | 0.550 | 0.400 | 0.250"
        assert f"| {method} | {by_incidence} | 0.625 | 0.625 | 0.625 |" in lines
    assert lines[-6:-1] == [
        f"| {name} | 6 | {degrees}–{degrees} | 1.030–1.075 | 2.000–2.015 | 3.000–3.000 | 5.000–5.000 | 4.000–4.000 "
        "| 6.000–6.000 |"
        for name, degrees in (
            ("0–0.3°", "0.100"), ("0.3–1°", "0.500"), ("1–3°", "2.000"), ("3–10°", "5.000"), ("above 10°", "20.000"),
        )
    ]  # fmt: skip


def test_errors_of_many_measurements_are_summed_up(rng):
    """Of estimates drawn with the covariance that they should have, and of ones that are off."""
    cell_of = uncertainty_simulation._cell
    alpha, bound, runs = np.array([0.1, -0.2, 0.5]), np.diag([4e-4, 1e-4, 1e-6]), 20_000
    errors = rng.standard_normal((runs, 3)) * np.sqrt(np.diag(bound))

    def cell(scale, shift):
        found = alpha + scale * errors + shift
        d = 1.0 / np.linalg.norm(found, axis=1)
        freedom = 13
        square = rng.chisquare(freedom, runs) * rp.noise.KINECT_V1**2
        fits = {
            "alpha": found,
            "alpha_covariance": np.broadcast_to(bound, (runs, 3, 3)),
            "planes": np.column_stack([-found * d[:, None], d]),
            "rmse_metric": np.sqrt(square / 16) * d / 0.4,
            "mean_q": np.full(runs, 0.4),
            "angle_std": np.ones(runs),
            "offset_std": np.ones(runs),
        }
        return cell_of(("range_explicit", 0, 1.0, 4, 0.0), fits, alpha, bound, 16)

    def short(scale, shift):
        """How much too small d is: what the estimates are, and to second order of the covariance."""
        d, found = 1.0 / np.linalg.norm(alpha), 1.0 / np.linalg.norm(alpha + scale * errors + shift, axis=1)
        along = d**4 * (d * alpha) @ bound @ (d * alpha)
        tilt = d**2 * (np.trace(bound) - (d * alpha) @ bound @ (d * alpha))
        return [(d - found.mean()) / found.std(), (0.5 * d * tilt - along / d) / found.std()]

    right, wide, off = cell(1.0, 0.0), cell(2.0, 0.0), cell(1.0, 0.02 * alpha)
    assert [right.angle_ratio, right.offset_ratio, right.nees, right.chi_square] == pytest.approx([1.0] * 4, abs=0.03)
    for made, given in ((right, (1.0, 0.0)), (wide, (2.0, 0.0))):
        assert [made.offset_short, made.offset_short_expected] == pytest.approx(short(*given), rel=1e-6)
    assert right.offset_short == pytest.approx(right.offset_short_expected, abs=0.02)
    assert right.efficiency == pytest.approx(1.0, abs=0.05)
    assert max(right.bias, abs(right.nees_error), abs(right.chi_square_error)) < 4.0
    assert [wide.angle_ratio, wide.offset_ratio, wide.nees] == pytest.approx([2.0, 2.0, 4.0], rel=0.05)
    assert wide.efficiency == pytest.approx(0.25, abs=0.02)
    assert wide.nees_error == pytest.approx(9.0 / np.sqrt(6.0 / runs), rel=0.1)
    assert off.bias > 10.0
    assert off.angle_ratio == pytest.approx(1.0, abs=0.03)
    assert off.efficiency < right.efficiency


def test_constants_of_chi_square_are_made_again(capsys):
    chi_square.main()
    *rows, one, two, five, more = capsys.readouterr().out.splitlines()
    made = np.array([[float(value) for value in row.strip(" (),").split(",")] for row in rows])
    np.testing.assert_allclose(made, CORRECTION, rtol=0.02, atol=1e-8)
    errors = [float(line.rpartition(": ")[2]) for line in (one, two, five, more)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 2e-5


def test_samples_of_chi_square_are_deviates_of_its_tail():
    a, z, eta, c = chi_square.samples(12, 16)
    ratio = special_ratio(eta)
    np.testing.assert_allclose(eta * np.sqrt(a) + c / np.sqrt(a), z, atol=1e-9)
    usual = (abs(z) < 5.0) & (abs(eta) > 1e-3)
    tail = stats.chi2.logsf(2.0 * a * ratio, 2.0 * a)
    np.testing.assert_allclose(tail[usual], stats.norm.logsf(z)[usual], rtol=1e-4, atol=1e-6)
    a_far, eta_far, c_far = chi_square.beyond()
    tail = stats.chi2.logsf(2.0 * a_far * special_ratio(eta_far), 2.0 * a_far)
    by_it = stats.norm.logsf(eta_far * np.sqrt(a_far) + c_far / np.sqrt(a_far))
    seen = np.isfinite(tail) & (eta_far > 0.0) & (tail > -600.0)
    assert seen.sum() > 100
    np.testing.assert_allclose(by_it[seen], tail[seen], rtol=0.01)


def special_ratio(eta):
    """λ, whose λ - 1 - ln λ is η²/2, on the side of 1 that η has the sign of."""
    low, high = np.where(eta > 0.0, 1.0, 0.0), np.where(eta > 0.0, 200.0, 1.0)
    for _ in range(200):
        middle = 0.5 * (low + high)
        with np.errstate(divide="ignore"):
            value = middle - 1.0 - np.log(middle)
        beyond = (value > 0.5 * eta**2) == (eta > 0.0)
        low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
    return 0.5 * (low + high)


def test_sensors_of_curved_scenes_err_as_they_say():
    depth = np.full((480, 640), 2.0)
    expected = {"kinect": (5.7, 0.03), "stereo": (5.3, 0.03), "time_of_flight": (4.0, 0.01), "scanner": (1.3, 0.0)}
    for sensor, camera in curved_scenes.SENSORS:
        raw = sensor(depth, 1)
        seen = raw[raw > 0] / camera.depth_scale
        if sensor is curved_scenes.perfect:
            assert (raw == 10_000).all()
            continue
        millimetres, missing = expected[sensor.__name__]
        assert np.mean(raw == 0) == pytest.approx(missing, abs=0.002)
        assert 1e3 * seen.std() == pytest.approx(millimetres, rel=0.06)
        assert seen.mean() == pytest.approx(2.0, abs=0.004)
    assert (curved_scenes.scanner(depth, 1) % 2 == 0).all()
    for rendering in (make().render(curved_scenes.SENSORS[0][1]) for make in curved_scenes.SCENES):
        assert (rendering.curved_labels > 0).mean() > 0.05
        assert np.isfinite(rendering.depth).all()


def test_facets_that_stand_for_something_round_are_no_faces():
    rendering = curved_scenes.solids(1.5, 0.3).render(rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5))
    flat = curved_scenes.flat_labels(rendering)
    is_mesh = np.array([False, *(name.startswith(curved_scenes.MESH) for name in rendering.names)])[rendering.labels]
    assert 200 < np.count_nonzero(is_mesh) < 2000
    np.testing.assert_array_equal(flat, np.where(is_mesh, 0, rendering.labels))


def test_faces_that_are_found_are_counted():
    truth = np.ones((60, 60), np.int32)
    truth[10:30, 10:30], truth[10:30, 40:58], truth[40:50, 10:20], truth[40:58, 40:58] = 2, 3, 4, 0
    labels = truth.copy()
    labels[10:30, 40:45], labels[41:58, 41:58] = 0, 5  # a quarter of a face is missing; a plane where none is
    assert polyhedra.faces_found(labels, truth) == (1, 2, 2)


def test_intervals_of_ratios_are_those_of_other_parts(rng):
    """Parts that are alike leave little doubt; of parts that differ, as many others would too."""
    alike = [np.tile([0.5, 1.0, 9.0], (30, 1)) for _ in range(10)]
    assert real_sensors._interval(alike, rng) == [2.0, 2.0]
    parts = [np.tile([1.0, ratio, 9.0], (30, 1)) for ratio in np.linspace(1.0, 2.0, 41)]
    low, high = real_sensors._interval(parts, rng)
    assert 1.2 < low < 1.4
    assert 1.6 < high < 1.8


def test_medians_over_all_parts_come_to_the_table(monkeypatch):
    parts = [np.array([[1.0, 2.0, 3.0]] * 3), np.empty((0, 3)), np.array([[2.0, 6.0, 8.0]] * 2)]
    monkeypatch.setattr(real_sensors, "needed", lambda sets: None)
    monkeypatch.setattr(real_sensors, "angles", lambda folder, tile: [part * tile / 10 for part in parts])
    rows = real_sensors.measure()
    assert [(row["data"], row["tile"]) for row in rows] == [(n, t) for n in real_sensors.SETS for t in (10, 20)]
    for row in rows:
        scale = row["tile"] / 10
        assert [row[method] / scale for method in real_sensors.METHODS] == [1.0, 2.0, 3.0]
        ratio, low, high = row["ratio"]
        assert (row["tiles"], ratio, low, high) == (5, 2.0, 2.0, 3.0)
    name = real_sensors.SETS[rows[1]["data"]]
    assert f"| {name} | 20 | 5 | 2.00° | 4.00° | 6.00° | 2.00 (2.00–3.00) |" in real_sensors.table(rows)


def test_answers_of_libraries_are_compared_with_the_truth():
    camera = rp.Camera(80, 60, 65.0, 65.0, 39.5, 29.5, depth_scale=1000.0)
    rendering = rp.scenes.room().render(camera)
    labels = rendering.labels.copy()
    labels[:, :20] = 0
    planes = rendering.planes[np.maximum(labels, 1) - 1]
    assert user_tasks.angles(planes, labels, rendering, "pixels") == "0.0°"
    assert user_tasks.angles(-planes, labels, rendering, "pixels") == "0.0°"  # whichever way they point
    across = np.cross(planes[..., :3], [0.1, 0.2, 1.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    turned = np.cos(0.05) * planes[..., :3] + np.sin(0.05) * across
    turned[:30] = np.nan
    share = np.count_nonzero(labels[30:]) / np.count_nonzero(labels)
    assert user_tasks.angles(turned, labels, rendering, "pixels") == f"2.9° of {share:.0%} of the pixels"


def test_planes_are_found_if_most_of_them_has_a_label_of_its_own():
    truth = np.zeros((100, 100), np.int32)
    truth[:40], truth[40:80], truth[80:] = 1, 2, 3
    truth[90:, :90] = 0
    truth[92:, :60] = 4  # too few pixels
    rendering = type("Rendered", (), {"labels": truth})
    assert user_tasks.found(truth, rendering) == "3 of 3 planes"
    assert user_tasks.found(0 * truth, rendering) == "0 of 3 planes"
    joined, part = np.where(truth == 2, 1, truth), truth.copy()
    assert user_tasks.found(joined, rendering) == "1 of 3 planes"
    part[:7] = 0
    assert user_tasks.found(part, rendering) == "3 of 3 planes"
    part[:9] = 0
    assert user_tasks.found(part, rendering) == "2 of 3 planes"


def one_line_beside_tiles(depth, camera):
    """As the lines of a task are counted."""

    return user_tasks.tiles_opencv(depth, camera)


PCL_TASKS = """
Cloud cloud_of(Frame frame)
{
  one();

  if (frame)
  {
    two();
  }
}

void normals(Cloud cloud)
{
  a();
  b();
}

std::vector<int> tiles(Frame frame)
{
  c();
}

void segments(Frame frame)
{
  normals(cloud);
}
"""


def test_lines_of_tasks_are_counted(tmp_path, monkeypatch):
    """Without that of their name, and empty ones, but with those of what they call."""
    assert user_tasks.lines(user_tasks.segments_ours) == 2
    assert user_tasks.lines(one_line_beside_tiles) == 2 + user_tasks.lines(user_tasks.tiles_opencv) > 10
    (tmp_path / "tasks.cpp").write_text(PCL_TASKS)
    monkeypatch.setattr(user_tasks, "PCL", tmp_path / "tasks.cpp")
    counted = {task: user_tasks.PclTask(tmp_path, task).lines for task in ("tiles", "normals", "segments")}
    assert counted == {"tiles": 1 + 3, "normals": 2 + 3, "segments": 1 + 2 + 3}


def test_ratios_of_times_have_two_digits_or_all_before_the_point():
    shown = {0.1234: "0.12", 9.64: "9.6", 45.6: "46", 99.7: "100", 250.4: "250"}
    assert {ratio: user_tasks._times(ratio) for ratio in shown} == shown


def test_every_stage_of_the_segmentation_can_be_seen():
    camera = rp.Camera(160, 120, 131.0, 131.0, 79.5, 59.5, depth_scale=1000.0)
    stages, found = segmentation_stages.stages(rp.scenes.room().render(camera).measure(holes=0.05), camera)
    assert set(segmentation_stages.STAGES) - {"depth", "curved"} <= set(stages)
    assert all(labels.shape == camera.shape for labels in stages.values())
    owned = stages["assigned"] > 0
    assert owned.mean() > 0.9
    assert owned[found.labels > 0].mean() > 0.99  # but strays
