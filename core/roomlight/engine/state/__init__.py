"""The state of a session on disk: a snapshot between two frames, its encoding, and the file that holds it."""
