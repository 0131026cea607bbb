"""Stage 3: from blocks to regions, by what merging adds to the residual."""
