"""From a frame to its planes or normals in one call. Uses `solvers`, `moments` and what is below them."""
