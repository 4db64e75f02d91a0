"""Commands are made of dataclasses: flags, help, ranges and errors come from the fields."""

import re
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Annotated, Literal

import pytest
from annotated_types import Ge, Interval
from typer.testing import CliRunner

from present import present
from roomlight.errors import FrameError, OptionError
from roomlight.rules import check_options
from roomlight_cli.commands.serve import FLAGS, app
from roomlight_cli.options import Check, Flag, Without, command_app, described
from roomlight_server.base.settings import ServerSettings

DOCS = Path(__file__).parents[2] / "docs"
CALLS: list[tuple[object, ...]] = []


@dataclass(frozen=True)
class Reading:
    """How files are read.

    Attributes:
        unit_m: Metres per unit.
        hidden: Not for users.
    """

    unit_m: Annotated[float, Interval(ge=0, le=10)] = 0.5
    hidden: int = 7


@dataclass(frozen=True)
class Options:
    """What is made.

    Attributes:
        reading: How to read.
        probes: Light this point,
            in metres.
        counts: Numbers of rows.
        up: A word or a direction.
        quality: The quality.
        layers: Write layers.
        max_frames: At most so many.
        size_m: Longest side.
    """

    reading: Annotated[Reading, Without("hidden")] = field(default_factory=Reading)
    probes: tuple[tuple[float, float, float], ...] = ()
    counts: tuple[int, ...] = (1, 4)
    up: str | tuple[float, float, float] | None = None
    quality: Literal["good", "final"] = "good"
    layers: bool = False
    max_frames: Annotated[int, Ge(1)] | None = None
    size_m: Annotated[float | None, Interval(gt=0, le=5), Flag(metavar="M")] = None

    def __post_init__(self) -> None:
        check_options(self)
        if self.layers and self.quality == "final":
            raise OptionError("layers excludes `quality`='final'")


def _refuse_three(options: Options) -> None:
    if len(options.probes) == 3:
        raise OptionError("probes are three")


def make(
    source: Path,
    options: Annotated[Options, Check(_refuse_three)],
    *,
    out: Path,
    token: Annotated[str | None, Flag(env="MAKE_TOKEN", text="A token.")] = None,
    online: bool = True,
    json: Path | None = None,
) -> None:
    """Make something of a file.

    It takes long.

    Args:
        source: The file.
        options: What to make.
        out: Where it goes.
        online: Ask the network.
        json: Also write it here.
    """
    if source.name == "bad":
        raise FrameError("frame 3: state unit_m, or leave out `max_frames`")
    CALLS.append((source, options, out, token, online, json))


APP = command_app(make)


def run(*arguments: str, **environment: str) -> tuple[int, str]:
    result = CliRunner().invoke(APP, list(arguments), env=environment, terminal_width=200)
    return result.exit_code, " ".join((result.output).replace("│", " ").split())


def made(*arguments: str, **environment: str) -> tuple[object, ...]:
    code, text = run("in", "--out", "there", *arguments, **environment)
    assert code == 0, text
    return CALLS.pop()


def test_without_options_the_defaults_of_the_fields_apply():
    assert made() == (Path("in"), Options(), Path("there"), None, True, None)


def test_values_reach_their_fields():
    _, options, _, token, online, _ = made(
        "--unit", "2", "--probe", "1,2,3", "--probe", "-1,0,0.5", "--counts", "8", "--up", "-z", "--layers",
        "--max-frames", "3", "--no-online", MAKE_TOKEN="secret",
    )  # fmt: skip
    expected = Options(Reading(2.0), ((1.0, 2.0, 3.0), (-1.0, 0.0, 0.5)), (8,), up="-z", layers=True, max_frames=3)
    assert (options, token, online) == (expected, "secret", False)
    assert made("--up", "0,0,-1")[1] == Options(up=(0.0, 0.0, -1.0))


def test_what_a_link_leads_to_is_written_and_figures_can_be(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "later")
    assert made("--out", str(tmp_path / "link"))[2] == (tmp_path / "later").resolve()
    code, text = run("in", "--out", "there", "--json", str(tmp_path))
    assert (code, CALLS) == (1, [])
    assert "is a folder" in text


