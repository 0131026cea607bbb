"""Figures of anything with planes and a status, by matplotlib. Uses `camera` and what is below it, no results."""
