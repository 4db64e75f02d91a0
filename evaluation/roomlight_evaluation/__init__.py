"""Scores light estimates against ground truth."""
