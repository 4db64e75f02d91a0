"""Depth of single pictures: the network (`network`) and its stage of training (`stage`)."""
