"""Surfaces of second order: quadratics in inverse depth, fitted to tiles, windows and unions, and their curvature."""
