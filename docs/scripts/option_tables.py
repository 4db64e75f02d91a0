"""Tables of options in the pages, made from docstrings when the pages are built (`hooks` in mkdocs.yml).

A line `<!-- options: MODULE.CLASS name name ... -->` becomes a table of these fields, or of all without a name: flag,
values and text, as `roomlight COMMAND --help` shows them. A setting without a flag is shown as its
environment variable. A line `<!-- fields: MODULE.CLASS name ... -->` becomes a table of the fields that its docstring
describes.
"""

import re
from importlib import import_module
from typing import Any

from pydantic_settings import BaseSettings

from roomlight.rules import Rule, rules_of
from roomlight_cli.commands.serve import FLAGS
from roomlight_cli.options import CommandOptions, described
from roomlight_server.base.settings import PREFIX

_MARK = re.compile(r"^<!-- (options|fields): ([\w.]+)\.(\w+)((?:\s+\w+)*) -->$", re.MULTILINE)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace the marks of a page; called by mkdocs."""
    tables = {"options": option_table, "fields": field_table}
    return _MARK.sub(lambda mark: tables[mark[1]](getattr(import_module(mark[2]), mark[3]), mark[4].split()), markdown)


def field_table(described_class: type, names: list[str]) -> str:
    """Return a table in Markdown of the fields in a class's docstring.

    Raises:
        KeyError: The docstring has no such field.
    """
    texts = described(described_class, "Attributes")
    rows = ["| Field | Meaning |", "| --- | --- |"]
    return "\n".join(rows + [f"| `{name}` | {texts[name]} |" for name in names or texts])


def option_table(options: type, names: list[str]) -> str:
    """Return a table in Markdown of a dataclass's fields, or of settings'.

    Raises:
        KeyError: There is no such field, or it has no text.
    """
    texts = described(options, "Attributes")
    if issubclass(options, BaseSettings):
        fields = options.model_fields
        rules = {name: Rule.of(field.annotation, field.metadata) for name, field in fields.items()}
        defaults = {name: field.default for name, field in fields.items()}
        with_flag = {name for names in FLAGS.values() for name in names}
        flags = {name: "--" + name.replace("_", "-") if name in with_flag else PREFIX + name.upper() for name in fields}
    else:
        command = CommandOptions()
        command.add_dataclass(Rule(options), panel="")
        rules, flags = rules_of(options), command.flags
        defaults = {name: getattr(options, name, None) for name in rules}
    rows = ["| Option | Values | Meaning |", "| --- | --- | --- |"]
    for name in names or rules:
        default = "" if defaults[name] in (None, False, ()) else f"Default: {_value(name, defaults[name])}."
        values = rules[name].text
        if name.endswith("_bytes"):
            values = re.sub(r"[\d.]+e\+\d+", _whole_mebibytes, values)
        rows.append(f"| `{flags[name]}` | {values} | {texts[name]} {default} |")
    return "\n".join(rows)


def _value(name: str, value: Any) -> str:
    """Return a default as text; bytes in MiB or GiB where they are whole."""
    for unit, text in ((2**30, "GiB"), (2**20, "MiB")):
        if name.endswith("_bytes") and value % unit == 0:
            return f"{value // unit} {text}"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def _whole_mebibytes(number: re.Match[str]) -> str:
    return _value("_bytes", round(float(number[0]) / 2**20) * 2**20)
