"""Planes of tiles, windows, labels and unions; normals. Uses `uncertainty`, `plotting` and what is below them."""
