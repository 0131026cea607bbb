"""Chance inputs, ordinary and absurd, for every public call and every format of file: ``python -m tests.fuzz``."""
