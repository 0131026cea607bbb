"""Numba kernels that find the planes of a frame and label its pixels, in this order:

- `search` reads a frame, with `blocks`
- `frame_noise` finds the noise of the frame, with `noise_estimation` and `reach`
- `search` finds planes and labels: with `regions`, which uses `joining`, `growth`, `merge` with `folds`, `pixels` with
  `settled` and `contest`, and `shape` with `facets`, `breaks` and `behind`; with `parts`, which uses `runs`; with
  `gaps`, `labels` and `rims`; then it fits the planes, with `inside` and `unevenness`, asks `reach` again, within them,
  and settles strays with `labels`
- `planes` describes the planes

`records` holds what they hand on; many use `moments` and `noise`, and `folds`, `shape` and `breaks` use `quadrics`.
"""
