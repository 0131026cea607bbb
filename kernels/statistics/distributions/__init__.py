"""Quantiles and tails of the chi-square, normal and F distributions. Uses `_jit` alone."""
