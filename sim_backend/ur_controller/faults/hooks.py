"""Hooks of the fault port: methods with validated arguments, called by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

from pydantic import ConfigDict, Field, ValidationError, validate_call

from toolee_robot.errors import TooleeError

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Seconds = Annotated[float, Field(ge=0.0, le=3600.0)]
Count = Annotated[int, Field(ge=0)]
Three = Annotated[list[Number], Field(min_length=3, max_length=3)]
Six = Annotated[list[Number], Field(min_length=6, max_length=6)]
Method = Callable[..., dict[str, Any] | None]
Hook = Callable[[dict[str, Any]], dict[str, Any]]
"""Converts arguments to an answer; never raises."""


def hook(method: Method) -> Method:
    """Decorator that makes a method of a `HookGroup` a hook."""
    checked: Method = validate_call(config=ConfigDict(arbitrary_types_allowed=True))(method)
    checked.is_hook = True  # type: ignore[attr-defined]
    return checked


class HookGroup:
    """A group of related hooks."""

    def hooks(self) -> dict[str, Hook]:
        """The group's hooks, by name."""
        methods = vars(type(self))
        return {name: partial(_call, self, f) for name, f in methods.items() if getattr(f, "is_hook", False)}

    def step(self) -> None:
        """End the faults whose duration is over; called once per tick."""

    def end(self) -> None:
        """End all faults of the group."""


def _call(group: HookGroup, method: Method, arguments: dict[str, Any]) -> dict[str, Any]:
    name = method.__name__
    try:
        inspect.signature(method).bind(group, **arguments)
        return {"ok": True, **(method(group, **arguments) or {})}
    except ValidationError as error:
        first = error.errors()[0]
        return {"ok": False, "error": f"{name}: {'.'.join(str(part) for part in first['loc'])}: {first['msg']}"}
    except (TypeError, TooleeError) as error:
        return {"ok": False, "error": f"{name}: {error}"}
