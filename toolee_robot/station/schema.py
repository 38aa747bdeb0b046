"""Types of a station file's fields, checked when it is loaded, and what its records say of them, for documents."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, Field

from toolee_robot.runtime.yaml_files import name_in_file
from toolee_robot.types.units import Metres, Number, Radians, RadiansPerSecond, RadiansPerSecond2, Unit

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Pydantic configuration of every record: an unknown field, NaN or infinity is an error."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Place = Annotated[float, Metres(-10.0, 10.0, "from the base; a UR10 reaches 1.3 m")]
Point = tuple[Place, Place, Place]
"""A point in the station."""
Extent = Annotated[float, Metres(0.005, 10.0)]
"""Edge length of a box."""
JointAngle = Annotated[float, Radians(-6.2832, 6.2832, "joints turn by a whole turn to each side")]
JointAngles = tuple[JointAngle, JointAngle, JointAngle, JointAngle, JointAngle, JointAngle]
"""Of the six joints, base to wrist 3."""
JointSpeed = Annotated[float, RadiansPerSecond(0.01, 3.5, "data sheet of the UR10: 2.09 and 3.14")]
JointSpeeds = tuple[JointSpeed, JointSpeed, JointSpeed, JointSpeed, JointSpeed, JointSpeed]
"""Of the six joints, base to wrist 3."""
JointAcceleration = Annotated[float, RadiansPerSecond2(0.5, 100.0, "the large joints' torques give some 30")]
JointAccelerations = tuple[
    JointAcceleration, JointAcceleration, JointAcceleration, JointAcceleration, JointAcceleration, JointAcceleration
]
"""Likewise."""
Shank = Annotated[float, Metres(0.0005, 0.02, "nails are 0.8 to 8 mm thick")]
ShankLength = Annotated[float, Metres(0.005, 0.4)]
NailHead = Annotated[float, Metres(0.0005, 0.05)]
Protrusion = Annotated[float, Metres(0.0005, 0.4)]
Hole = Annotated[float, Metres(0.0, 0.02, "0 for none")]
Slope = Annotated[float, Number(-10.0, 10.0, "metres per metre, 0.0175 for 1 degree")]
Gravity = Annotated[float, Number(0.05, 1.4, "balsa 0.1, lignum vitae 1.3")]
"""Specific gravity of a wood."""


ANY_NUMBER = -1
"""`StationField.numbers` of a list of any length."""


@dataclass(frozen=True)
class StationField:
    """One field of a record.

    Attributes:
        path: Sections and name in the file, such as ("work", "nail_xy"); a list's section ends in [].
        hint: Its type.
        text: What it is: its docstring, on one line.
        default: Its default; MISSING where it has none.
    """

    path: tuple[str, ...]
    hint: Any
    text: str
    default: Any

    @property
    def name(self) -> str:
        """Its name, such as work.nail_xy."""
        return ".".join(self.path)

    @property
    def optional(self) -> bool:
        """Whether null is a value of it."""
        return NoneType in get_args(self.hint)

    @property
    def unit(self) -> Unit | None:
        """Unit and range of its numbers; None for another kind of value."""
        return _unit(self.hint)

    @property
    def numbers(self) -> int:
        """How many numbers it lists; 0 for a single value."""
        hint = _without_null(self.hint)
        if get_origin(hint) is not tuple:
            return 0
        return ANY_NUMBER if Ellipsis in get_args(hint) else len(get_args(hint))

    @property
    def choices(self) -> tuple[str, ...]:
        """The values of one of several; empty for another kind."""
        hint = _without_null(self.hint)
        return tuple(str(member.value) for member in hint) if inspect.isclass(hint) and issubclass(hint, Enum) else ()

    @property
    def kind(self) -> str:
        """What a value looks like, in words, such as `3 numbers, -10 to 10 m`."""
        hint = _without_null(self.hint)
        unit = f", {self.unit.range}" if self.unit is not None else ""
        if self.choices:
            words = ", ".join(self.choices)
        elif self.numbers:
            words = f"{'several' if self.numbers == ANY_NUMBER else self.numbers} numbers{unit}"
        elif get_origin(hint) is Annotated and self.unit is not None:
            words = ("whole number" if get_args(hint)[0] is int else "number") + unit
        else:
            words = {bool: "true or false"}.get(hint, "text")
        return f"{words}, or null" if self.optional else words


def _without_null(hint: Any) -> Any:
    kinds = [kind for kind in get_args(hint) if kind is not NoneType]
    return kinds[0] if NoneType in get_args(hint) else hint


def _unit(hint: Any) -> Unit | None:
    if get_origin(hint) is Annotated:
        return next((part for part in get_args(hint)[1:] if isinstance(part, Unit)), None)
    return next((unit for part in get_args(hint) if (unit := _unit(part)) is not None), None)


def record_in(hint: Any) -> type[Any] | None:
    """Find the record that a field holds.

    Args:
        hint: The field's type.

    Returns:
        The dataclass, also of a list of them or where null may stand instead; None for another kind of field.
    """
    return next((kind for kind in (hint, *get_args(hint)) if inspect.isclass(kind) and is_dataclass(kind)), None)


def record_fields(record: type[Any], path: tuple[str, ...] = ()) -> tuple[StationField, ...]:
    """List a record's fields that a file may give, and those of the records in it.

    Args:
        record: The dataclass.
        path: The sections that lead to it.

    Returns:
        The fields, in the order of the source: of each record its own before those of the records in it.
    """
    hints, docs = get_type_hints(record, include_extras=True), field_docs(record)
    own: list[StationField] = []
    inner: list[StationField] = []
    for field in fields(record):
        hint, name = hints[field.name], name_in_file(field)
        if (held := record_in(hint)) is not None:
            listed = "[]" if get_origin(hint) is tuple else ""
            inner += record_fields(held, (*path, name + listed))
        elif name:
            own.append(StationField((*path, name), hint, docs.get(field.name, ""), field.default))
    return (*own, *inner)


def without_blanks(data: Mapping[str, Any], record: type[Any]) -> dict[str, Any]:
    """Leave out fields without a value, as a template has them, of which null is no value.

    Args:
        data: What a file holds of a record.
        record: The record.

    Returns:
        The fields with a value, or with null where that is one.
    """
    hints = get_type_hints(record, include_extras=True)
    kinds = {name_in_file(field): hints[field.name] for field in fields(record)}
    given = {}
    for name, value in data.items():
        hint = kinds.get(name, Any)
        if value is None and hint is not Any and NoneType not in get_args(hint):
            continue
        held = record_in(hint)
        if held is not None and isinstance(value, dict) and value:
            value = without_blanks(value, held)
            if not value:
                continue
        given[name] = value
    return given


_KNOWN: dict[type[Any], Mapping[str, str]] = {}
"""To parse a source takes milliseconds."""


def field_docs(record: type[Any]) -> Mapping[str, str]:
    """Description of each field of a dataclass that has one: the docstring after it.

    Args:
        record: The dataclass.

    Returns:
        The descriptions by the fields' names, each on one line.
    """
    if record in _KNOWN:
        return _KNOWN[record]
    body = ast.parse(textwrap.dedent(inspect.getsource(record))).body[0]
    assert isinstance(body, ast.ClassDef)
    docs: dict[str, str] = {}
    for statement, following in zip(body.body, [*body.body[1:], None], strict=True):
        if not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)):
            continue
        if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
            docs[statement.target.id] = " ".join(str(following.value.value).split())
    return _KNOWN.setdefault(record, docs)


def required(record: type[Any]) -> Iterator[str]:
    """Name the fields of a record without a default.

    Args:
        record: The dataclass.

    Yields:
        Their names.
    """
    for field in fields(record):
        if field.default is MISSING and field.default_factory is MISSING:
            yield field.name
