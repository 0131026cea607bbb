"""How the camera moves, with a covariance, from planes and tiles in inverse depth. Uses `segmentation` and below."""
