"""How the camera moves through a sequence, with a covariance, from planes and tiles in inverse depth."""
