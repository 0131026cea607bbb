"""Libraries that only some need."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs(library: str, extra: str) -> Iterator[None]:
    """Say how to install the library whose import in the block fails."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f'this needs {library}: pip install "rgbd-planes[{extra}]" ({error})', name=error.name
        ) from None
