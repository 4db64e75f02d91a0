"""A piece of furniture in its model frame, from a furniture library or a plain fallback.

Model frame: metres, y up, x to its right, **front toward +z** (a sofa's back is at -z), origin at the centre of its
footprint's bounding box, bottom at y = 0.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.scene import Mesh, Rgb


@dataclass(frozen=True, eq=False)
class LightSource:
    """A lamp's bulb.

    Attributes:
        position: Model frame, metres.
        colour: Relative linear RGB, brightest channel 1.
    """

    position: Float[np.ndarray, "3"]
    diameter_m: float
    colour: Rgb = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class FurnitureModel:
    """A furniture model with the properties that the planner needs. Its mesh is loaded on first access.

    Attributes:
        split: Which rooms may use it: "train" and "test" share no model.
        width_m, height_m, depth_m: Bounding box along x, y and z.
        elevation_m: Height of its bottom over the floor if it hangs on a wall.
        top_m: Height, over its own bottom, of a surface that can support other objects; None: no such surface.
    """

    id: str
    name: str
    role: str
    split: Split
    width_m: float
    height_m: float
    depth_m: float
    load: Callable[[], Mesh]
    elevation_m: float = 0.0
    top_m: float | None = None
    lights: tuple[LightSource, ...] = ()
    attribution: str | None = None

    @cached_property
    def mesh(self) -> Mesh:
        """Mesh in the model frame."""
        return self.load()
