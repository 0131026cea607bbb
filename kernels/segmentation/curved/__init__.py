"""Stage 5: which regions are no planes."""
