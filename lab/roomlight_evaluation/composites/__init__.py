"""Composites scored against pictures of the same rooms with the object really in them."""
