"""Room shells: walls with windows and doors, ceilings, curtains and blinds, and part of a second room."""

from roomlight_generator.rooms.shell.build import build_shell
from roomlight_generator.rooms.shell.style import STYLES, CoverKind, LowerKind, ShellStyle, WindowKind

__all__ = ["STYLES", "CoverKind", "LowerKind", "ShellStyle", "WindowKind", "build_shell"]
