"""Attributes of Numba that are others while a kernel is compiled."""

import contextlib
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def replaced(owner: Any, name: str, replacement: Any) -> Iterator[None]:
    """Have an attribute be another meanwhile, or, if it does not exist, do nothing: a later Numba may differ inside."""
    if not hasattr(owner, name):
        yield
        return
    is_own, before = name in vars(owner), getattr(owner, name)
    setattr(owner, name, replacement)
    try:
        yield
    finally:
        if is_own:
            setattr(owner, name, before)
        else:
            delattr(owner, name)
