"""Which call or format the input of a number goes to, and what comes of it."""

import traceback

import numpy as np

from . import calls, formats

_RARELY = 0.002  # of all inputs, each of the slow calls
_OF_FORMATS = 0.2


def chosen(seed, kind="all"):
    """The call or the format of a number; always the one that is asked for."""
    if kind != "all":
        return kind
    rng = np.random.default_rng([seed, 1])
    share = rng.random()
    if share < _RARELY:
        return str(rng.choice(list(calls.RARE)))
    if share < _RARELY + _OF_FORMATS:
        return str(rng.choice(list(formats.FORMATS)))
    names = list(calls.CALLS)
    return str(rng.choice(names, p=[calls.CALLS[name][1] for name in names]))


def run(seed, kind="all"):
    """One input; returns what took it, and what came of it."""
    name = chosen(seed, kind)
    if name in formats.FORMATS:
        return name, formats.outcome(name, seed)
    use, _ = (calls.CALLS | calls.RARE)[name]
    return name, calls.outcome(use, seed)


def tried(seed, kind="all"):
    """`run`, and with "broken" what was raised, in a line and as a traceback, if a promise was broken."""
    try:
        return *run(seed, kind), None
    except Exception as error:
        return chosen(seed, kind), "broken", (f"{type(error).__name__}: {error}", traceback.format_exc())
