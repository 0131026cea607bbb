"""Find the planes of a frame, and follow them through a video."""
