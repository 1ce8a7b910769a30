"""Thrust on rigid bodies, by a table and by a script: known motions, impulse, work, both codes."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import BACKENDS, continue_alike, every_backend
from scripts import entry

import reference_impl
from exunet.base.errors import CaseError
from exunet.results.measures import energy_balance, energy_errors, momentum_books
from exunet.results.metrics import metrics
from exunet.results.result import Result
from exunet.scene.casefile import Case, parse_case
from exunet.simulation.preparation import prepare_case
from exunet.simulation.run import run
from exunet.simulation.simulation import Simulation

MASS, MOMENTS = 10.0, (2.0, 2.5, 4.0)
SCENE = f"""
format = 1
title = "A body with engines"
time = {{ end = 1.0, output_step = 0.25 }}
solver = {{ method = "DOPRI5", tolerance = 1e-10 }}
initial.packing = 1.0
net.topology = "explicit"
net.nodes = [[9.0, 0.0, 0.0]]
net.elements = []
net.node_masses = [1.0]
net.cable = {{ diameter = 0.001, density = 1390.0, youngs_modulus = 70e9 }}
[bodies.sat]
mass = {MASS}
inertia = {list(MOMENTS)}
"""


def case_of(text: str = "", *overrides: str) -> Case:
    return parse_case(SCENE + text, Path("thrust.toml"), overrides)


def table(**keys: Any) -> str:
    """Of the thrust; every value as TOML writes it."""
    return "[bodies.sat.thrust]\n" + "".join(f"{key} = {value!r}\n" for key, value in keys.items())


def last(result: Result) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position of the body's centre, its velocity, and its angular velocity in its axes."""
    body = result.bodies["sat"]
    assert body.angular_velocity is not None
    return body.position[-1], body.velocity[-1], body.angular_velocity[-1]


