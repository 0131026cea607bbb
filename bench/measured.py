"""``python -m bench.measured``: measure what the pages under "Measured" and a table of the README show.

What was measured is kept in docs/measured.json, from which ``python -m bench.measured --page`` makes the pages' tables
and plots again; names of sections measure these alone. The section ``roofline`` draws its figure, too.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from bench import (
    batch_throughput,
    first_call,
    odometry,
    peers,
    plots,
    real_sensors,
    repeatability,
    roofline,
    segmentation,
    tracking,
    uncertainty_real,
    user_tasks,
)
from bench.paper import processor
from bench.readme import README, with_table

DOCS = Path(__file__).resolve().parents[1] / "docs"
RESULTS = DOCS / "measured.json"
SECTIONS = {
    "tasks": user_tasks,
    "peers": peers,
    "roofline": roofline,
    "first": first_call,
    "batch": batch_throughput,
    "segments": segmentation,
    "repeatability": repeatability,
    "tracking": tracking,
    "odometry": odometry,
    "sensors": real_sensors,
    "uncertainty": uncertainty_real,
}
# The page of each section; of the others it is measured.md.
PAGES = {
    "odometry": "measured/segments.md",
    "peers": "measured/speed.md",
    "roofline": "measured/speed.md",
    "first": "measured/speed.md",
    "batch": "measured/speed.md",
    "segments": "measured/segments.md",
    "repeatability": "measured/segments.md",
    "tracking": "measured/segments.md",
    "sensors": "measured/accuracy.md",
    "uncertainty": "measured/uncertainty.md",
}
# Those whose tables show times without saying where they were taken.
TIMED = ("tasks", "first", "batch", "segments")


def page_of(name: str) -> str:
    """The page that shows a section, below ``docs``."""
    return PAGES.get(name, "measured.md")


def text_of(page: str, text: str, results: dict[str, Any]) -> str:
    """A page with the tables of these results between its markers."""
    for name, section in SECTIONS.items():
        if page_of(name) == page:
            where = measured_on(results[name]) if name in TIMED else ""
            text = with_table(text, section.table(results[name]) + where, name)
    return text


def readme_of(text: str, results: dict[str, Any]) -> str:
    """The README with the table of these results between its markers."""
    return with_table(text, user_tasks.short_table(results["tasks"]) + measured_on(results["tasks"]), "tasks")


def measured_on(result: dict[str, Any]) -> str:
    """A paragraph that names the processor, if it is known."""
    return f"\n\nMeasured on {result['processor']}." if "processor" in result else ""


def main(arguments: list[str] | None = None) -> int:
    """Measure, keep the results, and rewrite the pages."""
    parser = argparse.ArgumentParser(prog="python -m bench.measured", description=__doc__)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--page", action="store_true", help="measure nothing")
    options = parser.parse_args(arguments)
    unknown = set(options.sections) - set(SECTIONS)
    if unknown:
        parser.error(f"expected of {', '.join(SECTIONS)}, got {', '.join(sorted(unknown))}")
    results = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    for name in () if options.page else options.sections or SECTIONS:
        print(f"{name} ...", flush=True)
        results[name] = SECTIONS[name].measure()
        if name in TIMED:
            results[name]["processor"] = processor()
        RESULTS.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
        if name == "roofline":
            roofline.figure(results[name])
    if missing := set(SECTIONS) - set(results):
        print(f"nothing measured yet of {', '.join(sorted(missing))}: the pages stay as they are", file=sys.stderr)
        return 1
    for page in {page_of(name): None for name in SECTIONS}:
        path = DOCS / page
        path.write_text(text_of(page, path.read_text(encoding="utf-8"), results), encoding="utf-8")
    plots.draw(results, DOCS / "images")
    README.write_text(readme_of(README.read_text(encoding="utf-8"), results), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
