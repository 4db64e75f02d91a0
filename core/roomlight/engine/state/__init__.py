"""The state of a session on disk: a snapshot between two frames, and its encoding."""
