"""``python -m bench``: measure the paper's claims and write report.md, paper.json, figures."""

import argparse
import json
import sys
from pathlib import Path

from bench.figures import FIGURES
from bench.paper import measure
from bench.report import to_markdown


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark and write the report."""
    parser = argparse.ArgumentParser(
        prog="python -m bench",
        description="Reproduce the claims of Papadakis and Willis 2017 and write a report.",
        epilog="Example: python -m bench --out report",
    )
    parser.add_argument("--out", type=Path, default=Path("report"), metavar="DIR", help="folder to write to (report)")
    parser.add_argument("--quick", action="store_true", help="few repeats and few points")
    options = parser.parse_args(arguments)

    options.out.mkdir(parents=True, exist_ok=True)
    result = measure(options.quick, lambda step: print(f"{step} ...", flush=True))
    (options.out / "paper.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    for name, (_, draw) in FIGURES.items():
        draw(result).savefig(options.out / f"{name}.png", dpi=110)
    (options.out / "report.md").write_text(to_markdown(result), encoding="utf-8")
    print(f"wrote {options.out / 'report.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
