"""Commands made of functions and dataclasses: type, default, rule and help of an option are written once, at its field.

    def light(image: Path, options: LightOptions, *, out: Path) -> None:
        \"\"\"Light points of one photograph.

        Args:
            image: The photograph.
            out: Folder for panoramas.
        \"\"\"

    app = command_app(light)  # roomlight light IMAGE --out OUT --above 0.1 ...

- A positional parameter is an argument, a keyword-only parameter an option.
- A parameter or a field that is a dataclass stands for an option for each field, under its text as heading.
- A function in `Annotated` adds the options of a parameter itself, and returns what builds its argument.
- Help comes from the sections `Args:` and `Attributes:` of the docstrings.
- The field `above_m` is the flag `--above`, without its unit; a field with a tuple of values, `probes`, is the
  repeatable flag `--probe`.
- Choices and ranges are those of the types (`roomlight.rules`).
"""

import inspect
import os
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any, Final, cast, get_args, get_origin, get_type_hints

import typer
from annotated_types import Ge, Gt, Le

from roomlight.errors import OptionError, RoomLightError
from roomlight.files import check_writable
from roomlight.rules import Rule
from roomlight_cli.console import APP_OPTIONS, fail, with_flags

_UNIT: Final = re.compile(r"_(m|deg|degrees)$")
_WRITTEN: Final = ("out", "json")
"""Options that name what is written; a link stays, and what it leads to is written."""
_REQUIRED: Final = inspect.Parameter.empty
_POINTS: Final = {
    2: ("U,V", "a pixel is U,V: column and row, e.g. 960,540"),
    3: ("X,Y,Z", "a position or direction is X,Y,Z, e.g. 0.2,-0.1,-1.5"),
}
"""Placeholder and rule of tuples of so many numbers."""

Values = dict[str, Any]
Build = Callable[[Values], Any]
"""Makes an argument of a command's function of the values on the command line."""


@dataclass(frozen=True)
class Flag:
    """How an option looks on the command line, where its field does not say it; a note in `Annotated`.

    Attributes:
        name: The flag, e.g. --set, instead of the one that the field's name gives.
        metavar: Placeholder of the value.
        env: Environment variable that sets the option; its value is not shown.
        panel: Heading in the help.
        text: Help of an option that several commands share; it then needs no docstring.
    """

    name: str | None = None
    metavar: str | None = None
    env: str | None = None
    panel: str | None = None
    text: str | None = None


@dataclass(frozen=True)
class Check:
    """What refuses a whole dataclass of options with an OptionError; a note in `Annotated`."""

    refuse: Callable[[Any], None]


class Without:
    """Names of a dataclass's fields that are no options of a command; a note in `Annotated`."""

    def __init__(self, *names: str) -> None:
        self.names = names


def command_app(function: Callable[..., None], **facts: Any) -> typer.Typer:
    """Return the application of a module that has one command; `facts` are those of `typer.Typer.command`."""
    app = typer.Typer(add_completion=False, **APP_OPTIONS)
    add_command(app, function, **facts)
    return app


def add_command(app: typer.Typer, function: Callable[..., None], **facts: Any) -> None:
    """Add a function as a command. An error of RoomLight becomes one line that names options by their flags.

    Raises:
        ValueError: Two options have the same name, or one has no text in a docstring.
    """
    options = CommandOptions()
    hints, texts = get_type_hints(function, include_extras=True), described(function, "Args")
    builds: dict[str, Build] = {}
    for parameter in inspect.signature(function).parameters.values():
        rule = Rule.of(hints[parameter.name])
        own = cast("Callable[[CommandOptions], Build] | None", next(filter(callable, rule.notes), None))
        if own is not None:
            builds[parameter.name] = own(options)
            continue
        if is_dataclass(rule.kind):
            builds[parameter.name] = options.add_dataclass(rule, panel=texts[parameter.name].rstrip("."))
            continue
        add = options.add_argument if parameter.kind is parameter.POSITIONAL_OR_KEYWORD else options.add_option
        builds[parameter.name] = add(parameter.name, rule, texts.get(parameter.name), default=parameter.default)

    @wraps(function)
    def run(**values: Any) -> None:
        function_is_called = False
        try:
            arguments = {name: build(values) for name, build in builds.items()}
            function_is_called = True
            if arguments.get("json") is not None:  # of every command a file that is written at the end
                check_writable(arguments["json"])
            function(**arguments)
        except RoomLightError as error:
            message = with_flags(error, options.flags)
            if isinstance(error, OptionError) and not function_is_called:
                raise typer.BadParameter(message) from None
            fail(message)

    run.__signature__ = inspect.Signature(options.parameters)  # pyright: ignore[reportAttributeAccessIssue]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in options.parameters}
    app.command(**facts, help=(inspect.getdoc(function) or "").partition("\n\nArgs:")[0])(run)


def described(thing: Any, section: str) -> dict[str, str]:
    """Return the texts of a docstring's section `Args` or `Attributes`, by name."""
    _, _, rest = (inspect.getdoc(thing) or "").partition(f"{section}:\n")
    texts: dict[str, str] = {}
    for line in rest.splitlines():
        if not line.startswith("    "):
            break
        name, colon, text = line.strip().partition(": ")
        if line[4] != " " and colon:
            texts[name] = text
        else:
            name, before = texts.popitem()
            texts[name] = f"{before} {line.strip()}"
    return texts


