"""Work beside the event loop: thread pools shared by time, decoding processes, the decoding of frames and objects."""
