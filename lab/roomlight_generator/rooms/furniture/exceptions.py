"""Models that keyword classification gets wrong, by id: found by inspecting every model of the Debian libraries.

`B0` and `BY` are the Blend Swap libraries (CC-0 and CC-BY), `K` is Kator Legaz, `S` is Scopia.
"""

from typing import Final

_LIBRARIES: Final = {
    "B0": "Blend Swap CC-0",
    "BY": "Blend Swap CC-BY",
    "K": "Kator Legaz",
    "R": "Reallusion",
    "S": "Scopia",
}


def _ids(text: str) -> list[str]:
    """Expand abbreviated ids to the libraries' ids: `S:tv K:fluorescent` to `Scopia#tv`, `Kator Legaz#fluorescent`."""
    parts = [word.partition(":") for word in text.split()]
    return [f"{_LIBRARIES[library]}#{name}" for library, _, name in parts]


_ROLES: Final[dict[str, str]] = {
    "sofa": "K:futon-couch S:day_bed_frame S:rattanSofa",
    "armchair": "S:ext_chair S:rattanArmchair B0:relaxChair BY:leaf_chair S:puff",
    "chair": "B0:armchair K:cafe-chair S:silla_teca S:modern_armchair",
    "office_chair": "S:kids_desk_chair K:office-chair S:office_chair",
    "stool": "B0:foldingChair B0:pianoBench",
    "bench": "B0:bench K:painted-bench S:littlebank",
    "dining_table": "K:cafe-table",
    "coffee_table": "S:ext_table S:rattanTable",
    "desk": "B0:technicalTable1 B0:technicalTable2 S:wooden_table_office S:desk_table S:glass_table_office "
    "S:wooden_office_alder_table S:wooden_office_pear_table_rect S:wooden_office_pear_table S:wooden_office_teak_table",
    "bed": "S:convertible-sofa-BZ-opened",
    "dresser": "S:changing-table S:dressing-table S:box_room",
    "bookcase": "S:office_box B0:televisionCabinet",
    "wall_shelf": "B0:upperShelves",
    "fireplace": "S:furnace",
    "kitchen_unit": "B0:drawersCabinet BY:kitchenDrawersCabinet",
    "wall_unit": "B0:glassDoorCabinet BY:kitchenGlassDoorCabinet",
    # A tall cabinet with a built-in oven takes the place of a tall fridge.
    "fridge": "B0:highCabinet",
    "exercise": "B0:poolTable B0:table_football BY:table_tennis S:flipper S:punching-ball BY:abdominalBench S:bicycle",
    "floor_toy": "BY:bike S:tricycle S:scooter S:skateboard S:children_chair BY:childChair B0:basketball BY:ballonFoot",
    "floor_clutter": "S:baby_high_chair B0:electricGuitar S:stroller BY:wheelchair S:basin "
    "B0:potty S:broom S:shovel B0:umbrellaFolded S:clothes-horse S:clothes-rack S:water_cooler BY:sef-kasa B0:barrel "
    "B0:handbag B0:briefcase B0:bootie B0:slippers S:sneakers S:woman_shoes S:mocassin S:wood_logs S:step-ladder-metal "
    "S:step-ladder-wood K:trunk-large",
    "wall_lamp": "K:fluorescent-strip K:porch-light",
    "ceiling_lamp": "K:fluorescent K:track-lights",
    "wall_clutter": "S:rounded-RJ-45 S:square-RJ-45 S:RJ-45-whites S:rounded-antenna S:square-antenna S:antenna-whites "
    "S:rounded-dimmer S:rounded-double-switch S:rounded-plug-TypeA S:rounded-plug-TypeB S:rounded-plug-TypeCFlat "
    "S:rounded-plug-TypeE S:rounded-plug-TypeG S:rounded-switch S:square-dimmer S:square-double-switch "
    "S:square-plug-TypeA S:square-plug-TypeB S:square-plug-TypeCFlat S:square-plug-TypeE S:square-plug-TypeG "
    "S:square-switch S:dimmer-whites S:double-switch-whites S:plug-TypeA-whites S:plug-TypeB-whites "
    "S:plug-TypeCFlat-whites S:plug-TypeE-whites S:plug-TypeG-whites S:switch-whites BY:wallSocket BY:wallDoubleSocket "
    "BY:surveillanceCamera B0:emergencySign B0:numberLock S:intercom S:intercom_with_screen S:dart_game S:wall-hanger "
    "B0:knifeStandSwap BY:kitchenTools B0:towel2 BY:towel B0:toiletPaperDispenser K:bathroom-tissue B0:toiletBrush",
    "laptop": "K:apple-ibook-2001",
    "electronics": "B0:iphone S:playstation4 S:ps4-joystick S:dvd S:tv-remote-control S:video-projector B0:tableFan "
    "B0:riggedFan K:MIDI-keyboard",
    "toy": "BY:tableTennisBat B0:tennisRacket BY:xylophone",
    "tableware": "BY:choppingBoard S:creamer S:sugar S:squeezer BY:utensilsPot S:kitchen_tool1 S:kitchen_tool2 "
    "S:kitchen_tool3 S:kitchen_tool4 BY:saltShaker K:oil-servers S:spiceTower S:paperTowelHolder",
    "kitchen_appliance": "BY:kitchenScale S:electronicScale BY:breadBox S:small-oven B0:stove",
    "food": "B0:tetrapak B0:yogurtBottle B0:cupcake S:bowlWithFruits S:bowlWithSalad",
    "bathroom_thing": "S:com_bath S:com_bath2_jabon_pijo",
    "ornament": "S:frame1 S:frame2 S:glasses BY:sunglasses K:ashtray S:chapeau S:casquette S:casque S:folded_clothes",
    "stationery": "S:bandeja S:penbox B0:textMarker",
    "small_plant": "B0:flowerBox BY:succulentPlant B0:orchids BY:white_lily",
    "plant": "B0:plantie",
}

