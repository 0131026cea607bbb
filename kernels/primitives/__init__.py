"""Planes, spheres and cylinders by maximum likelihood in inverse depth, fitted to the pixels of labels."""
