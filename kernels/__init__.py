"""Numba kernels: arrays in, arrays out. They know nothing of cameras, files or results.

What calls what:

- tiles: `grid` from raw depth to planes, with `strips`, `camera_terms`, `range_moments` or `standard_moments`, then
  `solve` with `secular`, `eigen3` and `eigen4`; `merging` adds moments up, `label_moments` sums those of any pixels
- windows, and the paper's tables: `summed_area`, or `naive`, then `solve`
- normals: `dense`, with `sliding` and `window_planes`; `window_choice` keeps them off edges
- uncertainty: `statistics`, and segments: `segments`, each a folder of its own
- used by many of them: `depth`, `copying`, `marked`; in segments also `disjoint_sets`, `quantiles`; `cache_lines` is
  for whoever makes arrays for them
- tables on disk: `rows`

Habits of these kernels, each because it was measured:

- No index counts from the end, unless it is spelled out, as in ``a[-1]``: see `_lowering`. Whoever changes a kernel
  runs the tests with ``NUMBA_BOUNDSCHECK=1``, which finds those that are out of bounds on either side.
- Rows are taken as one-dimensional arrays before a loop: their stride is known to the compiler, while elements that are
  read by two indices look scattered.
- Arrays to work in have sizes that are fixed when a kernel is compiled, so that the compiler sees that their rows are
  apart, and uses vectors.
- Slices are made, and indices with conditions are worked out, before they are used: a slice in a loop, or an array that
  waits while its index branches, costs a counted reference each time. A kernel that makes no arrays says so
  (``arrays=False``), and counts none: others ask at each call, for each array, whether its references count.
- Fields of tuples get names before a loop: looking into a tuple within it costs more than most of what is done there.
- What a loop looks up by an index is an array: of a tuple, each entry becomes a branch.
- Kernels that Python calls return numbers, and write all else to arrays that they are given: to make an array or a
  named tuple, Numba calls Python, and if somebody interrupts that, the process crashes.

Equations of Papadakis and Willis 2017, cited as eq. 1 to 16: their labels, and where to find them.

- points: 1 RGBD_reconstruction, 11 RGBD_reconstruction-1-1: `depth`, `standard_moments`
- noise: 2 noise_models: not here, but in `rgbd_planes.noise`
- implicit fit: 3 implicit_plane_fitting_error, 4 quadratic_error_w_lagrange_multiplier: `solve`; 5 derivative of error:
  `eigen4`; its sums: 6 XYZ_scattermatrix: `standard_moments`, `summed_area`, `naive`
- explicit fit: 7 explicit_fit_std, 8 derivative of error-1: `solve`; its sums: 9 XYZ_scattermatrix-1: `summed_area`
- rays: 10 RGBD_reconstruction-1: not here, but in `rgbd_planes.camera`
- plane in range space: 12 RGBD_space_plane_eq: `solve`; 13 prior_work_plane_equation: not used
- implicit fit there: 14 tan_theta_scattermatrix: `range_moments`, `summed_area`, `naive`, `secular`
- explicit fit there: 15 RGBD_explicit_fit: `solve`, `window_planes`; its sums: 16 tan_theta_scattermatrix-1:
  `camera_terms`, `summed_area`

Names that mean the same everywhere:

raw, lowest, highest
    A frame, (H, W) uint16, float32 or float64, or several, (F, H, W); a pixel is valid if ``lowest <= raw <= highest``.
scale, offset, is_disparity
    The inverse depth of a raw value: ``scale / raw``, or ``scale * raw + offset`` for disparity. Without an
    ``is_disparity``, an ``offset`` of None means depth.
q, alpha
    Inverse depth 1/Z, and the plane's -n/d: q = α·(tanθx, tanθy, 1); in 1/m.
tan_x, tan_y
    tanθx and tanθy of each pixel's ray: (H, W) float64, unless stated otherwise.
u, v, w
    The coordinates that are summed: (tanθx, tanθy, q) in range space, (X, Y, Z) in the standard form.
moments, reference
    The sums [n, Σu, Σv, Σw, Σuu, Σuv, Σuw, Σvv, Σvw, Σww] over valid pixels, and the point they are taken about.
work, room
    Memory that the caller lends; its contents mean nothing before a call nor, unless stated otherwise, after it.
"""
