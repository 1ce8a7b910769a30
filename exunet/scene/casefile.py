"""Case files: a scene with its file, text and overrides, where its faults and warnings stand."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from exunet.base.arguments import shown
from exunet.base.errors import CaseError, CaseWarning, Fault, InputError
from exunet.base.files import path_of
from exunet.base.key_path import KeyPath, dotted, leaves
from exunet.base.record import unlocated
from exunet.base.validation import AnyRecord, Located, validated_record
from exunet.scene import plausibility
from exunet.scene.document import FILES_OF_NET, Override, located, overridden, parse, read_text
from exunet.scene.scene import Scene, parse_scene

REALISTIC = 1e50  # no quantity of a net is larger in SI units, or smaller than its inverse


@dataclass(frozen=True)
class Case:
    """A case that was read and found valid.

    scene     : what is simulated
    path      : the file
    text      : its text, exactly
    overrides : the "key.path=value" that were applied to it, in order
    is_file   : False for a scene from Python, in whose errors lines would say nothing
    """

    scene: Scene
    path: Path
    text: str = field(repr=False)
    overrides: tuple[str, ...] = ()
    is_file: bool = True

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem.strip(".") or "case"


def load(path: str | Path, overrides: Sequence[str] = ()) -> Case:
    """Read a case file, apply overrides, and validate it.

    An override is "key.path=value": the value is TOML, or a bare word as a string; an empty value removes the
    key or table. A key path has names of tables and indexes of items from 0, as in "script[2].force"; an
    index counts tables with chosen names, such as bodies, in their order. Raises InputError if the file
    cannot be read, and CaseError with all faults if it is not a valid case. Warns (CaseWarning) of keys that
    an override of a whole table drops, and of numbered nodes that an override of the net moves.
    """
    path = path_of(path, "load")
    refuse_other_overrides(overrides, "load")
    case = parse_case(read_text(path), path, overrides)
    with suppress(CaseError):  # numbers that overflow: an error of the preparation
        for fault in _override_warnings(case) if overrides else ():
            warnings.warn(str(fault), CaseWarning, stacklevel=2)
    return case


def refuse_other_overrides(overrides: object, what: str) -> None:
    """Raise InputError, which begins with `what`, for overrides that are no list."""
    if isinstance(overrides, str) or not isinstance(overrides, Sequence):
        raise InputError(f'{what}: overrides are a list of "key.path=value", got {shown(overrides)}')


def parse_case(text: str, path: Path, overrides: Sequence[str] = ()) -> Case:
    """As `load`, of a text that is, or was, that of the file `path`."""
    return Case(parse_scene(text, path, overrides), path, text, tuple(overrides))


def parse_record(text: str, path: Path, kind: type[AnyRecord], more: dict[str, Any]) -> AnyRecord:
    """Return the record of a text that is not a case; raises CaseError with the line of each fault.

    more : keys that replace those of the text
    """
    record, found = validated_record(parse(text, path) | more, kind)
    if record is None:
        raise CaseError(located(found, text, path, []))
    return record


def files_of(scene: Scene) -> dict[str, str]:
    """Return the files that a scene reads by their keys, but for a result that it starts from."""
    found = {f"bodies.{name}.file": keys.file for name, keys in scene.bodies.items()}
    found |= {f"net.{key}": getattr(scene.net, key, None) for key in FILES_OF_NET}
    return {key: file for key, file in found.items() if file is not None}


def place_of_override(option: str) -> str:
    """Return the `place` of faults of an override."""
    return Override(option, ()).place


def case_of(case: str | Path | Case | Scene, what: str, overrides: Sequence[str] = ()) -> Case:
    """Return a case that is given in any form, with overrides; errors begin with `what`.

    The text of a scene is its TOML, of a file "scene.toml" in the current folder.
    """
    refuse_other_overrides(overrides, what)
    if isinstance(case, Scene):
        path = Path.cwd() / "scene.toml"
        case = Case(case, path, case.text(path.parent), is_file=False)
    if isinstance(case, Case):
        return parse_case(case.text, case.path, [*case.overrides, *overrides]) if overrides else case
    return load(path_of(case, what), overrides)


def implausible(case: Case) -> list[Fault]:
    """Return what is implausible in a case, each with its place in the file or the overrides."""
    changes = overridden(case.text, case.path, case.overrides, Scene)[1]
    found: list[Located] = [(fault.paths, fault.reason) for fault in plausibility.warnings(case.scene)]
    return located(found, case.text, case.path, changes)


def _override_warnings(case: Case) -> list[Fault]:
    """Return the side effects of overrides: keys that they drop, numbered nodes that they move."""
    changes = overridden(case.text, case.path, case.overrides, Scene)[1]
    found = [
        change.fault(
            f"replaces the table {dotted(change.path)} and drops {', '.join(change.dropped)}"
            if isinstance(change.value, dict)
            else f"replaces {change.dropped[0]}"
        )
        for change in changes
        if change.dropped
    ]
    of_net = [change for change in changes if change.path[0] == "net"]
    moved: list[Fault] = []
    if of_net:
        with suppress(CaseError):  # a text that is valid with its overrides only
            moved += plausibility.moved_nodes(parse_scene(case.text, case.path), case.scene)
    given = [change.path for change in changes]
    new = [fault for fault in moved if not any(fault.path[: len(path)] == path for path in given)]
    return [*found, *(replace(fault, place=of_net[-1].place) for fault in new)]


@contextmanager
def located_faults(case: Case) -> Iterator[None]:
    """Give the faults of a CaseError from inside the block their place in the case's file or overrides.

    Where numbers overflow, unrealistic values are named as the cause, if there are any.
    """
    try:
        yield
    except CaseError as error:
        if any(fault.place for fault in error.faults):
            raise
        beyond = [fault for fault in error.faults if fault.beyond_floats]
        extreme = list(_extreme(case.scene)) if beyond else []
        others = [fault for fault in error.faults if not (extreme and fault.beyond_floats)]
        found: list[Located] = [(fault.paths, fault.reason) for fault in others]
        words = next((f"{fault.key}: {fault.reason}" for fault in beyond), "")
        found += [((path,), f"{value:g} is not realistic ({words})") for path, value in extreme]
        if not case.is_file:
            raise unlocated(found) from None
        changes = overridden(case.text, case.path, case.overrides, Scene)[1]
        raise CaseError(located(found, case.text, case.path, changes)) from None


def _extreme(scene: Scene) -> Iterator[tuple[KeyPath, float]]:
    """The numbers of a scene above `REALISTIC` or below its inverse, each with its key."""
    tables = ("time", "net", "initial", "launch", "bodies", "tethers", "effects")
    for path, value in leaves(scene.model_dump(include=set(tables))):
        if isinstance(value, float) and value and abs(math.log10(abs(value))) > math.log10(REALISTIC):
            yield path, value
