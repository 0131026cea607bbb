"""Numbers in words, as results print them."""

from typing import SupportsFloat

_LISTED = 10  # ranges


def two_digits(value: float) -> str:
    """A number to two digits, 110 where the format .2g gives 1.1e+02."""
    return f"{float(f'{value:.2g}'):g}"


def percent(share: SupportsFloat) -> str:
    """A share of 1 in per cent, to one decimal; 0 and 100 only if it is exactly that."""
    number = 100.0 * float(share)
    if 0.0 < number < 100.0:
        number = min(max(number, 0.1), 99.9)
    return f"{number:.1f} %"


def counted(count: float, what: str) -> str:
    """A count with its noun, whose plural ends in s."""
    number = f"{count:g}" if isinstance(count, float) else count
    return f"{number} {what}" if count == 1 else f"{number} {what}s"


def ranges(numbers: list[int]) -> str:
    """Whole numbers as ranges, "0 to 4, 7"; of many only the first ones."""
    there = set(numbers)
    starts = sorted(number for number in there if number - 1 not in there)
    ends = sorted(number for number in there if number + 1 not in there)
    listed = [str(a) if a == b else f"{a} to {b}" for a, b in zip(starts, ends, strict=True)]
    return ", ".join(listed[:_LISTED]) + (", ..." if len(listed) > _LISTED else "")


def shown(name: object) -> str:
    """A name from elsewhere, as of a file, that can be printed: it commands no terminal and breaks no line.

    What no terminal shows is written as Python would in a string, ``\\x1b``: control characters, line breaks, marks
    that turn the direction of writing, and bytes that are no Unicode.
    """
    text = str(name)
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def one_line(message: object) -> str:
    """The text of an error, `shown`; for the system's own, the file and the reason without the number."""
    if isinstance(message, OSError) and message.strerror is not None:
        message = f"{shown(message.filename)}: {message.strerror}" if message.filename else message.strerror
    return shown(" ".join(str(message).split()))


def reason_of(error: BaseException) -> str:
    """The text of an error in one line, or its kind if it has no text."""
    return one_line(error) or type(error).__name__
