"""Case files: TOML text to a Scene, with every fault at once as file:line: key: reason."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exunet.base.arguments import shown
from exunet.base.errors import CaseError, Fault, InputError, KeyPath
from exunet.base.files import path_of
from exunet.scene.scene import Scene
from exunet.scene.toml_text import key_lines, syntax_error
from exunet.scene.validation import Located, validated

MAX_BYTES = 10_000_000
MAX_FAULTS = 100  # more than anyone reads
REALISTIC = 1e50  # no quantity of a net is larger in SI units, or smaller than its inverse
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Case:
    """A case that was read and found valid.

    scene     : what is simulated
    path      : the file
    text      : its text, exactly
    overrides : the "key.path=value" that were applied to it, in order
    """

    scene: Scene
    path: Path
    text: str = field(repr=False)
    overrides: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The file's name without its ending."""
        return self.path.stem.strip(".") or "case"


def load(path: str | Path, overrides: Sequence[str] = ()) -> Case:
    """Read a case file, apply overrides, and validate it.

    An override is "key.path=value": the value is TOML, or a bare word as a string; an empty value removes the
    key or table. Raises InputError if the file cannot be read, and CaseError with all faults if it is not a
    valid case.
    """
    path = path_of(path, "load")
    refuse_other_overrides(overrides, "load")
    return parse_case(_decode(_read(path), path), path, overrides)


def refuse_other_overrides(overrides: object, what: str) -> None:
    """Raise InputError, which begins with `what`, for overrides that are no list."""
    if isinstance(overrides, str) or not isinstance(overrides, Sequence):
        raise InputError(f'{what}: overrides are a list of "key.path=value", got {shown(overrides)}')


def parse_case(text: str, path: Path, overrides: Sequence[str] = ()) -> Case:
    """As `load`, of a text that is, or was, that of the file `path`."""
    document = _parse(text, path)
    changes = _parse_overrides(overrides)
    _apply(changes, document)
    _place_files(document, path.parent)
    huge = _take_huge_integers(document)
    scene, found = validated(document)
    found = [fault for fault in found if not set(fault[0]) & set(huge)]
    found += [((place,), "is outside the 64-bit whole numbers of TOML") for place in huge]
    if found or scene is None:
        raise CaseError(_located(found, text, path, changes))
    return Case(scene, path, text, tuple(overrides))


# Reading


