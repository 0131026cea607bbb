"""Lens distortion: what a lens does to rays, and back. Uses `_core` alone."""
