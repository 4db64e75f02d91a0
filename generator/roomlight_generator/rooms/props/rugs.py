"""Rugs: about 8 mm thick, their pattern across the whole top."""

import numpy as np

from roomlight_generator.rooms.props import palette
from roomlight_generator.rooms.props.draft import Draft, Parts, uniform
from roomlight_generator.rooms.props.pictures import rug_texture
from roomlight_generator.rooms.scene import Material, Mesh, Texture
from roomlight_generator.rooms.shapes import Number, prism, rectangle


def rug(rng: np.random.Generator) -> Draft:
    """Make a rug: rectangular, round, a runner or a mat; sometimes with a fringe."""
    kind = int(rng.choice([0, 0, 0, 1, 2, 3]))
    width, depth = (
        (uniform(rng, 1.4, 3.0), uniform(rng, 0.9, 2.0)),
        (uniform(rng, 0.9, 2.2),) * 2,
        (uniform(rng, 1.6, 3.0), uniform(rng, 0.55, 0.85)),
        (uniform(rng, 0.5, 0.95), uniform(rng, 0.4, 0.6)),
    )[kind]
    height = uniform(rng, 0.006, 0.012)
    if kind == 1:
        depth = width

    def build() -> Mesh:
        texture = rug_texture(rng, width / depth, round_one=kind == 1)
        if kind == 1 or rng.random() < 0.08:
            return _outlined(texture, width, depth, height)
        return _flat(rng, texture, width, depth, height)

    return Draft("round rug" if kind == 1 else "rug", (width, height, depth), build)


def _outlined(texture: Texture, width: Number, depth: Number, height: Number) -> Mesh:
    """Make a round or oval rug with the prism's own coordinates scaled to the whole picture."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    outline = np.stack([width / 2 * np.cos(angle), depth / 2 * np.sin(angle)], 1)
    parts = Parts()
    sized = Texture(texture.image, size_m=(width, depth))
    material = Material("rug", albedo=(0.95, 0.95, 0.95), texture=sized)
    shape = prism(outline, height)
    uvs = shape.uvs.copy()
    flat = np.abs(shape.normals[:, 1]) > 0.5
    uvs[flat] += np.array([width / 2, depth / 2], np.float32)
    uvs[~flat] *= 0.02
    parts.add(Mesh(shape.vertices, shape.normals, uvs, shape.faces, shape.face_materials, shape.materials), material)
    return parts.mesh()


def _flat(rng: np.random.Generator, texture: Texture, width: Number, depth: Number, height: Number) -> Mesh:
    parts = Parts()
    fringe = uniform(rng, 0.03, 0.06) if rng.random() < 0.25 and width > 1.3 else 0.0
    inner = width - 2 * fringe
    edge = palette.cloth(rng, patterned=0)
    parts.slab(edge, (inner, height - 0.0005, depth), radius=0)
    top = rectangle((-inner / 2, height, depth / 2), (inner, 0, 0), (0, 0, -depth), step=9, unit_uv=True)
    parts.add(top, Material("rug", albedo=(0.95, 0.95, 0.95), texture=texture))
    if fringe:
        yarn = Material("fringe", albedo=palette.neutral(rng, 190, 235))
        zs = np.linspace(-depth / 2 + 0.01, depth / 2 - 0.01, 28)
        parts.blocks(yarn, [(fringe, height * 0.5, 0.012, x * (inner + fringe) / 2, 0, z) for x in (-1, 1) for z in zs])
    return parts.mesh()
