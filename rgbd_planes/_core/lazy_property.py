"""Values that are worked out when they are first asked for."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

Owner = TypeVar("Owner")
Value = TypeVar("Value")


def kept(compute: Callable[[Owner], Value]) -> Callable[[Owner], Value]:
    """Return the getter of a property whose value stays with its object, in ``__dict__`` under the function's name.

    Threads that come at the same time may each work it out, but all get the same one. `functools.cached_property` of
    Python 3.11 has one lock for all objects: they would wait for each other, and for ever in a process that is forked
    meanwhile.
    """
    name = compute.__name__

    @functools.wraps(compute)
    def get(owner: Owner) -> Value:
        values: dict[str, Any] = owner.__dict__
        value: Value = values[name] if name in values else values.setdefault(name, compute(owner))
        return value

    return get
