"""Numba kernels: arrays in, arrays out. They know nothing of cameras, files or results.

Folders, lowest first; each uses only those before it:

- `_jit`: how kernels are compiled and cached on disk
- `common`: arrays, marks, quantiles, union-find
- `moments`: sums over the pixels of tiles, windows and labels; summed-area tables; sliding windows
- `solvers`: from moments to planes
- `fits`: from a frame to planes or normals in one call
- `statistics`: how good a plane is
- `segmentation`: the planes of a frame, and the pixels of each
- `primitives`: spheres, cylinders and planes of labels, by maximum likelihood in inverse depth
- `motion`: tiles of a frame against planes of other frames; where planes were before

Habits of these kernels, each because it was measured:

- No index counts from the end, unless it is spelled out, as in ``a[-1]``: see `_jit.array_lowering`. Whoever changes a
  kernel runs the tests with ``NUMBA_BOUNDSCHECK=1``, which finds those that are out of bounds on either side.
- Rows are taken as one-dimensional arrays before a loop: their stride is known to the compiler, while elements that are
  read by two indices look scattered.
- Arrays to work in have sizes that are fixed when a kernel is compiled, so that the compiler sees that their rows are
  apart, and uses vectors.
- Slices are made before a loop, and indices with conditions are worked out before they are used. A slice in a loop, or
  an array that waits while its index branches, costs a counted reference each time. A kernel that makes no arrays says
  so (``arrays=False``), and counts none: others ask at each call, for each array, whether its references count.
- Fields of tuples get names before a loop: looking into a tuple within it costs more than most of what is done there.
- What a loop looks up by an index is an array: of a tuple, each entry becomes a branch.
- Kernels that Python calls return numbers, and write all else to arrays that they are given. To return an array or a
  named tuple, Numba calls Python, and if somebody interrupts that, the process crashes.

Equations of Papadakis and Willis 2017, cited as eq. 1 to 16: their labels, and where to find them.

- points: 1 RGBD_reconstruction, 11 RGBD_reconstruction-1-1: `common.depth`, `moments.pixel_pairs`
- noise: 2 noise_models: not here, but in `rgbd_planes.noise`
- implicit fit: 3 implicit_plane_fitting_error, 4 quadratic_error_w_lagrange_multiplier: `solvers.methods`; 5 derivative
  of error: `solvers.eigen4`; its sums: 6 XYZ_scattermatrix: `moments.tiles`, `summed_area`, `windows`
- explicit fit: 7 explicit_fit_std, 8 derivative of error-1: `solvers.methods`; its sums: 9 XYZ_scattermatrix-1:
  `moments.summed_area`
- rays: 10 RGBD_reconstruction-1: not here, but in `rgbd_planes.camera.camera`
- plane in range space: 12 RGBD_space_plane_eq: `solvers.methods`; 13 prior_work_plane_equation: not used
- implicit fit there: 14 tan_theta_scattermatrix: `moments.tiles`, `summed_area`, `windows`, `solvers.secular`
- explicit fit there: 15 RGBD_explicit_fit: `solvers.methods`, `fits.normals_row`; its sums: 16
  tan_theta_scattermatrix-1: `moments.camera_terms`, `summed_area`

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
frame
    A `common.depth.RawFrame`: raw, lowest, highest, scale, offset and is_disparity. In `moments.strips` and above it
    the first four, since there an ``offset`` of None means depth.
rays
    (tan_x, tan_y).
standard
    None for sums and planes in range space, anything else for the standard form, (X, Y, Z).
work, scratch
    Memory that the caller lends; its contents mean nothing before a call nor, unless stated otherwise, after it.
"""
