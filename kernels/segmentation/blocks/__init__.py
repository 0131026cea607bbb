"""Stage 1: from a frame to blocks of 4 x 4 pixels and squares of blocks."""
