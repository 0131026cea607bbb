"""A sensor's geometry: intrinsics, lenses, rays, units of depth. Uses `noise` and `_core`."""
