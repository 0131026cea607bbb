"""Stage 4: from regions to the pixels that belong to each."""
