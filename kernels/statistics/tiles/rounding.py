"""Rounding where other errors are so small that it is not independent of them: see `rounding`."""

import math

from ..._jit.kernel import kernel
from ..noise_variances import DEPTH_STEP, DISPARITY_STEP
from ..rounding import between_codes, in_common, is_left
from .block import BETWEEN, COMMON, INDEPENDENT, MEAN_Q, N_X, N_Y, OF_COUNT, ROUNDING, SHARED, TILES_AT_ONCE, D


@kernel(inline=True)
def step_square_of(noise, i, room):
    """Square of the step to which the inverse depths of tile ``i`` are rounded."""
    square = room[MEAN_Q, i] * room[MEAN_Q, i]
    return 12.0 * (noise[DEPTH_STEP] * square * square + noise[DISPARITY_STEP])


@kernel(inline=True)
def steps_across(step_square, i, room):
    """Steps that the plane of tile ``i`` spans along its two sides: evenly spread, √12 of its standard deviations."""
    scale = math.sqrt(12.0 / (step_square * room[0, i])) / room[D, i]
    u_steps = abs(room[N_X, i]) * scale * math.sqrt(max(room[4, i], 0.0))
    return u_steps, abs(room[N_Y, i]) * scale * math.sqrt(max(room[7, i], 0.0))


@kernel(reduction=True, inline=True)
def find_rounded(noise, room):
    """Whether in some tile of the block errors are so small that rounding is not independent of them."""
    number = 0.0
    for i in range(TILES_AT_ONCE):
        others = room[SHARED, i] + room[INDEPENDENT, i] - room[ROUNDING, i]
        number += 1.0 if is_left(step_square_of(noise, i, room), others) else 0.0
    return number > 0.0


@kernel(inline=True)
def rounded_apart(noise, count, room):
    """Write what rounding may add to the variance of a tile's pixels if all lie near the limit between two codes."""
    for i in range(count):
        room[BETWEEN, i] = 0.0
        step_square = step_square_of(noise, i, room)
        others = room[SHARED, i] + room[INDEPENDENT, i] - room[ROUNDING, i]
        if is_left(step_square, others):
            u_steps, v_steps = steps_across(step_square, i, room)
            room[BETWEEN, i] = between_codes(step_square, others, u_steps, v_steps)


@kernel(inline=True)
def rounded_alike(noise, count, room):
    """Add the rounding error common to all pixels of a tile to the factors on the variance that neighbours share.

    In rows from COMMON on, 0 before, it is written by itself, for a part of which those factors are not used: as
    variances of a pixel, of which the slope along x, that along y and the mean inverse depth have the same as of
    independent ones.
    """
    for i in range(count):
        lateral = room[INDEPENDENT, i] - room[ROUNDING, i]
        shared = max(room[SHARED, i], 1e-60)
        step_square = step_square_of(noise, i, room)
        if not is_left(step_square, shared + lateral):
            continue
        u_steps, v_steps = steps_across(step_square, i, room)
        of_u, of_v, of_mean = in_common(step_square, shared + lateral, room[0, i], u_steps, v_steps)
        room[SHARED, i] = shared
        room[COMMON, i], room[COMMON + 1, i], room[COMMON + 2, i] = of_u, of_v, of_mean
        room[OF_COUNT + 2, i] += of_u / shared
        room[OF_COUNT + 3, i] += math.sqrt(of_u * of_v) / shared
        room[OF_COUNT + 4, i] += of_v / shared
        room[OF_COUNT + 5, i] += of_mean / shared
