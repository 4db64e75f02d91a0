"""Panoramas whose light is known: lamps at given directions, and a room with a window and a lamp."""

import numpy as np

from roomlight.conventions import panorama_directions, panorama_solid_angles


def unit(x, y, z):
    direction = np.array([x, y, z], np.float64)
    return direction / np.linalg.norm(direction)


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(np.dot(a, b), -1, 1)))


def lit(height, lamps, level=0.0):
    """A uniform panorama with round lamps: (direction, radius in degrees, RGB or grey radiance added)."""
    directions = panorama_directions(height)
    panorama = np.full((height, 2 * height, 3), level, np.float32)
    for direction, radius_deg, radiance in lamps:
        inside = directions @ unit(*direction).astype(np.float32) > np.cos(np.radians(radius_deg))
        panorama[inside] += np.float32(radiance)
    return panorama


def room(height):
    """Dim coloured walls, a window 28 degrees across of radiance 8, and a lamp 6 degrees across of radiance 60."""
    directions = panorama_directions(height)
    walls = 0.3 + 0.1 * directions @ np.array([[1.0, 0.2, -0.5], [0.3, 0.6, 0.9], [-0.4, 0.5, 0.1]], np.float32)
    return walls + lit(height, [((0.6, 0.3, 0.742), 14, 8.0), ((-0.5, 0.7, -0.51), 3, 60.0)])


def cap_solid_angle(radius_deg):
    """Solid angle in steradians of a round lamp."""
    return 2 * np.pi * (1 - np.cos(np.radians(radius_deg)))


def mean_light(panorama):
    """Mean radiance over the sphere, by solid angle."""
    weight = panorama_solid_angles(len(panorama)).astype(np.float64)[..., None]
    return (panorama * weight).sum(axis=(0, 1)) / (4 * np.pi)
