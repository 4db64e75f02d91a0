"""Rooms and furniture for the planner's tests: boxes of usual sizes, hand-made and random shells."""

from collections.abc import Callable, Collection, Sequence

import numpy as np

from roomlight.dataset.recording import Split
from roomlight_generator.rooms.furniture import Catalogue
from roomlight_generator.rooms.furniture_model import FurnitureModel
from roomlight_generator.rooms.plan import Gap, Shell, Wall
from roomlight_generator.rooms.shapes import block

TOPPED = {
    "dining_table", "coffee_table", "side_table", "desk", "nightstand", "dresser", "bookcase", "sideboard", "tv_stand",
    "kitchen_unit", "dishwasher", "washing_machine", "washbasin", "wall_shelf", "piano", "fireplace",
}  # fmt: skip

SPLITS: tuple[Split, ...] = ("train", "test")

SIZES: dict[str, list[tuple[float, float, float]]] = {  # width, height, depth
    "sofa": [(2.1, 0.85, 0.95), (1.6, 0.8, 0.85), (2.6, 0.8, 1.6), (1.4, 0.8, 0.8)],
    "armchair": [(0.8, 0.9, 0.85), (0.7, 1.0, 0.8)], "chair": [(0.45, 0.9, 0.5), (0.42, 0.85, 0.48)],
    "office_chair": [(0.62, 1.1, 0.62), (0.58, 0.95, 0.6)], "stool": [(0.38, 0.65, 0.38), (0.4, 0.45, 0.4)],
    "bench": [(1.2, 0.45, 0.4), (1.5, 0.85, 0.5)],
    "dining_table": [(1.6, 0.75, 0.9), (0.9, 0.74, 0.9), (2.2, 0.75, 1.0), (1.2, 0.75, 0.75), (0.7, 0.73, 0.7)],
    "coffee_table": [(1.1, 0.42, 0.6), (0.8, 0.4, 0.8), (0.6, 0.45, 1.0)],
    "side_table": [(0.45, 0.55, 0.45), (0.5, 0.6, 0.4)],
    "desk": [(1.4, 0.74, 0.7), (1.2, 0.75, 0.6), (1.6, 0.74, 0.8)],
    "bed": [(1.65, 0.95, 2.1), (0.95, 0.9, 2.05), (1.85, 1.1, 2.15)],
    "child_bed": [(0.75, 0.9, 1.45), (0.9, 0.8, 1.95)], "nightstand": [(0.45, 0.5, 0.4), (0.4, 0.6, 0.38)],
    "wardrobe": [(1.5, 2.1, 0.6), (1.0, 1.95, 0.58), (2.2, 2.3, 0.62)],
    "dresser": [(1.0, 0.85, 0.48), (0.8, 1.1, 0.45)],
    "bookcase": [(0.8, 2.0, 0.3), (1.0, 1.2, 0.32), (0.4, 1.9, 0.28)],
    "sideboard": [(1.6, 0.8, 0.45), (1.2, 0.85, 0.4)], "tv_stand": [(1.5, 0.5, 0.42), (1.2, 0.45, 0.4)],
    "kitchen_unit": [(0.6, 0.9, 0.6), (0.8, 0.9, 0.6), (0.4, 0.9, 0.6)], "oven": [(0.6, 0.9, 0.6)],
    "fridge": [(0.6, 1.8, 0.65), (0.7, 1.5, 0.68)], "dishwasher": [(0.6, 0.85, 0.6)],
    "washing_machine": [(0.6, 0.85, 0.58)], "bathtub": [(1.7, 0.6, 0.75), (1.5, 0.55, 0.7)],
    "shower": [(0.9, 2.0, 0.9), (0.8, 2.1, 0.8)], "toilet": [(0.38, 0.78, 0.66)],
    "washbasin": [(0.6, 0.88, 0.48), (0.9, 0.85, 0.5)],
    "radiator": [(1.0, 0.6, 0.1), (0.6, 0.6, 0.1), (1.4, 0.5, 0.12)],
    "floor_lamp": [(0.4, 1.6, 0.4), (0.3, 1.75, 0.3)], "plant": [(0.5, 1.2, 0.5), (0.35, 0.8, 0.35), (0.7, 1.7, 0.7)],
    "piano": [(1.5, 1.2, 0.6)], "fireplace": [(1.3, 1.1, 0.4)], "person": [(0.55, 1.75, 0.4), (0.5, 1.65, 0.35)],
    "pet": [(0.3, 0.5, 0.7)], "floor_toy": [(0.3, 0.3, 0.3), (0.5, 0.4, 0.3), (0.15, 0.12, 0.2)],
    "floor_clutter": [(0.4, 0.3, 0.35), (0.3, 0.5, 0.3), (0.25, 0.3, 0.25)], "exercise": [(0.6, 1.2, 1.2)],
    "wall_unit": [(0.6, 0.7, 0.35), (0.8, 0.6, 0.33)], "hood": [(0.6, 0.6, 0.45)],
    "wall_shelf": [(0.9, 0.04, 0.22), (0.6, 0.3, 0.2)], "wall_lamp": [(0.15, 0.3, 0.15)],
    "picture": [(0.5, 0.7, 0.03), (0.9, 0.6, 0.04), (0.3, 0.3, 0.02), (1.2, 0.9, 0.04)],
    "mirror": [(0.6, 0.8, 0.03), (0.5, 1.2, 0.04)], "clock": [(0.3, 0.3, 0.05)], "wall_television": [(1.2, 0.7, 0.08)],
    "air_conditioner": [(0.9, 0.3, 0.22)], "towel_rack": [(0.6, 0.15, 0.1)], "whiteboard": [(1.5, 1.0, 0.04)],
    "wall_clutter": [(0.4, 0.2, 0.1)],
    "ceiling_lamp": [(0.5, 0.12, 0.5), (0.4, 0.6, 0.4), (0.3, 0.9, 0.3), (0.1, 0.12, 0.1), (1.2, 0.08, 0.3)],
    "ceiling_fan": [(1.2, 0.35, 1.2)], "television": [(1.1, 0.68, 0.2), (0.8, 0.5, 0.18)],
    "computer": [(0.55, 0.45, 0.2)], "laptop": [(0.34, 0.24, 0.26)],
    "table_lamp": [(0.25, 0.45, 0.25), (0.3, 0.55, 0.3)], "small_plant": [(0.15, 0.25, 0.15)],
    "vase": [(0.12, 0.3, 0.12)], "book": [(0.2, 0.05, 0.15), (0.25, 0.22, 0.16)],
    "tableware": [(0.26, 0.03, 0.26), (0.09, 0.1, 0.09)], "food": [(0.25, 0.12, 0.25)],
    "kitchen_appliance": [(0.3, 0.25, 0.2), (0.2, 0.25, 0.18)], "electronics": [(0.2, 0.08, 0.15)],
    "toy": [(0.15, 0.15, 0.1)], "bathroom_thing": [(0.08, 0.18, 0.08)], "ornament": [(0.1, 0.2, 0.1)],
    "stationery": [(0.1, 0.12, 0.1)],
    "rug": [(2.3, 0.012, 1.6), (1.4, 0.01, 0.8), (0.8, 0.015, 0.5), (3.0, 0.012, 2.0), (2.4, 0.01, 0.8)],
}  # fmt: skip


