"""Dataclasses, lists, tuples, dictionaries, arrays and numbers as records, and back by their types."""

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from roomlight.engine.models.interface import Arrays
from roomlight.engine.state.records import Record, array_records, arrays_of
from roomlight.errors import RoomLightError, StateError

_T = TypeVar("_T")


def records_of_values(values: Any, tag: str) -> list[Record]:
    """Return a dataclass as a record of this tag, and its arrays as records of theirs."""
    arrays: Arrays = {}

    def plain(value: Any, path: str) -> Any:
        if isinstance(value, np.ndarray):
            arrays[path] = value
            return path
        if is_dataclass(value):
            return {item.name: plain(getattr(value, item.name), f"{path}/{item.name}") for item in fields(value)}
        if isinstance(value, Mapping):
            return {str(key): plain(item, f"{path}/{key}") for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item, f"{path}/{number}") for number, item in enumerate(value)]
        return value

    return [Record(tag, plain(values, tag)), *array_records(arrays)]


def values_of_records(kind: type[_T], records: Iterable[Record], tag: str, source: str) -> _T:
    """Return the dataclass of `kind` among the records of a file.

    Raises:
        StateError: There is none of this tag, or its values do not fit `kind`.
    """
    records = list(records)
    values = [record.values for record in records if record.tag == tag]
    if len(values) != 1:
        raise StateError(f"{source}: holds {len(values)} records {tag} instead of one")
    try:
        return _built(kind, values[0], arrays_of(records, source))
    except (KeyError, TypeError, ValueError, RoomLightError) as error:
        raise StateError(f"{source}: its values do not fit each other ({error!r})") from error


def _built(kind: Any, value: Any, arrays: Arrays) -> Any:
    origin, parts = get_origin(kind), get_args(kind)
    if value is None:
        return None
    if origin in (Union, UnionType):
        return _built(next(part for part in parts if part is not type(None)), value, arrays)
    if is_dataclass(kind):
        hints, of_kind = get_type_hints(kind), cast(Any, kind)
        return of_kind(**{item.name: _built(hints[item.name], value[item.name], arrays) for item in fields(kind)})
    if origin is dict:
        return {parts[0](key): _built(parts[1], item, arrays) for key, item in value.items()}
    if origin is list:
        return [_built(parts[0], item, arrays) for item in value]
    if origin is tuple:
        kinds = parts if parts[-1] is not ... else parts[:1] * len(value)
        return tuple(_built(part, item, arrays) for part, item in zip(kinds, value, strict=True))
    return value if kind in (int, float, str, bool, Any) else arrays[value]
