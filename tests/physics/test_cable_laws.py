"""Hooke's law and tables: known answers, numbers of other codes, both codes, bad input."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CASES, listed, one_thread, ran, reference_run
from scipy.optimize import fsolve

from exunet.base.errors import CaseError, RunStopped
from exunet.forces import law
from exunet.forces.cable import AxialLaw
from exunet.forces.total import Forces
from exunet.kernels.kernel import Kernel
from exunet.model.limits import largest_frequency
from exunet.net.base import Cable, laws_of
from exunet.results.measures import energy_balance, largest_tensions
from exunet.scene.casefile import parse_case
from exunet.scene.scene import Scene
from exunet.simulation.preparation import prepare
from exunet.simulation.run import simulate
from exunet.studies.both_codes import both_of_text
from exunet.verification.cross_code import compared, motion

STRETCHY = {"area": 1e-6, "density": 1000.0}  # 1 g a metre
HOOKE = STRETCHY | {"youngs_modulus": 1e9, "law": "hooke"}  # EA = 1 kN
# softer, then stiffer: slopes of 1, 0.5 and 3 kN
TABLE = STRETCHY | {"law": "table", "table": [[0.0, 0.0], [0.02, 20.0], [0.06, 40.0], [0.4, 1060.0]]}


def table_of(points: list[list[float]]) -> dict[str, Any]:
    return STRETCHY | {"law": "table", "table": points}


def apart(speed: float, end: float, cable: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Two masses of 0.5 kg at the ends of a just straight thread of 1 m fly apart."""
    net = {"cable": cable, "node_masses": [0.4995, 0.4995]}
    initial = {"node_velocities": [[-0.5 * speed, 0.0, 0.0], [0.5 * speed, 0.0, 0.0]]}
    return one_thread(end, net=net, initial=initial, **more)


@pytest.mark.parametrize("backend", ["exudyn", "compiled"])
def test_a_snap_by_hookes_law_is_half_an_oscillation(backend: str) -> None:
    """Peak v sqrt(EA mu / L), contact time pi / w w^2 = EA / (mu L), mu = 0.25 kg, as of a spring."""
    omega = math.sqrt(1000.0 / 0.25)
    half = math.pi / omega
    case = apart(5.0, half, HOOKE) | {"time": {"end": half, "output_times": [0.5 * half]}}
    result = ran(case, backend)
    peak = 5.0 * math.sqrt(1000.0 * 0.25)
    assert result.tension[1, 0] == pytest.approx(peak, rel=1e-6)
    assert largest_tensions(result).max() == pytest.approx(peak, rel=1e-6)
    distance, parting = (part[-1, 1, 0] - part[-1, 0, 0] for part in (result.position, result.velocity))
    assert (distance - 1.0) / 5.0 == pytest.approx(0.0, abs=1e-6 * half)  # when it is slack again
    assert parting == pytest.approx(-5.0, rel=1e-6)
    assert energy_balance(result) < 1e-8


@pytest.mark.parametrize("backend", ["exudyn", "compiled"])
def test_a_table_of_hookes_line_is_hookes_law(backend: str) -> None:
    line = table_of([[0.0, 0.0], [0.01, 10.0], [0.1, 100.0], [0.9, 900.0]])
    effects = {"material_damping": {"relaxation_time": 1e-4}}
    runs = [ran(apart(5.0, 0.04, cable, effects=effects), backend) for cable in (HOOKE, line)]
    assert runs[0].dissipated[-1] > 0.04
    for name in ("position", "velocity", "tension", "elastic", "dissipated"):
        hooke, table = (getattr(result, name) for result in runs)
        np.testing.assert_allclose(table, hooke, rtol=1e-12, atol=1e-12 * np.abs(hooke).max())


