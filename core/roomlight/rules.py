"""Rules of options, written as the types of a dataclass's fields: choices as `Literal`, ranges as `annotated_types`.

    @dataclass(frozen=True)
    class Options:
        height: Annotated[int, Interval(ge=16, le=2048)] = 120

        def __post_init__(self) -> None:
            check_options(self)

    Options(height=3)  # OptionError: height is 3; it must be 16 to 2048

The command line makes its options of the same fields.
"""

import math
import types
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Ge, GroupedMetadata, Gt, Le, Lt

from roomlight.errors import OptionError, RoomLightError


@dataclass(frozen=True)
class Rule:
    """What a value may be.

    Attributes:
        kind: The type, without None and without notes; a `Literal` for choices.
        optional: Whether None is allowed.
        notes: What `Annotated` adds to the type.
    """

    kind: Any
    optional: bool = False
    notes: tuple[Any, ...] = ()

    @classmethod
    def of(cls, annotation: Any, notes: Iterable[Any] = ()) -> "Rule":
        """Read a type, which may be `Annotated` and may be a union with None, in either order."""
        collected, optional = [*notes], False
        while True:
            if get_origin(annotation) is Annotated:
                annotation, *more = get_args(annotation)
                collected += more
            elif get_origin(annotation) in (Union, types.UnionType) and type(None) in get_args(annotation):
                rest = [part for part in get_args(annotation) if part is not type(None)]
                annotation, optional = Union[tuple(rest)], True  # noqa: UP007  (a union of a list of types)
            else:
                flat = (part for note in collected for part in (note if isinstance(note, GroupedMetadata) else (note,)))
                return cls(annotation, optional, tuple(flat))

    @property
    def choices(self) -> tuple[Any, ...]:
        """The allowed values; empty if there is no list of them."""
        return get_args(self.kind) if get_origin(self.kind) is Literal else ()

    @property
    def inner(self) -> "Rule | None":
        """The rule of each value of a tuple of any length; None for another type."""
        parts = get_args(self.kind)
        return Rule.of(parts[0]) if get_origin(self.kind) is tuple and parts[-1] is Ellipsis else None

    def bound(self, *kinds: type) -> Any:
        """Return the limit that a note of one of these kinds (`Ge`, `Gt`, `Le`, `Lt`) sets; None without one."""
        for note in self.notes:
            if isinstance(note, kinds):
                return getattr(note, type(note).__name__.lower())
        return None

    def misfit(self, value: Any) -> str:
        """Return what a value of another type should be, e.g. "a whole number"; empty for one that fits."""
        types_and_words = _TYPES.get(self.kind)
        if types_and_words is None or value is None:
            return ""
        allowed, words = types_and_words
        is_number = self.kind in (int, float)
        return "" if isinstance(value, allowed) and not (is_number and isinstance(value, bool)) else words

    def plain(self, value: Any) -> Any:
        """Return an allowed value in the rule's own type: numbers of NumPy as Python's, text as a path."""
        return self.kind(value) if self.kind in _TYPES and value is not None else value

    def allows(self, value: Any) -> bool:
        """Return whether a value obeys the rule. NaN is within no range."""
        if value is None:
            return self.optional
        if self.misfit(value):
            return False
        if (inner := self.inner) is not None:
            return all(inner.allows(item) for item in value)
        low, above, high, below = self.bound(Ge), self.bound(Gt), self.bound(Le), self.bound(Lt)
        return bool(
            (not self.choices or value in self.choices)
            and (low is None or value >= low)
            and (above is None or value > above)
            and (high is None or value <= high)
            and (below is None or value < below)
        )

    @property
    def text(self) -> str:
        """The rule in words, e.g. "16 to 2048"; empty if every value is allowed."""
        if self.inner is not None:
            return self.inner.text
        if self.choices:
            return f"one of {', '.join(map(str, self.choices))}"
        low, above, high, below = self.bound(Ge), self.bound(Gt), self.bound(Le), self.bound(Lt)
        lower = f"{low:,g}" if low is not None else f"above {above:g}" if above is not None else ""
        upper = f"{high:,g}" if high is not None else f"below {below:g}" if below is not None else ""
        if lower and upper:
            return f"{lower} {'to' if high is not None else 'and'} {upper}"
        return f"{lower} or more" if low is not None else f"{upper} or less" if high is not None else lower or upper


_TYPES: Final[dict[Any, tuple[tuple[type, ...], str]]] = {
    int: ((Integral,), "a whole number"),
    float: ((Real,), "a number"),
    str: ((str,), "text"),
    bool: ((bool, np.bool_), "True or False"),
    Path: ((str, Path), "a path"),
}


@cache
def rules_of(options: type) -> dict[str, Rule]:
    """Return the rules of a dataclass's fields, by name."""
    hints = get_type_hints(options, include_extras=True)
    return {field.name: Rule.of(hints[field.name]) for field in fields(options)}


def is_finite(value: Any) -> bool:
    """Return whether a value is a finite number; text and booleans are none."""
    try:
        return math.isfinite(value) and not isinstance(value, bool | np.bool_)
    except (TypeError, ValueError, OverflowError):
        return False


def check_type(value: object, expected: type, name: str, error: type[RoomLightError] = OptionError) -> None:
    """Raise the error, which names value and type, for a value of another type."""
    if not isinstance(value, expected):
        raise error(f"{name} is of the type {type(value).__name__}; it must be {expected.__name__}")


def check_options(options: Any) -> None:
    """Refuse a dataclass whose values break the rules that its fields' types state; others get their plain types.

    Raises:
        OptionError: The first such field, its value and the rule.
    """
    for name, rule in rules_of(type(options)).items():
        value = getattr(options, name)
        if not rule.allows(value):
            raise OptionError(f"{name} is {value!r}; it must be {rule.misfit(value) or rule.text}")
        object.__setattr__(options, name, rule.plain(value))
