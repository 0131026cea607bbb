"""Numba kernels that say how good a plane is: p-values, covariances, and what follows from them.

- `assess` does all of it for tiles, a block at a time, whose rows are in `room`: with `pixel_variances`; `residuals`,
  `chi_square` or, if the noise has a spread, `variance_ratio`, and `normal_distribution`; `covariances`; and
  `rounded_tiles`
- `variances` has means, and `label_variances` sums, over the pixels of parts of many depths
- `shared_errors` has what errors that neighbours share do to parts of any shape, whose pixels are `pixel_runs`, summed
  up by `cells`
- `same_planes` compares planes by pairs
- `rounding`, `sandwich` and `shared_errors` are also for the planes of segments
"""