def test_help_is_that_of_the_docstrings():
    code, text = run("-h")
    assert code == 0
    for words in (
        "Make something of a file. It takes long.", "The file.", "Light this point, in metres.", "A token.",
        "0<=x<=10", "M [0<x<=5] Longest side.", "good|final", "default: 1,4",
        "─ How to read ─", "─ What to make ─", "env var: MAKE_TOKEN",
        "X,Y,Z", "Ask the network.",
    ):  # fmt: skip
        assert words in text
    assert "hidden" not in text
    assert "Args:" not in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--unit", "11"), "'--unit': Input should be less than or equal to 10"),
        (("--size", "0"), "--size is 0.0; it must be above 0 to 5"),
        (("--size", "6"), "--size is 6.0; it must be above 0 to 5"),
        (("--max-frames", "0"), "'--max-frames': Input should be greater than or equal to 1"),
        (("--quality", "best"), "'--quality': Value error, 'best' is not one of 'good', 'final'"),
        (("--probe", "1,2"), "Invalid value for '--probe': a position or direction is X,Y,Z"),
        (("--counts", "1,x"), "Invalid value for '--counts': whole numbers are separated by commas"),
        (("--layers", "--quality", "final"), "--layers excludes --quality='final'"),
        (("--probe", "1,2,3") * 3, "--probe are three"),
        (("--hidden", "3"), "No such option: --hidden"),
    ],
)
def test_a_refused_value_is_a_usage_error_with_its_flag(arguments, message):
    code, text = run("in", "--out", "there", *arguments)
    assert code == 2
    assert message in text


def test_a_missing_option_is_named():
    code, text = run("in")
    assert code == 2
    assert "Missing option '--out'" in text


def test_an_error_of_the_command_is_one_line_with_flags():
    code, text = run("bad", "--out", "there")
    assert code == 1
    assert text == "error: frame 3: state --unit, or leave out --max-frames"


def test_an_option_without_a_text_is_refused():
    def silent(*, out: Path) -> None:
        """Do nothing."""

    with pytest.raises(ValueError, match="the option out has no text"):
        command_app(silent)


def test_two_options_of_one_name_are_refused():
    def twice(options: Options, *, quality: str) -> None:
        """Do nothing.

        Args:
            options: Options.
            quality: Quality.
        """

    with pytest.raises(ValueError, match="two options have the name quality"):
        command_app(twice)


def test_every_setting_of_the_server_is_described():
    texts = described(ServerSettings, "Attributes")
    assert texts.keys() == ServerSettings.model_fields.keys()
    assert {name for names in FLAGS.values() for name in names} <= texts.keys()


def test_help_of_the_server_lists_what_people_set():
    shown = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).output
    assert "ROOMLIGHT_PHONES_FILE" in shown
    assert "ROOMLIGHT_ON_LAN" not in shown


def test_tables_of_fields_in_the_pages_have_every_field():
    marks = [
        mark for page in DOCS.glob("*.md") for mark in re.findall(r"<!-- fields: (\S+)\.(\w+) -->", page.read_text())
    ]
    assert {"SessionRequest", "FrameResult", "Motion"} <= {name for _, name in marks}
    for module, name in marks:
        described_class = getattr(import_module(module), name)
        fields = getattr(described_class, "model_fields", None) or described_class.__dataclass_fields__
        assert described(described_class, "Attributes").keys() == fields.keys(), name


def test_tables_of_options_in_the_pages_are_made_of_docstrings():
    spec = present(spec_from_file_location("option_tables", DOCS / "scripts" / "option_tables.py"))
    assert spec.loader is not None
    tables = module_from_spec(spec)
    spec.loader.exec_module(tables)
    made = {path.name: tables.on_page_markdown(path.read_text()) for path in DOCS.glob("*.md")}
    assert "| `--min-confidence` | 0 to 255 | Drop depth of lower confidence" in made["captures.md"]
    assert "| `--state-interval-s` | 0.1 to 3,600 |" in made["server.md"]
    assert not any("<!-- options" in page for page in made.values())
