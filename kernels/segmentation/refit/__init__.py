"""Stage 7: the final planes, fitted to interior pixels."""
