"""Run-length and variable-length coding of depth (Wilson, "Fast lossless depth image compression", 2017)."""

import numpy as np
from numpy.typing import NDArray


def decode(content: bytes, count: int) -> NDArray[np.uint16]:
    """Decode an image of so many pixels, (count,) uint16.

    Runs of zeros and of others take turns: their lengths, and the differences of the others, are numbers of 3 bits in
    each half byte, the lowest first, whose fourth bit says that more follow.

    Raises
    ------
    ValueError
        The content ends early, or does not have as many pixels.
    """
    words = np.frombuffer(content, "<u4", len(content) // 4)
    halves = (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32)) & 15
    halves = halves.ravel()
    ends = np.flatnonzero(halves < 8)
    if not len(ends):
        raise ValueError("truncated RVL image")
    halves = halves[: ends[-1] + 1].astype(np.int64)
    starts = np.concatenate([[0], ends[:-1] + 1])
    place = np.arange(len(halves)) - np.repeat(starts, ends - starts + 1)
    if place.max() > 10:
        raise ValueError("damaged RVL image")
    values = np.add.reduceat((halves & 7) << (3 * place), starts)
    depth = np.zeros(count, np.int64)
    at = number = previous = 0
    while at < count:
        if number + 2 > len(values):
            raise ValueError(f"truncated RVL image: {at} of {count} pixels")
        zeros, others = int(values[number]), int(values[number + 1])
        at, number = at + zeros, number + 2
        if zeros + others == 0 or at + others > count or number + others > len(values):
            raise ValueError(f"damaged RVL image: {at + others} of {count} pixels")
        coded = values[number : number + others]
        run = previous + np.cumsum((coded >> 1) ^ -(coded & 1))
        depth[at : at + others] = run
        at, number, previous = at + others, number + others, int(run[-1]) if others else previous
    return depth.astype(np.uint16)
