"""Room shells: walls with windows and doors, ceilings, curtains and blinds, and part of a second room.

Start at `build.build_shell`. `outline` chooses the plan and the ceiling, `floor_plan` places the holes, `surfaces`,
`windows`, `doors` and `covers` make the geometry with `mesh_builder`; `style` holds the parameters.
"""

from roomlight_generator.rooms.shell.build import build_shell
from roomlight_generator.rooms.shell.style import STYLES, CoverKind, ShellStyle

__all__ = ["STYLES", "CoverKind", "ShellStyle", "build_shell"]
