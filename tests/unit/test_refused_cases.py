"""Cases that are refused before they run, each at its key and line: numbers, steps and starts beyond use."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from restarts import engine
from scenes import CABLE, CASES, every_backend, pair_of_masses, thrown
from scripts import case_of

import exunet
from exunet.base.errors import CaseError, Fault, RunStopped
from exunet.scene.casefile import load, parse_case
from exunet.simulation.preparation import prepare, prepare_case

PLANAR, TOW = CASES / "planar_deployment.toml", CASES / "bodies" / "tow.toml"


def keys_at_fault(path: Path, *overrides: str) -> set[str]:
    with pytest.raises(CaseError) as caught:
        prepare_case(load(path, overrides))
    return {fault.key for fault in caught.value.faults}


# Several errors at once, each with file and line

# Two masses on a cable of 1 m, EA = 1e3 N, mu = 0.5 kg: the taut cable's frequency is sqrt(EA / (L0 mu)) =
# 45 rad/s, and RK44 is stable up to 2.83 / 45 s = 0.063 s. Line numbers count in this text.
STRETCHED = """\
format = 1
title = "two masses"
time = { end = 10.0, output_step = 1.0 }
[solver]
method = "RK44"
step = 0.1
[net]
topology = "explicit"
nodes = [[0, 0, 0], [1, 0, 0]]
elements = [[0, 1]]
node_masses = [1.0, 1.0]
cable = { area = 1e-6, density = 1e-3, youngs_modulus = 1e9 }
[initial]
packing = 1
node_positions = [[0, 0, 0], [9, 0, 0]]
"""
STEP, START = ("case.toml:6", "solver.step"), ("case.toml:15", "initial.node_positions")


@pytest.mark.parametrize(
    ("overrides", "faults"),
    [
        ((), [STEP, START]),
        (("initial.node_positions=[[0, 0, 0], [1, 0, 0]]",), [STEP]),
        (("solver.step=0.05",), [START]),
        (("solver.step=0.2",), [START, ("--set solver.step=0.2", "solver.step")]),
    ],
)
def test_a_long_step_and_a_stretched_start(overrides: tuple[str, ...], faults: list[tuple[str, str]]) -> None:
    with pytest.raises(CaseError) as caught:
        prepare_case(parse_case(STRETCHED, Path("case.toml"), overrides))
    assert [(fault.place, fault.key) for fault in caught.value.faults] == faults


def test_errors_of_bodies_effects_start_and_steps_come_together() -> None:
    steps = ("solver.method=RK44", "solver.step=1.0")
    found = keys_at_fault(CASES / "effects/launch_force.toml", *steps, "initial.packing=3.0")
    assert found == {"solver.step", "initial.packing"}
    thrust = "effects.thrust={bullets=[0],time=[0.0,1e60],force=[[1e200,0.0,0.0],[0.0,0.0,0.0]]}"
    found = keys_at_fault(PLANAR, thrust, *steps)
    assert found == {"effects.thrust.force[0][0]", "effects.thrust.time[1]", "solver.step"}
    # An effect of which it is not yet known whether it is chosen.
    auto = "effects={choose='auto',threshold=1e-3,gravity={acceleration=[1e300,0.0,0.0]}}"
    assert keys_at_fault(PLANAR, auto, *steps) == {"effects.gravity.acceleration[0]", "solver.step"}


# Steps and starts that no run can follow


def refused(key: str, words: str, solver: dict[str, Any] | None = None, **tables: Any) -> CaseError:
    with pytest.raises(CaseError, match=words) as refusal:
        prepare(thrown(solver or {}, **tables))
    assert [fault.key for fault in refusal.value.faults] == [key]
    assert refusal.value.exit_code == 2
    return refusal.value


def net_of(**changes: float) -> dict[str, Any]:
    cable = CABLE | changes
    return {"topology": "square", "size": 2.0, "mesh": 1.0, "cable": cable, "bullets": {"mass": 0.5},
            "strings": cable | {"length": 1.0}}  # fmt: skip


@pytest.mark.parametrize("solver", [{}, {"method": "RK44"}, {"method": "DOPRI5", "tolerance": 1e-6}], ids=str)
def test_frequencies_and_numbers_of_steps_beyond_use(solver: dict[str, Any]) -> None:
    """Steps of some 1e-48 s; and no end within 1e10 s in steps of 1e-4 s."""
    error = refused("net", "element 0 .*outside the range", solver, net=net_of(density=1e-300))
    assert error.faults[0].beyond_floats  # so that the value in the case file is named
    refused("net", "the limit is .*element", solver, net=net_of(youngs_modulus=1e100))
    refused("net", "of at least", solver, end=1e10, time={"end": 1e10, "output_step": 1e9})


def test_too_many_steps_of_a_given_length_are_refused() -> None:
    """At most 1e10 steps."""
    refused("solver.step", "of at least", {"method": "RK44", "step": 1e-11})
    assert prepare(thrown({"method": "RK44", "step": 1e-10})).plan.step == 1e-10


def test_a_start_beyond_the_law_is_refused() -> None:
    refused("initial.packing", "starts at 2.5 times", initial={"packing": 2.5})
    assert prepare(thrown({"tolerance": 1e-6}, initial={"packing": 2.0})).plan.method


def test_speeds_that_no_step_can_follow_are_refused() -> None:
    """A bullet that passes its string of 1 m in 1e-30 s."""
    words = "separate at .* lengths a second"
    refused("launch", words, launch={"radial_speed": 1e30, "axial_speed": 0.0})
    refused("initial", words, launch=None, initial={"packing": 0.5, "spin": [0, 0, 1e20]})


def test_places_where_positions_have_no_digits_left_are_refused() -> None:
    """Doubles of 52 digits are 2^-10 m apart below 2^43 m, and twice that above; 1e-3 of 1 m lies between.

    Reached within 0.5 s at 2^44 m/s. It stops a limit elsewhere, or without the path or its duration.
    """
    fast = {"packing": 0.5, "velocity": [0.999 * 2.0**44, 0.0, 0.0]}
    assert prepare(thrown({}, initial=fast)).plan.method
    fast["velocity"] = [1.001 * 2.0**44, 0.0, 0.0]
    refused("initial", "8.8e[+]12 m until time.end, where .* spacing of 0.002 m", initial=fast)


@every_backend
def test_steps_that_collapse_stop_the_run_at_a_place(backend: str) -> None:
    """A tolerance below the round-off of the positions, for which a case of such speeds is refused."""
    start = prepare(thrown({"method": "DOPRI5", "tolerance": 1e-10}, engine=engine(backend)))
    start = replace(start, plan=replace(start.plan, tolerance=1e-25))
    with pytest.raises(RunStopped, match=r"collapsed to .* at t = .* element .* node is") as stop:
        exunet.run(start)
    assert not stop.value.step_cause


@every_backend
def test_a_collapse_after_a_wrong_state_is_reported_as_that_state(backend: str) -> None:
    """Bullets at 1e9 m/s: the strings are beyond the law within the first steps."""
    launch = {"radial_speed": 1e9, "axial_speed": 0.0}
    with pytest.raises(RunStopped, match=r"diverged at .*longer than 2 times"):
        exunet.run(thrown({}, engine=engine(backend), launch=launch))


def test_what_implicit_methods_cannot_run_is_named() -> None:
    """A reel's states, a body that is held; the key is that of the method."""
    with pytest.raises(CaseError) as refusal:
        prepare(case_of("", 'solver={method="GeneralizedAlpha", step=1e-3}', 'engine.backend="exudyn"').scene)
    assert {fault.key for fault in refusal.value.faults} == {"solver.method"}
    assert all(name in str(refusal.value) for name in ("target", "tow/wound_up"))


