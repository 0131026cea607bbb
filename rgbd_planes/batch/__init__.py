"""Fit or segment whole sequences, and write tables."""
