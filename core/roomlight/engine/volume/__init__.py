"""The spherical Gaussian lighting volume: initialisation from a frame, fusion over frames, ray tracing."""
