"""The checker of annotations in the test run: beartype, made for a function at its first call.

jaxtyping's own wrapper binds the arguments and checks them twice in each call, for longer messages: a third of the
processor time of the engine's tests, and a fifth of a worker's start. It is used where sizes are those of arguments
(`"{height} 2*{height} 3"`), and for generators.

Only a function's first calls in a process are checked. Those that follow, a sixth of the run's time, would hardly ever
show an error that the first did not.
"""

import dataclasses
import functools
import inspect
import types
from collections.abc import Callable
from typing import Any, Final, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import TypeCheckError, jaxtyped

CHECKED_CALLS: Final = 50
_by_beartype = beartype(conf=BeartypeConf(violation_type=TypeCheckError))


def checked(decorated: Any) -> Any:
    """Return a function with its annotations checked, or a data class whose fields are."""
    if inspect.isclass(decorated):
        made = vars(decorated).get("__init__")
        if dataclasses.is_dataclass(decorated) and made is not None and not hasattr(made, "__wrapped__"):
            decorated.__init__ = checked(made)
        return decorated
    return _checked_when_called(decorated) if decorated.__annotations__ else decorated


def _checked_when_called(function: types.FunctionType) -> Callable[..., Any]:
    check: Callable[..., Any] | None = None
    calls = 0

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        nonlocal check, calls
        if calls == CHECKED_CALLS:
            return function(*args, **kwargs)
        calls += 1
        if check is None:
            check = _checker(function)
        with jaxtyped("context"):
            return check(*args, **kwargs)

    return wrapper


def _checker(function: types.FunctionType) -> Callable[..., Any]:
    if inspect.isgeneratorfunction(function) or "{" in str([*function.__annotations__.values()]):
        return jaxtyped(function, typechecker=_by_beartype)
    copy = types.FunctionType(
        function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    )
    functools.update_wrapper(copy, function)
    del copy.__wrapped__  # type: ignore[attr-defined]
    copy.__kwdefaults__ = function.__kwdefaults__
    copy.__annotations__ = {name: _resolved(hint, function) for name, hint in function.__annotations__.items()}
    return _by_beartype(copy)


def _resolved(hint: Any, function: types.FunctionType) -> Any:
    """Return a hint without names in quotes; any value will do where one is known to type checkers alone."""
    try:
        return get_type_hints(types.SimpleNamespace(__annotations__={"hint": hint}), function.__globals__, None, True)[
            "hint"
        ]
    except (NameError, AttributeError):
        return Any
