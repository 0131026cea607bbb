"""From paper.json to what people read: the report, and the table of docs/measured/paper.md."""

from typing import Any

from bench.figures import FIGURES

Result = dict[str, Any]

# Key in "time", what is claimed, and why ours may differ from the paper's.
CLAIMS: tuple[tuple[str, str, str], ...] = (
    (
        "sat_implicit",
        "Build the summed-area tables, implicit: 4 in range space for 9",
        "Presumably the paper's MATLAB computes one table after the other; here one pass fills all of a method's "
        "tables, so a pixel is read and divided once, and what is left is nearly the tables themselves: 9 "
        "to 4.",
    ),
    ("sat_explicit", "Build the summed-area tables, explicit: 3 in range space for 8", "As above: 8 tables to 3."),
    (
        "sat_implicit_cold",
        "The same, implicit, nothing in the caches",
        "Not in the paper. Reading the frame and the rays from memory costs both methods the same, so the "
        "ratio is smaller than in a stream of frames.",
    ),
    ("sat_explicit_cold", "The same, explicit, nothing in the caches", "Not in the paper; as above."),
    (
        "plane_implicit",
        "One plane from built tables, implicit, windows the same in every frame",
        "The paper counts the eigenvectors of a 4x4 matrix alike in both spaces. Here range space solves a "
        "secular equation from the explicit solution, in one or two steps; the standard form needs a 3x3 "
        "eigenvector first.",
    ),
    (
        "plane_explicit",
        "One plane from built tables, explicit, windows the same in every frame",
        "Presumably the paper's standard form inverts MᵗM where range space multiplies by a stored inverse. Here "
        "both solve a centred 2x2 system in closed form, which costs less than looking the sums up, so "
        "what is saved is 5 of 8 look-ups; camera terms of a window are looked up once for all frames in "
        "range space.",
    ),
    (
        "plane_implicit_new",
        "The same, implicit, other windows in every frame",
        "Not in the paper. Where a window was not there before, the camera's terms have to be looked up as "
        "well, so that range space looks up as many sums as the standard form, or more.",
    ),
    ("plane_explicit_new", "The same, explicit, other windows in every frame", "Not in the paper; as above."),
    (
        "plane_implicit_vs_explicit",
        "One plane from built tables, range space: implicit against explicit",
        "Not a figure of the paper, whose implicit fits are the slow half because of the eigenvectors.",
    ),
    (
        "naive_implicit",
        "One plane of 2500 points from its pixels, implicit",
        "The paper's surprise: one division costs more than two multiplications. Integer depth has to be "
        "divided by the units of a metre in the standard form as well, so here both forms divide once a "
        "pixel.",
    ),
    ("naive_explicit", "One plane of 2500 points from its pixels, explicit", "As above."),
    (
        "naive_implicit_disparity",
        "The same, implicit, range space from disparity",
        "What the paper suspects would cure it: range space takes disparity as it is, without a division. "
        "Where the time goes into the ten sums of a pixel, one division less does not show.",
    ),
    ("naive_explicit_disparity", "The same, explicit, range space from disparity", "As above."),
    (
        "prior_tang",
        "The same, explicit: range space against Tang, Lui and Li's form",
        "Not in the paper, which cites it. It divides X, Y and 1 by Z at every pixel, although X/Z and Y/Z are known.",
    ),
    (
        "prior_erdogan",
        "The same, explicit, from disparity: range space against Erdogan, Paluri and Dellaert's form",
        "Not in the paper, which cites it. Disparity is not even scaled to 1/Z; else the two are the same sums.",
    ),
    (
        "windows200_implicit_vs_integral",
        "200 planes of 50x50 pixels, implicit: range space integral against standard integral",
        "Follows from the tables and the planes above.",
    ),
    (
        "windows200_implicit_vs_naive",
        "200 planes, implicit: range space integral against standard naive",
        "Compiled naive loops are far cheaper than MATLAB's, tables less so.",
    ),
    (
        "windows200_explicit_vs_integral",
        "200 planes, explicit: range space integral against standard integral",
        "Follows from the tables and the planes above.",
    ),
    (
        "windows200_explicit_vs_implicit",
        "200 planes, range space integral: explicit against implicit",
        "The paper's implicit planes pay for a general eigensolver; ours do not, so less is left to gain.",
    ),
    (
        "segmentation_implicit",
        "Segment frames, tables and planes, implicit: range space against standard",
        "Splitting needs a residual, so all methods build their squares' table as well. The frames have "
        "missing pixels: the fit stays exact there, for which range space lists the missing pixels' camera "
        "terms and takes them off, and the standard form needs a table of their number. The paper's "
        "precomputation ignores them. What both do alike, such as choosing which squares to split, dilutes "
        "the difference.",
    ),
    ("segmentation_explicit", "Segment frames, tables and planes, explicit: range space against standard", "As above."),
    (
        "segmentation_explicit_vs_implicit",
        "Segment frames, range space: explicit against implicit",
        "Both build the same tables here, since both need the residual, and the planes cost little beside "
        "them. The methods also split different squares: an implicit fit's residual is not the explicit "
        "one's.",
    ),
    (
        "segmentation_direct_vs_standard",
        "Segment frames: this library's default against standard implicit tables",
        "Not in the paper. A grid needs no tables: the finest squares' sums are added up, level by level.",
    ),
)
FLIGHT = (
    (
        "flight_seconds_saved_implicit",
        "Seconds saved in a five-minute flight, implicit at 30 frames per second (the paper says neither)",
    ),
    ("flight_seconds_saved_explicit", "The same, explicit"),
)
COUNTS = (
    ("implicit", "Summed-area tables, implicit: 9 standard, 4 range"),
    ("explicit", "Summed-area tables, explicit: 8 standard, 3 range"),
    ("naive", "Naive windows, terms of the depth"),
    ("tang", "Summed-area tables, explicit: 8 as Tang, Lui and Li (2011) write them, 3 range"),
    ("erdogan", "Summed-area tables, explicit: 3 of disparity, Erdogan, Paluri and Dellaert (2012), 3 range"),
)


