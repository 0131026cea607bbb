"""What all kernels may use: arrays, marks, quantiles, union-find. Uses `_jit` alone."""
