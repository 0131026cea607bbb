"""How kernels are compiled: Numba's options, the cache on disk. Uses nothing else of the kernels."""