def to_markdown(result: Result) -> str:
    """The report: every claim, the paper's number, ours, and a sentence where they differ."""
    parts = [
        "# Papadakis and Willis 2017, reproduced",
        "Every number below was measured or counted by `python -m bench`; the raw figures are in paper.json.",
        _machine(result["machine"]),
        "## Operations, counted",
        "The kernels' own source runs on numbers that tally what is done to them. The paper charges 4 "
        "operations per table and pixel, whatever they are, and the operations of the table's argument; "
        "it takes depth in metres as given. Executed is every addition, multiplication and division that "
        "the algorithm performs.",
        _counts(result["op_count"]),
        "The executed counts differ from the paper's for three reasons. A running sum along the row makes "
        "a table cost 2 additions a pixel, not 4. A sensor delivers integers, so the standard form "
        "divides as well, by the units in a metre. And naive range space adds and multiplies the camera's "
        "terms too, like the paper's own MᵗM, although they are known: that is why its executed ratio is "
        "near 1, not 2.",
        "## Times",
        "Changes are of range space against the standard form unless the line says otherwise: negative is "
        "less time. The times are the fastest of the rounds, since what disturbs a run only adds to it, and "
        "the ratio is old over new. The median of the rounds, beside it, has in it what else the machine did "
        "at the time.",
        _times(result),
        "### Where they differ, and why",
        "\n".join(f"- **{title}.** {why}" for key, title, why in CLAIMS if key in result["time"]),
        _segmentation(result),
        "## Measurement noise",
        _noise(result["noise"]),
        "## Figures",
        *(f"![{caption}]({name}.png)\n\n*{name}.* {caption}" for name, (caption, _) in FIGURES.items()),
    ]
    return "\n\n".join(parts) + "\n"