def test_laws_by_length_and_by_squared_length_agree_for_all_laws() -> None:
    """By hand: 20 N at 2 %, then 0.5 kN a unit of strain, then 3 kN."""
    (hooke, number), rows = laws_of([Cable.model_validate(HOOKE), Cable.model_validate(TABLE)])
    stretch = np.array([0.9, 1.0, 1.01, 1.02, 1.05, 1.16])
    for of, wanted in (
        (hooke, 1000.0 * (stretch - 1.0)),
        (number, np.array([0.0, 0.0, 10.0, 20.0, 35.0, 340.0])),
    ):
        thread = AxialLaw(np.full(6, 0.7), np.full(6, 1000.0), np.full(6, 0.01), np.full(6, of), rows)
        wanted = np.maximum(wanted, 0.0)
        np.testing.assert_allclose(thread.tension(0.7 * stretch), wanted, rtol=1e-12, atol=1e-12)
        slope = (
            np.array([0.0, 0.0, 1.0, 0.5, 0.5, 3.0])
            if of == number
            else np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
        )
        damped = thread.tension(0.7 * stretch, np.full(6, 0.07))  # ds/dt = 0.1 / s
        np.testing.assert_allclose(damped, wanted + 1.0 * slope, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(thread.length_with(wanted)[2:], 0.7 * stretch[2:], rtol=1e-13)
        held = 0.5 * thread.strain(0.7 * stretch) ** 2 * 1000.0 * 0.7
        fine = 0.7 * np.linspace(1.0, stretch[-1], 160001)
        assert held[-1] == pytest.approx(
            np.trapezoid(
                AxialLaw(*(np.full(160001, c) for c in (0.7, 1000.0, 0.0, of)), rows).tension(fine), fine
            ),
            rel=1e-8,
        )  # the area under the tension
        for s, pull, energy, growth in zip(stretch[2:], wanted[2:], held[2:], slope[2:], strict=True):
            excess = (0.7 * s) ** 2 - 0.7**2
            force, root = law.pull_of(of, rows, excess, 0.7**2)
            assert law.tension_by(force, (0.7 * s) ** 2, 0.7, 1000.0) == pytest.approx(pull, rel=1e-12)
            assert 1000.0 / (8.0 * 0.7**3) * root**2 == pytest.approx(energy, rel=1e-12)
            assert law.weight_of(of, rows, excess + 1e-12, 0.7**2) == pytest.approx(growth / s**2, rel=1e-9)
            assert law.energy_with(of, rows, pull, 0.7, 1000.0) == pytest.approx(energy, rel=1e-12)


MIXED = """
format = 1
title = "three laws"
time = {end = 1.0, output_step = 0.5}
initial.packing = 1.01
[net]
topology = "square"
size = 2.0
mesh = 0.5
cable = {diameter = 0.001, density = 1000.0, youngs_modulus = 1e8, law = "hooke"}
bullets.mass = 0.3
[net.strings]
length = 0.5
diameter = 0.001
density = 1000.0
law = "table"
table = [[0.0, 0.0], [0.01, 3.0], [0.9, 900.0]]
[tethers.tow]
diameter = 0.001
density = 1000.0
youngs_modulus = 1e8
length = 2.0
divisions = 2
start.node = "centre"
end.node = "corner 0"
[effects.material_damping]
relaxation_time = 1e-4
"""


def test_both_codes_have_three_laws_in_one_net() -> None:
    """Accelerations, energies and powers at random states; the law of each element apart."""
    case = both_of_text("mixed", MIXED)
    assert [number for number, _ in case.start.system.forces.cable.law.kinds] == [0, 1, 2]
    for check in compared(motion(case, compiled=False), 10):
        assert check.holds, check


REEL = (CASES / "verification/bodies/reel_force.toml").read_text()


def test_both_codes_have_reels_by_hookes_law() -> None:
    case = both_of_text("reel", REEL.replace("[tethers.line]", '[tethers.line]\nlaw = "hooke"'))
    assert case.start.system.forces.cable.reels[0].law.number is not None
    for check in compared(motion(case, compiled=False), 10):
        assert check.holds, check


@pytest.mark.parametrize("cable", [HOOKE, TABLE], ids=["hooke", "table"])
@pytest.mark.parametrize(
    "effect", [{"material_damping": {"relaxation_time": 1e-3}}, {"breaking": {"force": 70.0}}]
)
def test_both_codes_damp_and_break_alike(cable: dict[str, Any], effect: dict[str, Any]) -> None:
    case = apart(5.0, 0.1, cable, effects=effect)
    ours, (_, theirs) = ran(case), reference_run(case)
    np.testing.assert_allclose(ours.position[-1], theirs[-1], atol=2e-6)
    assert energy_balance(ours) < 1e-6


def test_the_largest_slope_of_a_table_bounds_the_step() -> None:
    """Three times the stiffness of a thread that is just taut: sqrt(3) times the frequency."""
    frequency = [
        largest_frequency(prepare(Scene.model_validate(apart(5.0, 0.1, cable))).system)
        for cable in (HOOKE, TABLE)
    ]
    assert frequency[1] == pytest.approx(math.sqrt(3.0) * frequency[0], rel=1e-9)


def test_an_elastic_catenary_as_moorpy_computes_it() -> None:
    """NREL MoorPy, tests/test_catenary.py, row 4: EA 751 MN, 881.05 N/m, 130 m, 89.9 m across, 59.2 m up."""
    stiffness, weight, span = 751e6, 881.05, np.array([89.9, 59.2])
    found = []
    for n in (100, 200):
        load = weight * 130.0 / n * np.append(np.ones(n), 0.0)

        def nodes(pull: Any, n: int = n, load: Any = load) -> Any:
            """Places (n + 1, 2) of a chain that pulls at its lower end; Hooke's law by hand."""
            tension = np.stack([np.full(n, pull[0]), pull[1] + np.cumsum(load)[:n] - 0.5 * load[0]], axis=1)
            size = np.linalg.norm(tension, axis=1)
            steps = tension / size[:, None] * (130.0 / n * (1.0 + size / stiffness))[:, None]
            return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

        pull = fsolve(lambda at, nodes=nodes: nodes(at)[-1] - span, [31e3, -27e3], xtol=1e-13)
        place = np.insert(nodes(pull), 1, 0.0, axis=1)
        cable = {"area": 1e-2, "density": 1000.0, "youngs_modulus": 751e8, "law": "hooke"}
        reference = np.outer(np.arange(n + 1), [130.0 / n, 0.0, 0.0])
        net = {"cable": cable, "fixed": [0, n]}
        case = listed(reference.tolist(), [[k, k + 1] for k in range(n)], 1.0, net=net)
        case["initial"] = {"packing": 1.0, "node_positions": place.tolist()}
        start = prepare(Scene.model_validate(case))
        force = Kernel(Forces.of(start.net)).forces(0.0, start.position, 0.0 * start.position)
        np.testing.assert_allclose(force[1:-1], np.outer(load[1:n], [0.0, 0.0, 1.0]), atol=1e-4)
        half = 0.5 * load[0]
        found.append([force[0, 0], force[0, 2] - half, force[-1, 2] - half])
    extrapolated = (4.0 * np.array(found[1]) - found[0]) / 3.0
    np.testing.assert_allclose(extrapolated, [31373.2290, -26650.3413, -87886.1587], rtol=1e-6)


MOORDYN = [
    [4, 3.99895, -0.04905],
    [3.99964, 3.97813, -0.1962],
    [3.99773, 3.92476, -0.44145],
    [3.99374, 3.82758, -0.7848],
    [3.9871, 3.67541, -1.22624],
]


def test_a_net_falls_as_moordyn_computes_it() -> None:
    """MoorDyn 2.7.2 in vacuum: 8 x 8 meshes, two corners held, weights at two; the weight's places [m]."""
    places = [[0.5 * i, 0.5 * j, 0.0] for j in range(9) for i in range(9)]
    along = [[9 * j + i, 9 * j + i + 1] for j in range(9) for i in range(8)]
    across = [[9 * j + i, 9 * j + i + 9] for j in range(8) for i in range(9)]
    cable = {"area": 1e-6, "density": 5e4, "youngs_modulus": 5e9, "law": "hooke"}
    masses = [0.5 if node in (72, 80) else 0.0 for node in range(81)]
    net = {"cable": cable, "fixed": [0, 8], "node_masses": masses}
    case = listed(
        places, along + across, 0.5, net=net, effects={"gravity": {"acceleration": [0.0, 0.0, -9.81]}}
    )
    case |= {"time": {"end": 0.5, "output_step": 0.1}, "solver": {"method": "VelocityVerlet", "step": 5e-5}}
    result = simulate(prepare(Scene.model_validate(case | {"engine": {"backend": "compiled"}})))
    np.testing.assert_allclose(result.position[1:, 80], MOORDYN, atol=5e-4)


REFUSED = {
    "net.cable.table[2]": table_of([[0.0, 0.0], [0.1, 10.0], [0.2, 9.0]]),
    "net.cable.table[0]": table_of([[0.01, 5.0], [0.1, 10.0]]),
    "net.cable.table": STRETCHY | {"law": "table"},
    "net.cable.youngs_modulus": TABLE | {"youngs_modulus": 1e9},
}


@pytest.mark.parametrize("key", REFUSED)
def test_a_table_that_is_none_is_refused(key: str, tmp_path: Path) -> None:
    with pytest.raises(CaseError) as refused:
        parse_case(_toml(apart(5.0, 0.1, REFUSED[key])), tmp_path / "case.toml")
    assert [fault.key for fault in refused.value.faults] == [key]


PERIMETER = (CASES / "verification/closing/perimeter.toml").read_text()
BY_TABLE = 'law = "table"\ntable = [[0.0, 0.0], [0.1, 10.0]]'


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (
            MIXED + "[effects.thermal_strain]\ntemperature_change = 1.0\nexpansion_coefficient = 1e-5",
            "net.cable.law",
        ),
        (PERIMETER.replace("[net.cable]", '[net.cable]\nlaw = "hooke"'), "net.cable.law"),
        (re.sub("youngs_modulus = [^\n]*", BY_TABLE, REEL), "tethers.line.table"),
    ],
    ids=["thermal strain", "perimeter", "reel"],
)
def test_laws_are_refused_where_they_are_not_modelled(text: str, key: str, tmp_path: Path) -> None:
    with pytest.raises(CaseError) as refused:
        parse_case(text, tmp_path / "case.toml")
    assert key in [fault.key for fault in refused.value.faults]


@pytest.mark.parametrize("backend", ["exudyn", "compiled"])
def test_a_run_stops_at_the_end_of_a_table(backend: str) -> None:
    """A snap that takes 79 N of a thread whose table ends at 60 N, at a strain of 6 %; a tether, likewise."""
    short = table_of([[0.0, 0.0], [0.06, 60.0]])
    with pytest.raises(RunStopped, match=r"element 0: .* 0\.06\d+ .* 0\.06: .* net\.cable\.table"):
        ran(apart(5.0, 0.1, short), backend)
    ends = {"start": {"node": 0}, "end": {"node": 1}}
    case = apart(5.0, 0.1, HOOKE | {"youngs_modulus": 1.0}, tethers={"line": short | {"length": 1.0} | ends})
    with pytest.raises(RunStopped, match=r"element 1: .* 0\.06\d+ .* 0\.06: .* tethers\.line\.table"):
        ran(case, backend)


def _toml(case: dict[str, Any]) -> str:
    def value(item: Any) -> str:
        if isinstance(item, dict):
            return "{" + ", ".join(f"{key} = {value(own)}" for key, own in item.items()) + "}"
        return json.dumps(item)

    return "\n".join(f"{key} = {value(item)}" for key, item in case.items())
