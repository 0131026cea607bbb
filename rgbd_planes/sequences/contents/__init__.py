"""What a folder of frames holds: its depth images, and the calibration that stands beside them."""