def readme_table(result: Result) -> str:
    """The page's table: all claims for which the paper has figures, and the forms that it cites."""
    rows = ["| | paper | here |", "|---|---:|---:|"]
    for key, title in COUNTS:
        paper, here = (_times_as_many(result["op_count"][key][whose]) for whose in ("paper", "counted"))
        rows.append(f"| Operations, {title[0].lower()}{title[1:]} | {paper} | {here} |")
    for key, title, _ in CLAIMS:
        claim = result["time"][key]
        if claim["paper"] is not None or key.startswith("prior"):
            rows.append(f"| {title} | {_percent(claim['paper'])} | {_percent(claim['measured'])} |")
    for key, title in FLIGHT:
        claim = result["time"][key]
        if claim["paper"] is not None:
            rows.append(f"| {title} | over {claim['paper']:g} s | {claim['measured']:.1f} s |")
    machine = result["machine"]
    rows.append("")
    rows.append(
        f"Changes in time of range space against the standard form unless the line says otherwise, one thread, "
        f"{machine['processor']}; `python -m bench --out report` measures them again, and says why they differ."
    )
    return "\n".join(rows)


def _times_as_many(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}x"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:+.0f} %".replace("-", "−")


def _machine(machine: Result) -> str:
    quick = " This was a quick run: few repeats." if machine["quick"] else ""
    return (
        f"{machine['processor']}, {machine['logical_processors']} logical processors of which "
        f"{machine['threads_used']} was used; {machine['system']}, Python {machine['python']}, Numba "
        f"{machine['numba']}, NumPy {machine['numpy']}, SciPy {machine['scipy']}, rgbd_planes "
        f"{machine['rgbd_planes']}; {machine['date']}. Frame: {machine['frame']}. Times: {machine['clock']} "
        f"({machine['rounds']}).{quick}"
    )


def _counts(counts: Result) -> str:
    rows = [
        "| | paper's ratio | counted | executed | standard, per pixel: paper's count / executed | range space |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for key, title in COUNTS:
        count = counts[key]
        cells = [
            f"{count['per_pixel'][space]['paper']:g} / {count['per_pixel'][space]['executed']:g}"
            for space in ("standard", "range")
        ]
        rows.append(
            f"| {title} | {_times_as_many(count['paper'])} | {count['counted']:.2f} | {count['executed']:.2f} | "
            f"{cells[0]} | {cells[1]} |"
        )
    return "\n".join(rows)


def _times(result: Result) -> str:
    rows = ["| | paper | here | median | ratio | new time | old time |", "|---|---:|---:|---:|---:|---:|---:|"]
    for key, title, _ in CLAIMS:
        claim = result["time"][key]
        new, old = (_duration(seconds) for seconds in claim["seconds"])
        rows.append(
            f"| {title} | {_percent(claim['paper'])} | {_percent(claim['measured'])} "
            f"| {_percent(claim['measured_median'])} | {claim['ratio']:.2f} | {new} | {old} |"
        )
    for key, title in FLIGHT:
        claim = result["time"][key]
        paper = "" if claim["paper"] is None else f"over {claim['paper']:g} s"
        rows.append(f"| {title} | {paper} | {claim['measured']:.1f} s | | | | |")
    return "\n".join(rows)


def _duration(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def _segmentation(result: Result) -> str:
    segmentation = result["segmentation"]
    fitted = ", ".join(
        f"{name} {count / segmentation['frames']:.0f}" for name, count in segmentation["elements_fitted"].items()
    )
    return (
        f"Segmented were {segmentation['frames']} {segmentation['source']}, squares of 32 pixels split at "
        f"most twice, above 20 mm. Squares fitted per frame: {fitted}. The seconds saved in a flight are few "
        "because everything takes milliseconds now: they are the paper's percentage of a smaller time."
    )


def _noise(noise: Result) -> str:
    rows = [
        f"The paper's model has σ_Z = {noise['paper']:.4g}·Z², so 1/Z has the same noise at every depth. "
        "Residual in 1/Z, in 1e-3 /m, of flat 16x16 tiles: those whose middle their four neighbours' planes "
        "predict, whatever their own residual. Median, and the 10 % and 90 % quantiles.",
        "",
        "| frames | depth, m | tiles | residual |",
        "|---|---:|---:|---:|",
    ]
    for name, bins in noise["sets"].items():
        for row in bins:
            low, median, high = (1e3 * sigma for sigma in row["sigma"])
            rows.append(
                f"| {name} | {row['depth'][0]:.1f} to {row['depth'][1]:.1f} | {row['tiles']} | "
                f"{median:.2f} ({low:.2f} to {high:.2f}) |"
            )
    rows += ["", f"The paper's figure in these units is {noise['paper'] * 1e3:.4g}."]
    return "\n".join(rows)