@every_backend
def test_a_constant_force_and_a_torque_about_a_principal_axis(backend: str) -> None:
    """F T / m and F T^2 / (2 m); M T / I, in 1 s."""
    loads = {"force": [[3.0, 0.0, -1.0]] * 2, "torque": [[0.0, 0.0, 0.8]] * 2}
    result = run(case_of(table(times=[0.0, 2.0], axes="scene", **loads), BACKENDS[backend]))
    position, velocity, spin = last(result)
    np.testing.assert_allclose(velocity, [0.3, 0.0, -0.1], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(position, [0.15, 0.0, -0.05], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(spin, [0.0, 0.0, 0.2], rtol=1e-12, atol=1e-15)
    work = 0.5 * MASS * 0.1 + 0.5 * 4.0 * 0.2**2
    assert metrics(result)["effect_thrust_sat_work_J"].value == pytest.approx(work, rel=1e-9)


@every_backend
def test_a_force_fixed_to_a_spinning_body(backend: str) -> None:
    """v = F / (m w) (sin w t, 1 - cos w t) of a force along its x axis, spun about z by w = 2 rad/s."""
    push = table(times=[0.0, 2.0], force=[[5.0, 0.0, 0.0]] * 2)
    result = run(case_of("angular_velocity = [0.0, 0.0, 2.0]\n" + push, BACKENDS[backend]))
    expected = 0.25 * np.array([math.sin(2.0), 1.0 - math.cos(2.0), 0.0])
    np.testing.assert_allclose(last(result)[1], expected, rtol=1e-8, atol=1e-12)
    assert last(result)[2][2] == pytest.approx(2.0, rel=1e-12)


TRAPEZOID = {"times": [0.1, 0.2, 0.7, 0.9], "force": [[0, 0, 0], [0, 4, 0], [0, 4, 0], [0, 0, 0]]}


@pytest.mark.parametrize("method", ["DOPRI5", "RK44", "VelocityVerlet"])
def test_the_impulse_of_a_trapezoid(method: str) -> None:
    """4 N (0.05 + 0.5 + 0.1) s = 2.6 N s, exact for each method since steps end at the times."""
    result = run(
        case_of(table(axes="scene", **TRAPEZOID), f"solver={{method='{method}'}}", BACKENDS["compiled"])
    )
    assert metrics(result)["effect_thrust_sat_impulse_y_N_s"].value == pytest.approx(2.6, rel=1e-12)
    assert last(result)[1][1] == pytest.approx(2.6 / MASS, rel=1e-12)
    books = momentum_books(result)["linear"]
    assert books.residual <= 1e-12 * books.size


SKEW = (
    "products_of_inertia = [0.3, -0.2, 0.1]\ncentre_of_mass = [0.1, -0.2, 0.3]\n"
    "attitude = [0.8, 0.3, -0.4, 0.2]\nangular_velocity = [0.5, -0.7, 0.4]\n"
)
LOADS = {"times": [0.0, 0.3, 0.8], "force": [[1, 2, 3], [-2, 1, 0], [4, 0, 1]], "torque": [[0, 1, 0]] * 3}


@pytest.mark.parametrize("axes", ["body", "scene"])
def test_both_codes_and_the_balances(axes: str) -> None:
    """A turned body that spins, pushed beside its centre; the reference by its own equations."""
    text = SKEW + table(axes=axes, point=[0.5, 0.4, -0.3], **LOADS)
    result = run(case_of(text, BACKENDS["compiled"]))
    theirs = reference_impl.prepare(reference_impl.read_document(tomllib.loads(SCENE + text)))
    found = theirs.integrate(rtol=1e-11, atol=1e-12)
    ours = result.bodies["sat"]
    for name in ("position", "velocity", "angular_velocity"):
        np.testing.assert_allclose(getattr(ours, name), getattr(found.bodies, name)[:, 0], atol=1e-9)
    np.testing.assert_allclose(result.dissipated, found.dissipated, atol=1e-9)
    assert np.abs(energy_errors(result)).max() < 1e-9
    for books in momentum_books(result).values():
        assert books.residual <= 1e-9 * books.size < 1e-3 * books.gained


def burn(name: str, force: list[float], **keys: Any) -> str:
    return entry(name, do="thrust", on="sat", force=force, **keys)


@every_backend
def test_a_script_thrusts_as_a_table_does(backend: str, tmp_path: Path) -> None:
    """At the point and in the axes of the body's table; the second burn replaces the first, and ends."""
    at = {"axes": "scene", "point": [0.0, 0.5, 0.0]}
    burns = burn("one", [0.0, 0.0, 3.0], at=0.1, duration=0.7, torque=[0.1, 0.0, 0.0])
    burns += burn("two", [1.0, 0.0, 0.0], after="one", delay=0.4, duration=0.2)
    scripted = case_of(table(**at) + burns, BACKENDS[backend])
    tiny = 1e-9  # [s] in which the one force of the table becomes the other
    force, torque = [[0, 0, 3]] * 2 + [[1, 0, 0]] * 2, [[0.1, 0, 0]] * 2 + [[0, 0, 0]] * 2
    listed = table(times=[0.1, 0.5 - tiny, 0.5, 0.7], force=force, torque=torque, **at)
    result = run(scripted)
    for found, known in zip(last(result), last(run(case_of(listed, BACKENDS[backend]))), strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(last(result)[1], [0.2 / MASS, 0.0, 1.2 / MASS], rtol=1e-12, atol=1e-15)
    assert energy_balance(result) < 1e-9
    one, other = Simulation(prepare_case(scripted)), Simulation(prepare_case(scripted))
    one.advance_to(0.3)
    continue_alike(one, other, 1.0, tmp_path)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (table(times=[0.0, 1.0], force=[[0, 0, 1]]), "bodies.sat.thrust.force"),
        (table(times=[1.0, 1.0], torque=[[0, 0, 1]] * 2), "bodies.sat.thrust.times[1]"),
        ('motion = "fixed"\n' + table(axes="scene"), "bodies.sat.thrust"),
        (entry("burn", at=0.1, do="thrust", on="sat"), "script[0].force"),
        (entry("burn", at=0.1, do="thrust", on="sat", force=3.0), "script[0].force"),
        (entry("burn", at=0.1, do="thrust", on="moon", torque=[0, 0, 1]), "script[0].on"),
        (burn("a", [0, 0, 1], at=0.1) + burn("b", [0, 0, 2], at=0.1), "script[0].do"),
    ],
)
def test_invalid_thrust_is_refused_at_its_key(text: str, key: str) -> None:
    with pytest.raises(CaseError) as refused:
        case_of(text)
    assert refused.value.faults[0].key == key
