"""Stage 6: from regions to connected parts, and their labels."""
