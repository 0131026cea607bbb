"""Stage 2: what the frame shows of its own noise."""
