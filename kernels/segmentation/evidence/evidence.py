"""Segmentation: how much more than noise a plane is, and the labels without those that are not.

The evidence for a plane is the logarithm of how many times more likely it makes its independent samples than the best
plane that is there without it. For n of them, with normal errors of unknown variance, that is n/2·ln(mean squared
residual about the other / about its own).
"""

import math

import numpy as np

from ..._jit.kernel import kernel
from ..model.records import Labels, Rays
from .alternatives import best_alternatives, misfit_of
from .samples import independent_samples, residual_sums

# Ratio of mean squared residuals that leaves no doubt, as of a plane that nothing touches.
MOST_RATIO = 1e4


@kernel()
def weigh_planes(label, inverse_depth, rays, alpha, moments, flatness, evidence):
    """Write the evidence for each plane.

    Parameters
    ----------
    label : (H, W) int32
        0 for none, 1..N.
    inverse_depth : (H, W) float32
    rays : Rays
    alpha, moments : (N, 3) and (N, 10) float64
        Of the planes and of their pixels.
    flatness : float
        Standard deviation of surfaces about planes, without any noise, as a share of the inverse depth.
    evidence : (N,) float64, written
    """
    rays = Rays(*rays)
    count = len(moments)
    sums, flat, samples, least = np.empty((count, 4)), np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):
        flat[k] = (flatness * moments[k, 3] / max(moments[k, 0], 1.0)) ** 2
    residual_sums(label, inverse_depth, rays, alpha, sums)
    independent_samples(sums, moments, flat, samples)
    best_alternatives(label, inverse_depth, rays, alpha, moments, least)
    for k in range(count):
        unevenness = moments[k, 0] * flat[k]
        rss = max(misfit_of(moments[k], alpha[k, 0], alpha[k, 1], alpha[k, 2]), 0.0) + unevenness
        ratio = min((least[k] + unevenness) / rss, MOST_RATIO) if rss > 0.0 else MOST_RATIO
        evidence[k] = 0.5 * samples[k] * math.log(max(ratio, 1.0))


@kernel(arrays=False)
def renumber_labels(number, why, labels):
    """Give pixels the new labels of their planes.

    Parameters
    ----------
    number : (N + 1,) int32
        New label of each, 0 for none; that of 0 is 0.
    why : uint8
        Reason of the pixels that have none any more.
    labels : Labels, changed
    """
    label, reason = Labels(*labels)
    label, reason = label.reshape(-1), reason.reshape(-1)
    for i in range(len(label)):
        a = number[label[i]]
        reason[i] = why if a == 0 and label[i] != 0 else reason[i]
        label[i] = a
