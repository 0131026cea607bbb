"""Planes, spheres and cylinders of labels."""
