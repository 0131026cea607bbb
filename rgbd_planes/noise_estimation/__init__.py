"""A sensor's noise, estimated from its frames. Uses `fitting` and what is below it."""
