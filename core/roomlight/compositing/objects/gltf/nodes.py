"""Nodes of a glTF: where its meshes stand, with instances and the pose of skins."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from roomlight.camera import rotation_of_quaternion
from roomlight.compositing.objects.gltf.accessors import Accessors
from roomlight.compositing.objects.gltf.container import extension
from roomlight.compositing.objects.gltf.schema import Gltf, Instancing, Node
from roomlight.compositing.objects.limits import ObjectLimits
from roomlight.errors import ObjectError

_ROUNDING = 1e-3
"""What exporters leave in a matrix's last row."""
_MAX_PRODUCT = 1e30
"""Of nested transforms, far below what overflows."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A mesh with its transform to the root, its skin's joint matrices, and the weights of its morph targets."""

    mesh: int
    transform: Float[np.ndarray, "4 4"]
    joints: Float[np.ndarray, "j 4 4"] | None
    weights: tuple[float, ...]


def placed_meshes(gltf: Gltf, accessors: Accessors, name: str, limits: ObjectLimits) -> list[Placed]:
    """Walk the scene's nodes; returns each placed mesh. Raises ObjectError."""
    limits.check("nodes", len(gltf.nodes), name)
    if gltf.scenes and gltf.scene >= len(gltf.scenes):
        raise ObjectError(f"{name}: scene {gltf.scene} of {len(gltf.scenes)} does not exist")
    children = {child for node in gltf.nodes for child in node.children}
    tops = sorted(set(range(len(gltf.nodes))) - children)
    roots = gltf.scenes[gltf.scene].nodes if gltf.scenes else tops
    transforms, hidden = _transforms(gltf, roots, name, limits)
    posed = transforms
    if any(joint not in transforms for skin in gltf.skins for joint in skin.joints):  # joints beside the scene
        posed = _transforms(gltf, tops, name, limits)[0] | transforms
    placed: list[Placed] = []
    for index, transform in transforms.items():
        node = gltf.nodes[index]
        if node.mesh is None or index in hidden:
            continue
        if node.mesh >= len(gltf.meshes):
            raise ObjectError(f"{name}: node {index} names mesh {node.mesh} of {len(gltf.meshes)}")
        weights = tuple(node.weights or gltf.meshes[node.mesh].weights)
        joints = None
        if node.skin is not None:
            joints = _joint_matrices(gltf, accessors, node.skin, posed, f"{name}: skin {node.skin}")
        for instance in _instances(node, accessors, f"{name}: node {index}", limits):
            placed.append(Placed(node.mesh, transform @ instance, joints, weights))
    return placed


def _transforms(
    gltf: Gltf, roots: list[int], name: str, limits: ObjectLimits
) -> tuple[dict[int, Float[np.ndarray, "4 4"]], set[int]]:
    """Return the transform to the root of each node of the scene, in order, and which are hidden."""
    queue = [(root, np.eye(4), 1) for root in reversed(roots)]
    transforms: dict[int, np.ndarray] = {}
    hidden: set[int] = set()
    while queue:
        index, above, depth = queue.pop()
        if index >= len(gltf.nodes):
            raise ObjectError(f"{name}: node {index} of {len(gltf.nodes)} does not exist")
        if index in transforms:
            raise ObjectError(f"{name}: node {index} has two parents or is its own; nodes must form trees")
        limits.check("node_depth", depth, name)
        node = gltf.nodes[index]
        shown = node.extensions.get("KHR_node_visibility")
        if isinstance(shown, dict) and shown.get("visible") is False:
            hidden.add(index)
        transforms[index] = above @ _local(node)
        if np.abs(transforms[index]).max() > _MAX_PRODUCT:
            raise ObjectError(f"{name}: the transforms down to node {index} pass {_MAX_PRODUCT:g}; check the unit")
        if index in hidden:
            hidden.update(node.children)
        queue.extend((child, transforms[index], depth + 1) for child in reversed(node.children))
    return transforms, hidden


def _local(node: Node) -> Float[np.ndarray, "4 4"]:
    if node.matrix is not None:
        matrix = np.array(node.matrix, np.float64).reshape(4, 4).T
        if np.abs(matrix[3] - [0, 0, 0, 1]).max() < _ROUNDING:
            matrix[3] = [0, 0, 0, 1]
        return matrix
    return _composed(np.array(node.translation), np.array(node.rotation), np.array(node.scale))


def _composed(
    translation: Float[np.ndarray, "3"], rotation: Float[np.ndarray, "4"], scale: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    unit = rotation / max(float(np.linalg.norm(rotation)), 1e-12)
    transform = np.eye(4)
    transform[:3, :3] = rotation_of_quaternion(unit) * scale
    transform[:3, 3] = translation
    return transform


def _instances(node: Node, accessors: Accessors, label: str, limits: ObjectLimits) -> list[Float[np.ndarray, "4 4"]]:
    """Return the transforms of EXT_mesh_gpu_instancing, or the identity alone."""
    instancing = extension(Instancing, node, "EXT_mesh_gpu_instancing", label, []) or Instancing()
    defaults = {"TRANSLATION": ("VEC3", [0.0] * 3), "ROTATION": ("VEC4", [0.0, 0, 0, 1]), "SCALE": ("VEC3", [1.0] * 3)}
    given = {key: index for key, index in instancing.attributes.items() if key in defaults}
    if not given:
        return [np.eye(4)]
    count = accessors.declared(next(iter(given.values())), label).count
    limits.check("parts", count, label)
    values = {
        key: accessors.floats(given[key], kind, count, f"{label}: {key}")
        if key in given
        else np.tile(value, (count, 1))
        for key, (kind, value) in defaults.items()
    }
    rows = zip(values["TRANSLATION"], values["ROTATION"], values["SCALE"], strict=True)
    return [_composed(*(np.asarray(value, np.float64) for value in row)) for row in rows]


def _joint_matrices(
    gltf: Gltf, accessors: Accessors, index: int, transforms: dict[int, Float[np.ndarray, "4 4"]], label: str
) -> Float[np.ndarray, "j 4 4"]:
    """Return what each joint does to a vertex, in the pose of the nodes: glTF ignores the mesh's own node."""
    if index >= len(gltf.skins):
        raise ObjectError(f"{label} of {len(gltf.skins)} does not exist")
    skin = gltf.skins[index]
    if not skin.joints or any(joint not in transforms for joint in skin.joints):
        raise ObjectError(f"{label}: a joint is not a node of the file")
    matrices = np.stack([transforms[joint] for joint in skin.joints])
    if skin.inverseBindMatrices is None:
        return matrices
    label = f"{label}: inverseBindMatrices"
    stated, needed = accessors.declared(skin.inverseBindMatrices, label).count, len(skin.joints)
    if stated < needed:
        raise ObjectError(f"{label} holds {stated} matrices for {needed} joints; export the skin again")
    binds = accessors.floats(skin.inverseBindMatrices, "MAT4", stated, label)[:needed]
    return matrices @ binds.astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
