"""What knows no camera: arrays, checks, text, files, threads. Uses the kernels alone."""
