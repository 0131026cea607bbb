"""The planes of a frame, and of a video. Uses `fitting` and what is below it."""
