"""Scenes whose planes are known, and scores against them. Uses `fitting` and what is below it."""