# Numbers that no scene has

MODERATE = 1e30  # between its inverse and itself, what is refused depends on the scene
# An axis is brought to length 1; limits of a reel and times of its commands need never be reached.
HARMLESS = {"axis", "angle", "reel"}
SOLIDS = {
    "box": {"size": [1.0, 2.0, 3.0]},
    "cylinder": {"radius": 0.5, "length": 1.0},
    "sphere": {"radius": 0.5},
    "capsule": {"radius": 0.5, "length": 1.0},
    "frustum": {"radii": [0.5, 0.3], "length": 1.0},
}


def prepared(*overrides: str) -> None:
    """Prepare the tow with these overrides."""
    with np.errstate(all="raise"):
        prepare_case(load(TOW, list(overrides)))


@pytest.mark.parametrize("place", ["body", "part"])
@pytest.mark.parametrize("shape", SOLIDS)
@pytest.mark.parametrize("factor", [1e-200, 1e200, 1e307])
def test_sizes_of_solids(shape: str, place: str, factor: float) -> None:
    """Their cubes and fifth powers, of volume and inertia, overflow or vanish; a disc may be that thin."""
    mass = "mass=5.0" if place == "body" else "density=100.0"
    for name, value in SOLIDS[shape].items():
        keys = SOLIDS[shape] | {name: (factor * np.array(value)).tolist()}
        solid = ", ".join([f"shape='{shape}'", *(f"{key}={number}" for key, number in keys.items())])
        body = f"parts={{a={{{solid}}}}}, {mass}" if place == "part" else f"{solid}, {mass}"
        error = pytest.raises(CaseError, match=rf"bodies\.odd\..*{name}")
        with error if factor > 1.0 or shape == "sphere" else suppress(CaseError):
            prepared(f"bodies.odd={{position=[0.0, 50.0, 0.0], {body}}}")


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
    table: Any = DOCUMENT
    for part in path[:deepest]:
        table = table[part]
    for number in (-1e200, 5e-324, 1e200, 1e307):
        override = f"{'.'.join(path[:deepest])}={_written(_with(table, path[deepest:], number))}"
        faults: list[Fault] = []
        try:
            prepared(override)
        except CaseError as error:
            faults = error.faults
        assert faults or abs(number) < MODERATE or HARMLESS.intersection(path), override
        assert all(fault.place for fault in faults)


