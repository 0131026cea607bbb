"""Sums over pixels: of tiles, windows, labels, sliding windows, summed-area tables. Uses `common`."""