def _read(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder, not a case file")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not an ordinary file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(f"{path}: has {size:,} bytes; a case file has at most {MAX_BYTES:,}")
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be read: {reason}") from None


def _decode(content: bytes, path: Path) -> str:
    if not content.strip():
        raise CaseError([Fault("", "the file is empty", place=f"{path}:1")])
    if content.startswith(b"\xef\xbb\xbf"):
        reason = "begins with a byte order mark; save it as UTF-8 without one"
        raise CaseError([Fault("", reason, place=f"{path}:1")])
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        reason = f"byte 0x{content[error.start]:02x} is not UTF-8; save the file as UTF-8"
        raise CaseError([Fault("", reason, place=f"{path}:{line}")]) from None


def _parse(text: str, path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise CaseError([Fault("", "values are nested too deeply", place=str(path))]) from None
    except ValueError as error:  # tomllib.TOMLDecodeError, and whole numbers of thousands of digits
        message, line = syntax_error(str(error), text)
        place = f"{path}:{line}" if line else str(path)
        raise CaseError([Fault("", f"not valid TOML: {message}", place=place)]) from None


def _place_files(document: dict[str, Any], folder: Path) -> None:
    """Let the names of files, meshes and a result to start from, be relative to the folder of the case."""
    initial = document.get("initial")
    if isinstance(initial, dict) and isinstance(initial.get("restart"), str) and initial["restart"]:
        initial["restart"] = str(folder / initial["restart"])
    bodies = document.get("bodies")
    for body in bodies.values() if isinstance(bodies, dict) else ():
        if isinstance(body, dict) and isinstance(body.get("file"), str) and body["file"]:
            body["file"] = str(folder / body["file"])


# Overrides


@dataclass(frozen=True)
class _Override:
    """One override: set the key at `path` to `value`, or remove it."""

    option: str
    path: tuple[str, ...]
    value: Any = None
    removes: bool = False

    @property
    def place(self) -> str:
        option = " ".join(self.option.split())
        return "--set " + (option if len(option) <= 60 else option[:57] + "...")

    def fault(self, reason: str) -> Fault:
        return Fault("", reason, place=self.place)


def _parse_overrides(overrides: Sequence[str]) -> list[_Override]:
    changes, faults = [], []
    for option in overrides:
        if not isinstance(option, str):
            raise InputError(f'load: an override is a text "key.path=value", got {option!r}')
        try:
            changes.append(_parse_override(option))
        except ValueError as error:
            faults.append(_Override(option, ()).fault(str(error)))
    if faults:
        raise CaseError(faults)
    return changes


def _parse_override(option: str) -> _Override:
    key, equals, value = option.partition("=")
    if not equals:
        raise ValueError("must be of the form key.path=value")
    path = key_path(key)
    value = value.strip()
    if not value:
        return _Override(option, path, removes=True)
    return _Override(option, path, _value(value))


def key_path(key: str) -> tuple[str, ...]:
    """The keys of a dotted key as TOML writes it; ValueError if it is not a key."""
    try:
        node: Any = tomllib.loads(f"{key} = 0")
    except ValueError:
        node = None
    path: tuple[str, ...] = ()
    while isinstance(node, dict) and len(node) == 1:
        ((name, node),) = node.items()
        path += (name,)
    if node != 0 or not path:
        raise ValueError("must be of the form key.path=value, such as time.end=1.5")
    return path


def _value(text: str) -> Any:
    """`text` as a TOML value; text that is not TOML, unless it looks like an attempt, is a string."""
    try:
        content = tomllib.loads(f"value = {text}")
        if list(content) == ["value"]:
            return content["value"]
    except RecursionError:
        raise ValueError("the value is nested too deeply") from None
    except ValueError as error:
        if text[0] in "[{\"'":
            words, _ = syntax_error(str(error), f"value = {text}")
            raise ValueError(f"the value is not valid TOML: {words}") from None
    if "\n" in text:
        raise ValueError("must set one key")
    return text


def _apply(changes: list[_Override], document: dict[str, Any]) -> None:
    """Change `document` in place."""
    faults = []
    for change in changes:
        try:
            _apply_one(change, document)
        except ValueError as error:
            faults.append(change.fault(str(error)))
    if faults:
        raise CaseError(faults)


def _apply_one(change: _Override, document: dict[str, Any]) -> None:
    table: Any = document
    for length, name in enumerate(change.path[:-1], start=1):
        table = table.get(name, {}) if change.removes else table.setdefault(name, {})
        if not isinstance(table, dict):
            raise ValueError(f"{_dotted(change.path[:length])} is not a table")
    name = change.path[-1]
    if not change.removes:
        table[name] = change.value
    elif name in table:
        del table[name]
    else:
        raise ValueError("there is no such key to remove")


# Lines of faults


def _take_huge_integers(document: dict[str, Any]) -> list[KeyPath]:
    """Where whole numbers of more than 64 bits stand, which TOML does not have but tomllib accepts.

    They are replaced by NaN, which no key accepts.
    """
    found: list[KeyPath] = []
    waiting: list[tuple[KeyPath, Any]] = [((), document)]
    while waiting:
        path, table = waiting.pop()
        for key, value in table.items() if isinstance(table, dict) else enumerate(table):
            if isinstance(value, dict | list):
                waiting.append(((*path, key), value))
            elif isinstance(value, int) and not -(2**63) <= value < 2**63:
                found.append((*path, key))
                table[key] = math.nan
    return found


def _located(found: list[Located], text: str, path: Path, changes: list[_Override]) -> list[Fault]:
    """Faults in the order of the file, those from overrides last.

    Of several keys that do not go together, each of them valid, the one that is given last is named.
    """
    places: dict[KeyPath, tuple[int, str]] = {
        key: (line, f"{path}:{line}") for key, line in key_lines(text).items()
    }
    for number, change in enumerate(changes):
        place = (MAX_BYTES + number, change.place)
        for known in [known for known in places if known[: len(change.path)] == change.path]:
            del places[known]
        for length in range(1, len(change.path)):
            places.setdefault(change.path[:length], place)
        places[change.path] = place

    def place_of(key: KeyPath) -> tuple[int, str]:
        prefixes = (key[:length] for length in range(len(key), 0, -1))
        return next((places[prefix] for prefix in prefixes if prefix in places), (1, f"{path}:1"))

    last = ((max(paths, key=lambda item: place_of(item)[0]), reason) for paths, reason in found)
    ordered = sorted(
        {(*place_of(key), _dotted(key), reason): None for key, reason in last}, key=lambda f: f[0]
    )
    faults = [Fault(key, reason, place=place) for _, place, key, reason in ordered]
    if len(faults) > MAX_FAULTS:
        faults[MAX_FAULTS:] = [Fault("", f"and {len(faults) - MAX_FAULTS} more faults", place=str(path))]
    return faults


def _dotted(path: KeyPath) -> str:
    """A path as TOML writes keys, with [index] for items of lists; cut short."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if _BARE_KEY.fullmatch(part) else repr(part)
            text += ("." if text else "") + name
    return text if len(text) <= 100 else text[:97] + "..."


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
        changes = _parse_overrides(case.overrides)
        raise CaseError(_located(found, case.text, case.path, changes)) from None


def _extreme(scene: Scene) -> Iterator[tuple[KeyPath, float]]:
    """The numbers of a scene above `REALISTIC` or below its inverse, each with its key."""
    tables = ("time", "net", "initial", "launch", "bodies", "tethers", "effects")
    waiting: list[tuple[KeyPath, Any]] = [((), scene.model_dump(include=set(tables)))]
    while waiting:
        path, value = waiting.pop()
        if isinstance(value, dict):
            waiting.extend(((*path, key), inner) for key, inner in value.items())
        elif isinstance(value, tuple):
            waiting.extend(((*path, index), inner) for index, inner in enumerate(value))
        elif isinstance(value, float) and value and abs(math.log10(abs(value))) > math.log10(REALISTIC):
            yield path, value