ROLE_OF: Final[dict[str, str]] = {identity: role for role, text in _ROLES.items() for identity in _ids(text)}

EXCLUDED: Final = frozenset(
    _ids(
        # Outdoor objects, and objects that do not occur in rooms.
        "S:chimney S:round-chimney S:farola1 S:candelabre K:classic-lamppost K:park-light K:flashlight B0:urinal "
        "S:small-urinal B0:bidet B0:fireExtinguisher S:CCTV "
        "S:hospital-bed S:air-mattress S:sleepingBag S:bar_table S:ryokanChair "
        # Models with broken texture coordinates.
        "S:vase1 "
        # Incomplete objects: a shower's fittings, units that need a corner or a neighbour.
        "B0:shower K:showerHeadAndFaucet B0:showerDoor K:showerCurtain B0:lowerCornerCabinet B0:upperCornerCabinet "
        "B0:islandExtension B0:oven K:propane-stove B0:whiteBoard BY:workbench "
        # People in poses that need a chair or a bed.
        "R:boySitting R:sitFemale03 R:girlSittingTable R:sitMale01 R:sitMale02 R:lyingDownMale01"
    )
)
"""Models without a role although their keywords match one."""

FRONT_ROTATION_DEGREES: Final[dict[str, float]] = {}
"""Rotations, in degrees, of models whose front is not toward +z. The Debian libraries have none."""

_KINDS: Final[dict[str, dict[str, str]]] = {
    "B0:desklamp": {"Material.002": "shade"},
    "B0:wallLight": {"lamp": "shade"},
    "B0:JapaneseLantern": {"Lantern": "shade"},
    "B0:outdoorLamp": {"Pane": "shade"},
    "BY:hangingLight": {"Main-Bulb": "shade"},
    "BY:campingLamp": {"Frosted_Glass": "shade"},
    "K:fluorescent": {"Fluorescent": "shade"},
    "S:desk_lamp1": {"cristal_lampara": "glass"},
    "S:complements2": {"vela": "shade"},
    "S:little_lamp1": {"squares_multilamps.jpg": "shade"},
    "S:little_lamp3": {"yellow_multilamps.jpg": "shade", "cristal_blanco": "shade"},
    "S:saloon_lamp": {"pantalla": "shade", "cristal_blanco": "shade"},
    "S:table_lamp": {"lampshade_off_pantall_pantalla_color.jpg": "shade", "emit_white_off": "shade"},
    "S:livingroom_lamp1": {"lampshade_off_mul_multilamps.jpg": "shade", "white_glass_off.001": "shade"},
    "S:living_lamp": {"squares.001_tela_lamp_tile.jpg": "shade"},
    "S:chandelier-lamp": {"bulb-glass": "shade", "glass": "glass", "black-glass": "glossy"},
    "S:ceiling-lamp": {"white-lamp": "shade"},
    "S:tv": {"tvblack": "screen"},
    "S:contemp_living_room": {"black_mirror": "screen"},
    "K:apple-ibook-2001": {"LCD": "screen"},
    "K:apple-imac-1998": {"CRT": "screen"},
}

LIGHT_OFFSETS_M: Final[dict[str, tuple[float, float, float]]] = dict.fromkeys(
    _ids("S:desk_lamp1 S:desk_lamp2"), (0.0, -0.03, 0.0)
)
"""Offsets, in metres, that move enclosed bulbs out of their sockets."""

KIND_OF: Final[dict[str, dict[str, str]]] = {_ids(key)[0]: kinds for key, kinds in _KINDS.items()}
"""Kinds of model parts (see `materials.make_material`), by the name of their material."""
