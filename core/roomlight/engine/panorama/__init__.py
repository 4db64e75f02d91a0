"""A probe's panorama over time: blending, filling, its main light."""
