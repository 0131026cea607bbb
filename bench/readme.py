"""``python -m bench.readme DIR/paper.json``: put the benchmark's figures into docs/measured/paper.md.

What stands between ``<!-- bench:paper -->`` and ``<!-- /bench -->`` is replaced by the table.
"""

import argparse
import json
import re
import sys
from pathlib import Path

from bench.report import readme_table

README = Path(__file__).resolve().parents[1] / "README.md"
PAPER = README.parent / "docs" / "measured" / "paper.md"


def with_table(text: str, table: str, name: str = "paper") -> str:
    """The text with the table between its markers, ``<!-- bench:NAME -->`` and ``<!-- /bench -->``.

    Per cent signs stand apart from their numbers.

    Raises
    ------
    ValueError
        The markers are not there exactly once.
    """
    table = re.sub(r"(\d)%", r"\1 %", table)  # as everywhere else
    block = re.compile(rf"(<!-- bench:{name} -->\n).*?(<!-- /bench -->)", re.DOTALL)
    found = len(block.findall(text))
    if found != 1:
        raise ValueError(f"expected one block <!-- bench:{name} --> ... <!-- /bench -->, found {found}")
    return block.sub(lambda match: f"{match[1]}{table}\n{match[2]}", text)


def main(arguments: list[str] | None = None) -> int:
    """Rewrite the page's table."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.readme",
        description="Replace the page's table by the figures of a benchmark run.",
        epilog="Example: python -m bench.readme report/paper.json",
    )
    parser.add_argument("json", type=Path, help="paper.json of a run of python -m bench")
    parser.add_argument("--page", type=Path, default=PAPER, help="the file to change (docs/measured/paper.md)")
    options = parser.parse_args(arguments)
    table = readme_table(json.loads(options.json.read_text(encoding="utf-8")))
    text = with_table(options.page.read_text(encoding="utf-8"), table)
    options.page.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
