"""What image files state beside their pixels: limits, colour spaces, orientation, alpha, and the channels of EXR."""
