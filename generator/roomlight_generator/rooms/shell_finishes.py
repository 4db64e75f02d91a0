"""Materials of a room's shell, one for each of its surfaces; chosen by `finishes`, applied by `shell`.

Texture coordinates are metres along the surface divided by the texture's `size_m` (the size of one repeat); v grows
downward on walls and curtains, so that patterns stand upright. Grain: a texture's u runs along the length of skirting
boards, frames, beams and mouldings, up a door's leaf, and along the longer side of the floor (the length of its
planks).
"""

from dataclasses import dataclass

from roomlight_generator.rooms.scene import Material


@dataclass(frozen=True, eq=False)
class RoomFinishes:
    """The large surfaces of one room.

    `accent_wall`, if given, is for one wall (the shell chooses the longest one without a window); None: all walls
    alike. `lower_wall`, if given, is the finish of the lower part of walls where the shell's style has one (bathroom
    tiles, a kitchen's backsplash, wainscot); None: walls have no separate lower part.
    """

    wall: Material
    floor: Material
    ceiling: Material
    skirting: Material
    accent_wall: Material | None = None
    lower_wall: Material | None = None


@dataclass(frozen=True, eq=False)
class Finishes:
    """All materials that `build_shell` applies.

    `room` is the main room, `second` the room or corridor visible through an open door or a passage. `frame` is for
    window frames, sills and mullions; `door` for leaves, `door_frame` for their linings and architraves; `handle` for
    door and window handles and curtain rods (metal); `moulding` for crown mouldings and picture rails.

    `curtain` and `blind` are the opaque ones (open at the sides, or drawn). `sheer` and `translucent_blind` cover a
    window and glow by day; the shell applies them under the names "daylit-curtain" and "daylit-blind", with a separate
    material object for each window, so that the lighting can give each its own emission.
    """

    room: RoomFinishes
    second: RoomFinishes
    frame: Material
    door: Material
    door_frame: Material
    handle: Material
    moulding: Material
    beam: Material
    curtain: Material
    blind: Material
    sheer: Material
    translucent_blind: Material
