"""A renderer for tests as `stub_rooms`, whose frames clip a lamp of known radiance."""

from dataclasses import replace

import numpy as np

import stub_rooms

NAME = f"{__name__}:render_room"
LAMP = 12.0
"""Radiance of the lamp in units of white."""


def render_room(room_index, *, seed, split, furniture, count, frames):
    """Yield recordings as the generator's own `render_room` does."""
    del furniture
    for walk in range(count):
        made = stub_rooms.recording(np.random.default_rng([seed, split == "train", room_index, walk]), frames=frames)
        colour, truth = made.colour.copy(), np.zeros(made.colour.shape, np.float16)
        colour[:, 6:14, 12:22] = 255
        truth[:, 6:14, 12:22] = LAMP
        yield replace(made, colour=colour, clipped_radiance=truth, facts={"room_type": "hall"})
