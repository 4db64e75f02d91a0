"""Rules of options are their types."""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from annotated_types import Ge, Gt, Interval, Le, Lt

from roomlight.captures import CaptureOptions
from roomlight.errors import OptionError
from roomlight.rules import Rule, check_options, is_finite, rules_of

TO_9: Any = Annotated[int, Le(9)]
FROM_1: Any = Annotated[int, Ge(1)]


@dataclass(frozen=True)
class Options:
    height: Annotated[int, Interval(ge=16, le=2048)] = 120
    fps: Annotated[float, Gt(0), Lt(100)] | None = None
    quality: Literal["good", "final"] = "good"
    counts: tuple[Annotated[int, Ge(1)], ...] = ()
    folder: Path | None = None

    def __post_init__(self) -> None:
        check_options(self)


def test_text_and_booleans_are_no_numbers():
    assert all(map(is_finite, (0, -1.5, np.float16(2), np.array(3.0))))
    assert not any(map(is_finite, ("0", None, True, np.bool_(1), math.nan, math.inf, 10**999, 1j, [1.0])))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"height": 15}, "height is 15; it must be 16 to 2,048"),
        ({"height": 2049}, "height is 2049; it must be 16 to 2,048"),
        ({"fps": 0.0}, "fps is 0.0; it must be above 0 and below 100"),
        ({"fps": math.nan}, "fps is nan; it must be above 0 and below 100"),
        ({"quality": "best"}, "quality is 'best'; it must be one of good, final"),
        ({"counts": (1, 0)}, "counts is (1, 0); it must be 1 or more"),
        ({"height": 16.0}, "height is 16.0; it must be a whole number"),
        ({"height": True}, "height is True; it must be a whole number"),
        ({"height": "64"}, "height is '64'; it must be a whole number"),
        ({"fps": "8"}, "fps is '8'; it must be a number"),
        ({"folder": 3}, "folder is 3; it must be a path"),
    ],
)
def test_a_value_outside_its_rule_is_refused(changed, message):
    with pytest.raises(OptionError) as refused:
        Options(**changed)
    assert str(refused.value) == message


@pytest.mark.parametrize(
    ("annotation", "text"),
    [
        (Annotated[int, Ge(1)], "1 or more"),
        (TO_9 | None, "9 or less"),
        (Annotated[float | None, Gt(0)], "above 0"),
        (Annotated[float, Lt(2)], "below 2"),
        (float, ""),
    ],
)
def test_rules_in_words(annotation, text):
    assert Rule.of(annotation).text == text


def test_values_at_the_limits_are_accepted_and_none_where_the_type_says_so():
    assert Options(height=16, fps=99.9, quality="final", counts=(1, 1000)) is not None
    assert Options(height=2048, fps=None, folder=Path("x")) is not None
    assert not Rule.of(Annotated[int, Ge(1)]).allows(None)
    assert Rule.of(Annotated[int | None, Ge(1)]).allows(None)
    assert Rule.of(FROM_1 | None).allows(None)


def test_every_field_has_a_rule():
    assert rules_of(CaptureOptions).keys() == {field.name for field in fields(CaptureOptions)}


def test_values_get_the_types_of_their_fields() -> None:
    options = Options(height=np.int64(64), fps=np.float32(8), folder="rooms")  # type: ignore[arg-type]
    assert (type(options.height), type(options.fps), options.folder) == (int, float, Path("rooms"))
