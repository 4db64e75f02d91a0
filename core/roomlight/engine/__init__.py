"""The engine: turns a stream of frames into light at any point."""
