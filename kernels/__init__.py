"""Numba kernels: arrays in, arrays out. They know nothing of cameras, files or results."""
