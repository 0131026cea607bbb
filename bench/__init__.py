"""The paper's claims, measured: ``python -m bench --out DIR`` writes the report, ``pytest bench`` times."""