def _with(value: Any, path: tuple[Any, ...], number: float) -> Any:
    if not path:
        return number
    copy = value.copy()
    copy[path[0]] = _with(value[path[0]], path[1:], number)
    return copy


def _written(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}={_written(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_written, value)) + "]"
    assert not isinstance(value, float) or math.isfinite(value)
    return repr(value)


@pytest.mark.parametrize(
    ("override", "keys"),
    [
        ("bodies.chaser.mass=5e-324", {"bodies.chaser.mass"}),
        ("tethers.tow.diameter=1e130", {"tethers.tow.diameter"}),
        # About its axis a rod of 1e30 m and 1 m has 1e-60 of the other moments, round-off of the matrix.
        ("bodies.odd={position=[0.0,50.0,0.0], shape='cylinder', radius=1.0, length=1e30, mass=5.0}",
         {"bodies.odd"}),
        ("bodies.odd={mass=1e-320,inertia=[1.0,1.0,1.0]}", {"bodies.odd.mass"}),
        ("bodies.odd={mass=1.0,inertia=[1.0,1.0,1e-320]}", {"bodies.odd.inertia[2]"}),
        ("bodies.odd={mass=1.0,inertia=[1.0,2.0,2.5],velocity=[1e20,0.0,0.0]}", {"bodies.odd.velocity"}),
        ("bodies.odd={mass=1.0,inertia=[1.0,2.0,2.5],angular_velocity=[1e14,0.0,0.0]}",
         {"bodies.odd.angular_velocity"}),
        ("bodies.odd={mass=1.0,inertia=[1.0,2.0,2.5],position=[1e20,0.0,0.0]}", {"bodies.odd.position"}),
        ("bodies.odd={mass=1.0,inertia=[1.0,2.0,2.5],position=[1e200,0.0,0.0],velocity=[1.0,1e120,0.0]}",
         {"bodies.odd.position[0]", "bodies.odd.velocity[1]"}),
    ],
)  # fmt: skip
def test_a_body_or_tether_that_no_run_can_follow(override: str, keys: set[str]) -> None:
    assert keys_at_fault(PLANAR if "odd" in override else TOW, override) == keys


def test_a_start_beyond_the_cable_law_is_refused() -> None:
    far = [[-1.5, 0.0, 0.0], [1.5, 0.0, 0.0]]  # of an element of 1 m
    with pytest.raises(CaseError, match="starts at 3 times"):
        prepare(pair_of_masses(initial={"packing": 1.0, "node_positions": far}))
