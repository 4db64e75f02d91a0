"""A renderer for tests as `stub_rooms`, whose frames clip a lamp of known radiance."""

from dataclasses import replace

import numpy as np

import stub_rooms

NAME = f"{__name__}:render_room"
LAMP = 12.0
"""Radiance of the lamp in units of white."""


def render_room(request):
    """Yield recordings as the generator's own `render_room` does."""
    for walk in range(request.count):
        rng = np.random.default_rng([request.seed, request.split == "train", request.index, walk])
        made = stub_rooms.recording(rng, frames=request.frames)
        colour, truth = made.colour.copy(), np.zeros(made.colour.shape, np.float16)
        colour[:, 6:14, 12:22] = 255
        truth[:, 6:14, 12:22] = LAMP
        yield replace(made, colour=colour, clipped_radiance=truth, facts={"room_type": "hall"})
