"""p-values and covariances of the planes of tiles, a block of tiles at a time."""