def model(role: str, size: tuple[float, float, float], split: Split = "train", tag: str = "") -> FurnitureModel:
    width, height, depth = size
    return FurnitureModel(
        id=f"{split}-{role}-{width}x{height}x{depth}{tag}",
        name=f"{role}{tag}",
        role=role,
        split=split,
        width_m=width,
        height_m=height,
        depth_m=depth,
        load=lambda: block(width, height, depth),
        top_m=height if role in TOPPED else None,
    )


class _Boxes(Catalogue):
    def choose(
        self, role: str, split: Split, rng: np.random.Generator, *, fits: Callable[[FurnitureModel], bool] | None = None
    ) -> FurnitureModel | None:
        library, _ = self._by_role.get((role, split), ([], []))
        fitting = [candidate for candidate in library if fits is None or fits(candidate)]
        return fitting[int(rng.integers(len(fitting)))] if fitting else None


def box_catalogue(lacking: Collection[str] = ()) -> Catalogue:
    """Return furniture models that are boxes, without some roles."""
    models = [model(role, size, split) for split in SPLITS for role, sizes in SIZES.items() for size in sizes]
    models += [model("kitchen_unit", (0.8, 0.9, 0.6), split, " with sink") for split in SPLITS]
    return _Boxes(tuple(candidate for candidate in models if candidate.role not in lacking))


