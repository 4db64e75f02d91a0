"""Notes of an open capture: what its poses and depth leave open."""

from roomlight.notes import Note


def lying_camera(name: str, convention: str, upward: float) -> Note:
    """Make the note for a world that is the first camera's: of a tracker that knows no gravity."""
    up = "y" if convention == "opengl" else "-y"
    return Note(
        f"{name}: the first pose is the identity, so that the camera looks straight {'up' if upward > 0 else 'down'} "
        "in the world that the format assumes",
        "the panorama may be turned by 90 degrees",
        f"state world_up (--world-up {up} if the first camera was held level)",
    )


def scaled_poses(name: str, metres: float, height_m: float) -> Note:
    """Make the note for poses that were scaled by the floor."""
    return Note(
        f"{name}: the scale of its poses, found by the floor in view",
        f"a unit of its poses is taken for {metres:.3g} m, the camera for {height_m:g} m above the floor in the mean",
        "scale the poses to metres for exact sizes, and leave out camera_height_m",
    )


def wrong_scale(name: str, factor: float) -> Note:
    """Make the note for depth whose unit is not that of the poses."""
    return Note(
        f"{name}: depth contradicts the poses; they agree with depth about {factor:.2g} times as large",
        "the unit of depth, or of the poses, seems wrong",
        "state depth_unit_m, the metres for one stored unit of depth, or scale the poses to metres",
    )
