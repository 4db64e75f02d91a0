"""What image files state beside their pixels: limits, colour spaces, orientation, alpha, HEIC, the channels of EXR."""
