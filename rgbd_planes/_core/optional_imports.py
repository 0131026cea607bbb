"""Libraries that only some users need."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs(library: str, extra: str | None) -> Iterator[None]:
    """Say how to install the library whose import in the block fails, by itself if there is no extra.

    If it is installed, say why it cannot be imported: mostly because a system library is missing.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        what = library if extra is None else f'"rgbd-planes[{extra}]"'
        raise ModuleNotFoundError(f"this needs {library}: pip install {what} ({error})", name=error.name) from None
    except (ImportError, OSError) as error:
        raise ImportError(f"this needs {library}, which cannot be imported: {error}") from error
