"""How good a plane is: p-values, covariances, and what follows from them. Uses `solvers` and what is below it.

- `tiles`: tiles, a block of tiles at a time
- `distributions`: chi-square, normal and F
- `noise_variances`, `label_variances`: means and sums over the pixels of parts of many depths
- `correlated_errors`: what errors that neighbours share do to parts of any shape; `pixel_runs` are their pixels,
  `correlation_cells` sums them up
- `plane_pairs`: planes compared by pairs
- `rounding`, `sandwich_covariance`: also for the planes of segments
"""