@dataclass
class CommandOptions:
    """Options of a command as they are collected.

    Attributes:
        parameters: As typer reads them.
        flags: Flags of the options by the names that messages of the library use.
    """

    parameters: list[inspect.Parameter] = field(default_factory=list[inspect.Parameter])
    flags: dict[str, str] = field(default_factory=dict[str, str])

    def add_dataclass(self, rule: Rule, panel: str) -> Build:
        """Add an option for each field under a heading, and return what builds the dataclass."""
        cls = rule.kind
        left_out = {name for note in rule.notes if isinstance(note, Without) for name in note.names}
        hints, texts = get_type_hints(cls, include_extras=True), described(cls, "Attributes")
        builds: dict[str, Build] = {}
        ordered = sorted(fields(cls), key=lambda member: is_dataclass(Rule.of(hints[member.name]).kind))
        for member in ordered:  # headings of their own come last
            inner = Rule.of(hints[member.name])
            if member.name in left_out:
                continue
            if is_dataclass(inner.kind):
                builds[member.name] = self.add_dataclass(inner, panel=texts[member.name].rstrip("."))
            else:
                default = _REQUIRED if member.default is MISSING else member.default
                builds[member.name] = self.add_option(
                    member.name, inner, texts.get(member.name), default=default, panel=panel
                )
        checks = [note.refuse for note in rule.notes if isinstance(note, Check)]

        def build_dataclass(values: Values) -> Any:
            options = cls(**{name: build(values) for name, build in builds.items()})
            for refuse in checks:
                refuse(options)
            return options

        return build_dataclass

    def add_argument(self, name: str, rule: Rule, text: str | None, *, default: Any = _REQUIRED) -> Build:
        """Add a positional argument."""
        kind, facts = _typer_type(rule)
        return self._add(name, Annotated[kind, typer.Argument(help=_text(name, text, rule), **facts)], default)

    def add_option(
        self,
        name: str,
        rule: Rule,
        text: str | None,
        *,
        default: Any = _REQUIRED,
        panel: str | None = None,
        flag: str | None = None,
        show_default: bool | str = True,
    ) -> Build:
        """Add an option; `flag` replaces the flag that the name gives."""
        kind, facts = _typer_type(rule)
        note = _flag_note(rule)
        flag = flag or note.name
        if flag is None:
            flag = "--" + _UNIT.sub("", name).replace("_", "-")
            flag = flag.removesuffix("s") if get_origin(kind) is list else flag
        if name in self.flags:
            raise ValueError(f"two options have the name {name}")
        self.flags |= {name: flag, flag.removeprefix("--").replace("-", "_"): flag}
        facts |= {"metavar": note.metavar or facts.get("metavar"), "envvar": note.env}
        if (above := rule.bound(Gt)) is not None:  # Typer knows closed ranges alone; `check_options` refuses the values
            below = "" if (high := facts.pop("max")) is None else f"<={high:g}"
            facts["metavar"] = f"{note.metavar or rule.kind.__name__} [{above:g}<x{below}]"
        declared = typer.Option(
            f"{flag}/--no-{flag[2:]}" if kind is bool and default is True else flag,
            help=_text(name, text, rule),
            rich_help_panel=note.panel or panel,
            show_default=show_default if note.env is None else False,
            **facts,
        )
        return self._add(name, Annotated[kind, declared], default)

    def _add(self, name: str, annotation: Any, default: Any) -> Build:
        is_repeatable = get_origin(get_args(annotation)[0]) is list
        if isinstance(default, tuple):  # as it is typed
            default = ",".join(map(str, default)) if default else None
        kind = inspect.Parameter.KEYWORD_ONLY
        self.parameters.append(inspect.Parameter(name, kind, default=default, annotation=annotation))
        if name in _WRITTEN:
            return lambda values: _followed(values[name])
        return lambda values: tuple(values[name] or ()) if is_repeatable else values[name]


def _followed(path: Path | None) -> Path | None:
    """Return where a link leads, also to what is not there yet; other paths as they are."""
    with suppress(OSError):  # a name too long, which is told when it is written
        if path is not None and path.is_symlink():
            return Path(os.path.realpath(path))
    return path


def _flag_note(rule: Rule) -> Flag:
    return next((note for note in rule.notes if isinstance(note, Flag)), Flag())


def _text(name: str, text: str | None, rule: Rule) -> str:
    text = _flag_note(rule).text or text
    if not text:
        raise ValueError(f"the option {name} has no text in a docstring")
    return text


def _typer_type(rule: Rule) -> tuple[Any, dict[str, Any]]:
    """Return the type that typer reads, and what it needs to know besides."""
    kind, parts = rule.kind, get_args(rule.kind)
    if rule.inner is not None:
        if rule.inner.kind is int:
            return str, {"parser": _whole_numbers, "metavar": "N,N,..."}
        if rule.inner.choices:  # typer has no lists of choices
            names = "|".join(rule.inner.choices)
            return list[str], {"parser": partial(_choice, rule=rule.inner), "metavar": f"[{names}]"}
        inner, facts = _typer_type(rule.inner)
        return list[inner], facts
    if get_origin(kind) is tuple:
        kind, facts = str, {"parser": partial(_point, count=len(parts)), "metavar": _POINTS[len(parts)][0]}
    elif any(get_origin(part) is tuple for part in parts):  # a word or a direction
        kind, facts = str, {"parser": _word_or_direction}
    else:
        facts = {"min": rule.bound(Ge), "max": rule.bound(Le)} if kind in (int, float) else {}
    return kind | None if rule.optional else kind, facts


def _point(text: str, count: int) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise typer.BadParameter(f"{_POINTS[count][1]}; got {text!r}")
    return values


def _choice(text: str, rule: Rule) -> str:
    if not rule.allows(text):
        raise typer.BadParameter(f"{text!r} is not {rule.text}")
    return text


def _word_or_direction(text: str) -> str | tuple[float, ...]:
    return _point(text, 3) if "," in text else text


def _whole_numbers(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"whole numbers are separated by commas: 1,4,16; got {text!r}") from None
