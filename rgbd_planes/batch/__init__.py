"""Whole sequences, fitted or segmented into tables of planes. Uses `segmentation` and what is below it."""
