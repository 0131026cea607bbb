"""The command line: ``rgbd-planes demo``, ``fit``, ``segment``, ``normals``, ``curvature``, ``noise``, ``batch``."""

import argparse
import contextlib
import difflib
import inspect
import io
import os
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Callable, Sequence
from itertools import takewhile
from typing import IO, Any, NoReturn, cast

from rgbd_planes._core.text import one_line, shown
from rgbd_planes._core.version import __version__
from rgbd_planes.cli import COMMANDS
from rgbd_planes.cli.arguments import CommandError


def main(argv: list[str] | None = None) -> int:
    """Run a command; an error is one line on stderr.

    Returns
    -------
    int
        0; 1 if a frame has no measurement or frames of a batch were skipped; 2 after an error; 130 after Ctrl-C.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed: printing to nobody must not fail, nor go to the other
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (for good)
    if sys.stdout is sys.__stdout__ and isinstance(sys.stdout, io.TextIOWrapper):
        # If the encoding lacks a name's character, the rest is still printed. A pipe gets all at the end, even with
        # PYTHONUNBUFFERED: by then the work is done, even if its reader has left.
        sys.stdout.reconfigure(errors="backslashreplace", line_buffering=sys.stdout.isatty(), write_through=False)
    out, err = _Forgiving(sys.stdout, BrokenPipeError), _Forgiving(sys.stderr, OSError)
    with contextlib.redirect_stdout(cast(IO[str], out)), contextlib.redirect_stderr(cast(IO[str], err)):
        return _run(argv)


def _run(argv: list[str] | None) -> int:
    """`main`, once its output can go somewhere, or nowhere."""
    parser = _Parser(
        prog="rgbd-planes", description="Fit planes to depth images.", epilog="rgbd-planes COMMAND --help tells more"
    )
    parser.add_argument("--version", action="version", version=__version__)
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    width = max(shutil.get_terminal_size().columns - 2, 11)  # as argparse has it
    for command in COMMANDS:
        summary, _, example = inspect.cleandoc(command.__doc__ or "").partition("\n")
        subparser = subparsers.add_parser(
            command.__name__,
            help=summary,
            description=textwrap.fill(summary, width),
            epilog=example.strip(),
            formatter_class=_Formatter,
        )
        subparser.set_defaults(run=command(subparser))
    status: int | None = 0
    command_parser: argparse.ArgumentParser = parser
    try:
        try:
            arguments, unknown = parser.parse_known_args(argv)
        finally:  # also if that ends here, with a help text
            print(end="", flush=True)
        command_parser = subparsers.choices[arguments.command]
        if unknown:
            command_parser.error(f"unrecognized arguments: {' '.join(unknown)}")
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"PIL\.")  # for a damaged file the error says enough
            warnings.showwarning = _show_each_once()
            status = arguments.run(arguments)
            print(end="", flush=True)
    except (CommandError, ImportError, MemoryError, OSError, RuntimeError, TypeError, ValueError, UserWarning) as error:
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):  # imports of some libraries hide it
            return 130
        if isinstance(error, RuntimeError) and "start new thread" not in str(error):  # of no kind of its own
            raise
        words = _with_options(one_line(error), command_parser)
        print(f"{command_parser.prog}: {words or 'not enough memory'}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return status or 0


def _with_options(words: str, parser: argparse.ArgumentParser) -> str:
    """An error of a function in the words of its command: ``max_error`` is --max-error there."""
    options = {a.dest: a.option_strings[-1] for a in parser._actions if a.option_strings}
    options["num_threads"] = options.get("threads", "num_threads")
    first, space, rest = words.partition(" ")
    for name, option in options.items():
        if "_" in name:
            rest = re.sub(rf"\b{name}\b", option, rest)
    return options.get(first, first) + space + rest


class _Forgiving:
    """A stream of text whose failures do not stop the work, as where a pipe's reader has left: it is nobody's then."""

    def __init__(self, stream: IO[str], forgiven: type[OSError]) -> None:
        self._stream, self._forgiven = stream, forgiven

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except self._forgiven:
            self._lose()
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except self._forgiven:
            self._lose()

    def _lose(self) -> None:
        with contextlib.suppress(OSError):  # a stream of no file; else Python would try again at exit, and complain
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Breaks no line within rgbd-planes."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the usage; unknown options come first."""

    _given: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self._subparsers is None:  # a command's options are its own parser's
            self._given = args
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        unknown = self._unknown_options()
        if unknown:
            message = f"unrecognized arguments: {', '.join(unknown)}"
        elif "required: " in message and "--camera" in message:
            message += ", a file such as camera.json, or a preset such as kinect_v1"
        self.exit(2, f"{self.prog}: {shown(message)} (see {self.prog} --help)\n")

    def _unknown_options(self) -> list[str]:
        """The given options that do not exist, each with the one that is most like it."""
        options = list(self._option_string_actions)
        unknown = []
        for text in takewhile("--".__ne__, self._given):
            name = text.partition("=")[0]
            if name.startswith("--") and not any(option.startswith(name) for option in options):
                meant = difflib.get_close_matches(name, options, 1, cutoff=0.75)
                unknown.append(f"{name} (did you mean {meant[0]}?)" if meant else name)
        return unknown


def _show_each_once() -> Callable[..., None]:
    """Show each warning once, even if two steps of a command raise it."""
    shown: set[str] = set()

    def show(message: Warning | str, *where: object, **more: object) -> None:
        text = one_line(message)
        if text not in shown:
            shown.add(text)
            print(f"rgbd-planes: warning: {text}", file=sys.stderr)

    return show
