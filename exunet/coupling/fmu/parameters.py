"""The parameters of an FMU: numbers of the case that a study of a design varies.

They are keys that the case has, with a number or three, in the tables that `_STUDIED` names. None of them
changes how many nodes, elements or bodies there are. A value that differs from the case's is an override.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo

from exunet.base.record import Record
from exunet.coupling.fmu.variables import AXES, Variable, structured, unit_in
from exunet.scene.scene import Scene

_NAME = r"[^.]+"
_STUDIED = re.compile(
    "|".join(
        (
            rf"launch\.{_NAME}",
            rf"net\.(cable|strings|border)\.{_NAME}",
            r"net\.bullets\.mass",
            r"initial\.(packing|velocity|spin)",
            rf"bodies\.{_NAME}\.(mass|density|inertia|position|velocity|angular_velocity|angle)",
            rf"tethers\.{_NAME}\.{_NAME}",
            rf"tethers\.{_NAME}\.reel\.{_NAME}",
            rf"tethers\.{_NAME}\.reel\.commands\[\d+\]\.{_NAME}",
            rf"effects\.{_NAME}\.{_NAME}",
        )
    )
)
# A port starts where its inputs say.
_OF_PORTS = ("position", "velocity", "angular_velocity", "angle")
STIFFNESS = "stiffness_factor"
_STIFFNESS = Variable(
    STIFFNESS, "parameter", "by which every Young's modulus is multiplied; greater than 0", 1.0, low=0.0
)


@dataclass(frozen=True)
class _Key:
    """Where the value of a parameter stands in the case.

    path      : of the key, as an override names it
    component : of a vector; None: the key is one number
    row, field : of a list of tables, as the commands of a reel are
    """

    path: str
    component: int | None = None
    row: int | None = None
    field: str = ""


class Parameters:
    """The parameters that a scene has.

    variables : in a fixed order, the stiffness factor last
    """

    def __init__(self, scene: Scene) -> None:
        found = [
            (name, value, info, key)
            for name, value, info, key in _numbers(scene)
            if _STUDIED.fullmatch(name) and not _is_of_port(name, scene)
        ]
        self._scene = scene
        self._keys: list[_Key] = []
        variables = []
        for name, value, info, key in found:
            low, high = _bounds(info)
            words = info.description or name
            if any(isinstance(limit, Gt) for limit in _limits(info)):
                words += "; greater than 0" if low == 0.0 else f"; greater than {low:g}"
            many = isinstance(value, tuple)
            for k, one in enumerate(value if many else (value,)):
                self._keys.append(_Key(key.path, k if many else None, key.row, key.field))
                shown = f"case.{structured(name)}" + (f".{AXES[k]}" if many else "")
                text = words + (f", {AXES[k]}" if many else "")
                variables.append(Variable(shown, "parameter", text, one, unit_in(words), low, high))
        self.variables: tuple[Variable, ...] = (*variables, _STIFFNESS)

    def overrides(self, values: Sequence[float]) -> list[str]:
        """What is to be replaced in the case, for values in the order of the variables."""
        *own, factor = values
        changed: dict[str, Any] = {}
        for key, variable, value in zip(self._keys, self.variables, own, strict=False):
            if factor != 1.0 and key.path.endswith(".youngs_modulus"):
                value *= factor
            if value == variable.start:
                continue
            if key.row is not None:
                rows = changed.setdefault(key.path, self._rows(key.path))
                rows[key.row][key.field] = value
            elif key.component is not None:
                changed.setdefault(key.path, list(self._at(key.path)))[key.component] = value
            else:
                changed[key.path] = value
        return [f"{path}={_toml(value)}" for path, value in changed.items()]

    def _at(self, path: str) -> Any:
        found: Any = self._scene
        for name in path.split("."):
            found = found[name] if isinstance(found, Mapping) else getattr(found, name)
        return found

    def _rows(self, path: str) -> list[dict[str, Any]]:
        return [row.model_dump(exclude_none=True) for row in self._at(path)]


def _is_of_port(name: str, scene: Scene) -> bool:
    table, body, *rest = name.split(".")
    return table == "bodies" and scene.bodies[body].motion == "port" and rest[0] in _OF_PORTS


Found = tuple[str, Any, FieldInfo, _Key]


def _numbers(table: Record, above: str = "", row: _Key | None = None) -> Iterator[Found]:
    """Every number and vector of a table and those in it: its name, its value, its field, where it stands."""
    for name, info in type(table).model_fields.items():
        value = getattr(table, name)
        full = f"{above}{name}"
        key = _Key(full) if row is None else _Key(row.path, None, row.row, name)
        if isinstance(value, Record):
            yield from _numbers(value, f"{full}.", row)
        elif isinstance(value, Mapping):
            for own, one in value.items():
                if isinstance(one, Record):
                    yield from _numbers(one, f"{full}.{own}.", row)
        elif isinstance(value, float) or (
            isinstance(value, tuple) and len(value) == 3 and all(isinstance(item, float) for item in value)
        ):
            yield full, value, info, key
        elif isinstance(value, tuple):
            for k, one in enumerate(value):
                if isinstance(one, Record):
                    yield from _numbers(one, f"{full}[{k}].", _Key(full, None, k))


def _limits(info: FieldInfo) -> Iterator[Any]:
    """The limits of a field, those of an optional one too, and of the components of a vector."""
    yield from info.metadata
    waiting = [info.annotation]
    while waiting:
        for arg in get_args(waiting.pop()):
            if isinstance(arg, FieldInfo):
                yield from arg.metadata
            elif isinstance(arg, Ge | Gt | Le | Lt):
                yield arg
            else:
                waiting.append(arg)


def _bounds(info: FieldInfo) -> tuple[float | None, float | None]:
    low = high = None
    for limit in _limits(info):
        if isinstance(limit, Gt | Ge):
            low = float(getattr(limit, "gt", getattr(limit, "ge", None)))  # type: ignore[arg-type]
        elif isinstance(limit, Lt | Le):
            high = float(getattr(limit, "lt", getattr(limit, "le", None)))  # type: ignore[arg-type]
    return low, high


def _toml(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }"
    return json.dumps(value) if isinstance(value, str) else repr(value)
