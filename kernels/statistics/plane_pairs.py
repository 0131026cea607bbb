"""Tests whether planes are the same."""

import math

from .._jit.kernel import kernel


@kernel()
def same_planes(alpha, covariance, other_alpha, other_covariance, p_value):
    """P-value of δᵀ(Σ + Σ')⁻¹δ with δ = α - α', chi-square with 3 degrees of freedom, for K pairs.

    ``alpha`` is (K, 3), ``covariance`` (K, 3, 3), ``p_value`` (K,), written.
    """
    for k in range(alpha.shape[0]):
        x = alpha[k, 0] - other_alpha[k, 0]
        y = alpha[k, 1] - other_alpha[k, 1]
        z = alpha[k, 2] - other_alpha[k, 2]
        # Cholesky, Σ + Σ' = LLᵀ, and L⁻¹δ.
        l_11 = math.sqrt(covariance[k, 0, 0] + other_covariance[k, 0, 0])
        l_21 = (covariance[k, 0, 1] + other_covariance[k, 0, 1]) / l_11
        l_31 = (covariance[k, 0, 2] + other_covariance[k, 0, 2]) / l_11
        l_22 = math.sqrt(covariance[k, 1, 1] + other_covariance[k, 1, 1] - l_21 * l_21)
        l_32 = (covariance[k, 1, 2] + other_covariance[k, 1, 2] - l_31 * l_21) / l_22
        l_33 = math.sqrt(covariance[k, 2, 2] + other_covariance[k, 2, 2] - l_31 * l_31 - l_32 * l_32)
        a = x / l_11
        b = (y - l_21 * a) / l_22
        c = (z - l_31 * a - l_32 * b) / l_33
        half = 0.5 * (a * a + b * b + c * c)
        p_value[k] = math.erfc(math.sqrt(half)) + 2.0 * math.sqrt(half / math.pi) * math.exp(-half)