def shell(
    corners: Sequence[tuple[float, float]],
    gaps: dict[int, tuple[Gap, ...]],
    height: float = 2.6,
    slopes: tuple[tuple[np.ndarray, float], ...] = (),
    wall_heights: dict[int, float] | None = None,
    spots: tuple[tuple[float, float, float], ...] = (),
) -> Shell:
    """Return a shell with walls along the corners, clockwise seen from above with z down the page."""
    polygon = np.array(corners, np.float64)
    walls = []
    for index, (start, end) in enumerate(zip(polygon, np.roll(polygon, -1, axis=0), strict=True)):
        direction = (end - start) / np.linalg.norm(end - start)
        inward = np.array([-direction[1], direction[0]])
        low = (wall_heights or {}).get(index, height)
        walls.append(Wall(start=start, end=end, inward=inward, height_m=low, gaps=gaps.get(index, ())))
    return Shell(
        items=(), openings=(), polygon=polygon, walls=tuple(walls), height_m=height, slopes=slopes, spots=spots
    )


def _gaps(length: float, rng: np.random.Generator, *, door: bool) -> tuple[Gap, ...]:
    if door and length > 1.2:
        start = float(rng.uniform(0.1, length - 1.0))
        return (Gap("door", start, start + 0.85, 0.0, 2.05, keep_clear_m=0.9),)
    if length > 2 and rng.random() < 0.6:
        width = float(rng.uniform(0.8, min(length - 0.6, 2.0)))
        start = float(rng.uniform(0.2, length - width - 0.2))
        bottom = float(rng.choice([0.85, 0.95, 0.05]))
        return (Gap("window", start, start + width, bottom, 2.2, covered=bool(rng.random() < 0.4)),)
    return ()


def random_shell(rng: np.random.Generator, area: float, aspect: float, *, kind: str = "rectangle") -> Shell:
    """Return a rectangle, an L or an attic of about that floor area, with a door or two and some windows."""
    width, depth = float(np.sqrt(area * aspect)), float(np.sqrt(area / aspect))
    if rng.random() < 0.5:
        width, depth = depth, width
    corners = [(0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)]
    if kind == "l":
        a, b = width * float(rng.uniform(0.35, 0.55)), depth * float(rng.uniform(0.35, 0.55))
        corners = [
            (0.0, 0.0),
            (width, 0.0),
            (width, depth - b),
            (width - a, depth - b),
            (width - a, depth),
            (0.0, depth),
        ]
    height = float(rng.uniform(2.4, 3.2))
    ends = [*corners[1:], corners[0]]
    lengths = [float(np.hypot(x1 - x0, z1 - z0)) for (x0, z0), (x1, z1) in zip(corners, ends, strict=True)]
    doors = {int(rng.integers(len(corners)))}
    if rng.random() < 0.3:
        doors.add(int(rng.integers(len(corners))))
    if kind == "attic":
        # The ceiling comes down to 1.2 m at the wall x = 0 over 1.6 m.
        normal = np.array([-(height - 1.2), 1.6, 0.0])
        slopes = ((normal, 1.6 * 1.2),)
        doors = {1}
        gaps = {index: _gaps(lengths[index], rng, door=index in doors) for index in (0, 1, 2)}
        gaps = {index: gap for index, gap in gaps.items() if index == 1}
        return shell(corners, gaps, height, slopes, {0: 1.2, 2: 1.2, 3: 1.2})
    gaps = {index: _gaps(length, rng, door=index in doors) for index, length in enumerate(lengths)}
    spots = ((-1.5, depth / 2, 0.45),) if rng.random() < 0.5 else ()
    return shell(corners, gaps, height, spots=spots)
