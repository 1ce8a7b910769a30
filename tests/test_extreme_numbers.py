"""Numbers of bodies, tethers and reels that no scene has are refused before a run, at their key and line."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import command

import exunet
from exunet.scene.casefile import load
from exunet.simulation.preparation import prepare_case

TOW = Path(__file__).parent.parent / "cases" / "bodies" / "tow.toml"
MODERATE = 1e30  # between its inverse and itself, what is refused depends on the scene
# An axis is brought to length 1; limits of a reel and times of its commands need never be reached.
HARMLESS = {"axis", "angle", "reel"}
SOLIDS = {
    "box": ("size=[1.0, 2.0, 3.0]",),
    "cylinder": ("radius=0.5", "length=1.0"),
    "sphere": ("radius=0.5",),
    "capsule": ("radius=0.5", "length=1.0"),
    "frustum": ("radii=[0.5, 0.3]", "length=1.0"),
}


def prepared(*overrides: str) -> None:
    """Prepare the tow with these overrides."""
    with np.errstate(all="raise"):
        prepare_case(load(TOW, list(overrides)))


@pytest.mark.parametrize("mass", ["mass=5.0", "density=100.0"])
@pytest.mark.parametrize("part", [False, True])
@pytest.mark.parametrize(("shape", "keys"), SOLIDS.items())
@pytest.mark.parametrize("factor", [1e-200, 1e200, 1e307])
def test_sizes_of_solids(shape: str, keys: tuple[str, ...], mass: str, part: bool, factor: float) -> None:
    """Their cubes and fifth powers, of volume and inertia, overflow or vanish; a disc may be that thin."""
    for key in keys:
        name, value = key.split("=")
        numbers = np.atleast_1d(np.array(eval(value))) * factor
        own = {item.split("=")[0]: item.split("=")[1] for item in keys}
        own[name] = str(numbers.tolist() if value.startswith("[") else float(numbers[0]))
        table = ", ".join(f"{one}={value}" for one, value in own.items())
        solid = f"shape='{shape}', {table}"
        body = f"parts={{a={{{solid}}}}}, {mass}" if part else f"{solid}, {mass}"
        refused = pytest.raises(exunet.CaseError, match=rf"bodies\.odd\..*{name}.* is not realistic")
        with refused if factor > 1.0 or shape == "sphere" else suppress(exunet.CaseError):
            prepared(f"bodies.odd={{position=[0.0, 50.0, 0.0], {body}}}")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("bodies.chaser.mass", 1e307),
        ("bodies.chaser.mass", 5e-324),
        ("bodies.target.radius", 1e200),
        ("tethers.tow.diameter", 1e130),
        ("tethers.tow.density", 1e300),
    ],
)
def test_the_key_is_told(key: str, value: float) -> None:
    with pytest.raises(exunet.CaseError, match=key.replace(".", r"\.")):
        prepared(f"{key}={value!r}")


def test_a_body_whose_least_moment_is_round_off_is_refused() -> None:
    """A rod of 1e30 m and 1 m: about its axis it has 1e-60 of the other moments, round-off of the matrix."""
    with pytest.raises(
        exunet.CaseError, match=r"bodies\.odd: its mass or least moment of inertia is round-off"
    ):
        prepared(
            "bodies.odd={position=[0.0, 50.0, 0.0], shape='cylinder', radius=1.0, length=1e30, mass=5.0}"
        )


def places(table: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the floats of a table are."""
    if isinstance(table, dict | list):
        for key, value in table.items() if isinstance(table, dict) else enumerate(table):
            yield from places(value, (*path, key))
    elif isinstance(table, float):
        yield path


DOCUMENT = tomllib.loads(TOW.read_text())
EVERY = [path for name in ("bodies", "tethers") for path in places(DOCUMENT[name], (name,))]


@pytest.mark.parametrize("path", EVERY, ids=lambda path: ".".join(map(str, path)))
def test_every_number_at_its_extremes(path: tuple[Any, ...]) -> None:
    """A typed error with a place, or a scene whose numbers are moderate."""
    deepest = next((k for k, part in enumerate(path) if isinstance(part, int)), len(path))
    value: Any = DOCUMENT
    placed: list[bool] = []
    for part in path[:deepest]:
        value = value[part]
    for number in (-1e307, -1e200, 5e-324, 1e-200, 1e200, 1e307):
        override = f"{'.'.join(path[:deepest])}={_written(_with(value, path[deepest:], number))}"
        try:
            prepared(override)
        except exunet.CaseError as error:
            placed += [bool(fault.place) for fault in error.faults]
            continue
        assert abs(number) < MODERATE or HARMLESS.intersection(path), override
    assert all(placed)


def _with(value: Any, path: tuple[Any, ...], number: float) -> Any:
    if not path:
        return number
    copy = value.copy()
    copy[path[0]] = _with(value[path[0]], path[1:], number)
    return copy


def _written(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}={_written(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_written, value)) + "]"
    assert not isinstance(value, float) or math.isfinite(value)
    return repr(value)


def test_check_names_the_line(tmp_path: Path) -> None:
    text = TOW.read_text().replace("mass = 800.0", "mass = 1e307")
    (tmp_path / "case.toml").write_text(text)
    line = text.splitlines().index("mass = 1e307") + 1
    done = command("check", "case.toml", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"case.toml:{line}: bodies.target.mass: 1e+307 is not realistic")
