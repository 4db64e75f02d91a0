"""Sessions on disk: written every few seconds, restored on the first request after a restart."""
