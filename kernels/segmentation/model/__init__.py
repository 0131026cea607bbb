"""What all stages share: records, moments, noise of pixels, planes, quadrics. Uses no stage."""
