r"""Java property files, the format of Sweet Home 3D's catalogues: `key#7=value`, latin-1 with \uXXXX escapes."""

import re
from typing import Final

_ESCAPES: Final = {"t": "\t", "n": "\n", "r": "\r", "f": "\f"}
_ESCAPE: Final = re.compile(r"\\(u[0-9a-fA-F]{4}|.)", re.DOTALL)
_KEY: Final = re.compile(r"((?:\\.|[^\\=:\s])*)[ \t\f]*[=:]?[ \t\f]*(.*)", re.DOTALL)
_NUMBERED: Final = re.compile(r"(.+)#(\d{1,6})")


def parse_properties(data: bytes) -> dict[str, str]:
    """Parse all keys and values; a later key wins. Never fails: any bytes are latin-1 text."""
    properties: dict[str, str] = {}
    for line in _logical_lines(data.decode("latin-1")):
        match = _KEY.fullmatch(line)
        if match is not None:
            properties[_unescaped(match[1])] = _unescaped(match[2]).strip()
    return properties


def numbered_entries(properties: dict[str, str]) -> tuple[dict[str, str], dict[int, dict[str, str]]]:
    """Split properties into general ones and those of numbered entries (`name#12` is `name` of entry 12), in numeric
    order."""
    general: dict[str, str] = {}
    entries: dict[int, dict[str, str]] = {}
    for key, value in properties.items():
        match = _NUMBERED.fullmatch(key)
        if match is None:
            general[key] = value
        else:
            entries.setdefault(int(match[2]), {})[match[1]] = value
    return general, dict(sorted(entries.items()))


def _logical_lines(text: str) -> list[str]:
    lines: list[str] = []
    begun = ""
    for natural in re.split(r"\r\n|\r|\n", text):
        line = natural.lstrip(" \t\f")
        if not begun and (not line or line[0] in "#!"):
            continue
        begun += line
        # An odd number of backslashes at the end continues the line.
        if (len(begun) - len(begun.rstrip("\\"))) % 2:
            begun = begun[:-1]
            continue
        lines.append(begun)
        begun = ""
    return [*lines, begun] if begun else lines


def _unescaped(text: str) -> str:
    def character(match: re.Match[str]) -> str:
        what = match[1]
        return chr(int(what[1:], 16)) if len(what) == 5 else _ESCAPES.get(what, what)

    return _ESCAPE.sub(character, text)
