"""The light of objects: panoramas around them, and their change over time."""
