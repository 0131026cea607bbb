"""The rounding error of tiles whose other errors are so small that rounding is not independent of them."""

import math

from ..._jit.kernel import kernel
from ..noise_variances import DEPTH_STEP, DISPARITY_STEP
from ..rounding import between_codes, in_common, is_left
from .block import BETWEEN, BY_COUNT, COMMON, INDEPENDENT, MEAN_Q, N_X, N_Y, ROUNDING, SHARED, TILES_AT_ONCE, D


@kernel(inline=True)
def step_square_at(noise, i, block):
    """Square of the step to which the inverse depths of tile ``i`` are rounded."""
    square = block[MEAN_Q, i] * block[MEAN_Q, i]
    return 12.0 * (noise[DEPTH_STEP] * square * square + noise[DISPARITY_STEP])


@kernel(inline=True)
def steps_across(step_square, i, block):
    """Steps that the plane of tile ``i`` spans along its two sides: evenly spread, √12 of its standard deviations."""
    scale = math.sqrt(12.0 / (step_square * block[0, i])) / block[D, i]
    u_steps = abs(block[N_X, i]) * scale * math.sqrt(max(block[4, i], 0.0))
    return u_steps, abs(block[N_Y, i]) * scale * math.sqrt(max(block[7, i], 0.0))


@kernel(reduction=True, inline=True)
def find_rounded(noise, block):
    """Whether in some tile of the block errors are so small that rounding is not independent of them."""
    number = 0.0
    for i in range(TILES_AT_ONCE):
        others = block[SHARED, i] + block[INDEPENDENT, i] - block[ROUNDING, i]
        number += 1.0 if is_left(step_square_at(noise, i, block), others) else 0.0
    return number > 0.0


@kernel(inline=True)
def rounded_apart(noise, count, block):
    """Write what rounding may add to the variance of a tile's pixels if all lie near the limit between two codes."""
    for i in range(count):
        block[BETWEEN, i] = 0.0
        step_square = step_square_at(noise, i, block)
        others = block[SHARED, i] + block[INDEPENDENT, i] - block[ROUNDING, i]
        if is_left(step_square, others):
            u_steps, v_steps = steps_across(step_square, i, block)
            block[BETWEEN, i] = between_codes(step_square, others, u_steps, v_steps)


@kernel(inline=True)
def rounded_alike(noise, count, block):
    """Add the rounding error common to all pixels of a tile to the factors on the variance that neighbours share.

    In rows from COMMON on, 0 before, it is written by itself, for a part for which those factors are not used. It is
    written as variances of a pixel: independent errors of such variances would give the two slopes and the mean inverse
    depth the same errors.
    """
    for i in range(count):
        lateral = block[INDEPENDENT, i] - block[ROUNDING, i]
        shared = max(block[SHARED, i], 1e-60)
        step_square = step_square_at(noise, i, block)
        if not is_left(step_square, shared + lateral):
            continue
        u_steps, v_steps = steps_across(step_square, i, block)
        common_u, common_v, common_mean = in_common(step_square, shared + lateral, block[0, i], u_steps, v_steps)
        block[SHARED, i] = shared
        block[COMMON, i], block[COMMON + 1, i], block[COMMON + 2, i] = common_u, common_v, common_mean
        block[BY_COUNT + 2, i] += common_u / shared
        block[BY_COUNT + 3, i] += math.sqrt(common_u * common_v) / shared
        block[BY_COUNT + 4, i] += common_v / shared
        block[BY_COUNT + 5, i] += common_mean / shared
