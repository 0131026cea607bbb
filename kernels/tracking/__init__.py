"""Planes seen again in a sequence: a frame's labels by squares, and some pixels of each plane."""
