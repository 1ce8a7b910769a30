"""Effects together: both codes on the cases, the energy of random subsets, no trace of what is absent."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scenes import (
    EFFECT_CASES,
    STRONG,
    every_backend,
    model,
    text_of,
)
from scipy.spatial import cKDTree

import reference_impl
from exunet.base.record import config_of
from exunet.forces.cable_term import ElementLaw
from exunet.forces.effects import EFFECTS, cross_checks
from exunet.forces.linear_term import LinearTerm
from exunet.forces.total import Forces
from exunet.kernels.kernel import net_kernel
from exunet.results.measures import energy_balance
from exunet.scene.casefile import load
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate


@pytest.mark.ci_for("molecular_drag")
@pytest.mark.slow_for("orbit", "air_drag", "launch_force", "molecular_drag", "orbit_two_body")
@pytest.mark.parametrize("name", sorted({path.stem for path in EFFECT_CASES.glob("*.toml")} - {"auto"}))
def test_both_codes_agree_and_energy_balances(name: str) -> None:
    """On the shipped case of each effect; `effects.choose = "auto"` is for exunet only."""
    path = EFFECT_CASES / f"{name}.toml"
    run = simulate(prepare(load(path, ["solver.tolerance=1e-11"]).scene))
    theirs = reference_impl.load(path)
    other = theirs.integrate(rtol=1e-12, atol=1e-13)
    match = cKDTree(theirs.net.reference_position).query(run.net.reference_position)[1]
    np.testing.assert_allclose(run.time, other.t, rtol=0, atol=1e-12)
    assert np.abs(run.position - other.x[:, match]).max() < 2e-8
    part = 1e-6 if name == "breaking" else 1e-7  # a break is found at the end of a step
    assert abs(run.dissipated[-1] - other.dissipated[-1]) < part * run.kinetic.max()
    assert energy_balance(run) < 1e-5


CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e8}

BALL = {"shape": "sphere", "radius": 0.5, "mass": 10.0, "position": [0.0, 0.0, 2.0]}
OF_BODIES = {"contact"}  # without a body there is nothing to touch; contact has tests of its own


def validated(module: Any, keys: dict[str, Any]) -> Any:
    """The record of an effect."""
    return TypeAdapter(config_of(module)).validate_python(keys)


def case(on: tuple[str, ...] = (), **more: Any) -> dict[str, Any]:
    launch = {} if "launch_force" in on else {"launch": {"radial_speed": 2.5, "axial_speed": 1.0}}
    return {
        "format": 1,
        "title": "a net that stretches, bends and snaps",
        "time": {"end": 0.3, "output_step": 0.02},
        "solver": {"method": "DOPRI5", "tolerance": 2e-9},
        "net": {
            "topology": "square", "size": 2.0, "mesh": 1.0, "divisions": 2, "cable": CABLE,
            "strings": {"length": 0.5, **CABLE}, "bullets": {"mass": 0.2},
        },
        "initial": {"packing": 0.9, "spin": [0.2, 0.5, 1.0]},
        "effects": {name: STRONG[name] for name in on},
    } | launch | more  # fmt: skip


def start_with(*on: str, **more: Any) -> Start:
    return prepare(Scene.model_validate(case(on, **more)))


def subset(seed: int) -> tuple[str, ...]:
    """Effects drawn at random; of those that contradict each other or miss one, the first is left out."""
    draw = random.Random(seed)
    names = draw.sample(sorted(set(EFFECTS) - OF_BODIES), draw.randint(2, 7))
    if "j2" in names and "orbit" not in names:
        names.append("orbit")
    while True:
        scene = Scene.model_validate(case())
        keys = {name: validated(EFFECTS[name], STRONG[name]) for name in names}
        update: dict[str, Any] = {"effects": scene.effects.model_copy(update=keys)}
        if "launch_force" in names:
            update["launch"] = None
        wrongs = list(cross_checks(scene.model_copy(update=update)))
        if not wrongs:
            return tuple(sorted(names))
        names.remove(str(wrongs[0].path[0]))


def test_the_draws_reach_every_effect() -> None:
    drawn = {name for seed in range(30) for name in subset(seed)}
    assert drawn == set(EFFECTS) - OF_BODIES
    assert set(STRONG) == set(EFFECTS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
@every_backend
def test_energy_balances_with_any_effects(seed: int, backend: str) -> None:
    """Relative to the energy in play, which is not larger than what is turned over."""
    on = subset(seed)
    run = simulate(start_with(*on, engine={"backend": backend}))
    turned_over = np.abs(np.diff(run.kinetic)).sum() + run.kinetic[0]
    assert turned_over > 0.5, on
    assert energy_balance(run) < 1e-5, on


# What each effect may leave: parts of the linear term, changes of the law, kernels; functions in the kernel.
LEAVES = {
    "gravity": ({"load"}, {"add_load"}),
    "mass_damping": ({"damping"}, {"add_velocity_product"}),
    "material_damping": ({"relaxation_time"}, {"add_viscous_tension"}),
    "orbit": ({"gyroscopic", "kernels"}, {"add_velocity_product", "add_two_body"}),
    "rayleigh_damping": ({"damping"}, {"add_velocity_product"}),
    "air_drag": ({"kernels"}, {"add_cross_flow", "add_bullet_drag"}),
    "bending": ({"stiffness"}, {"add_position_product"}),
    "breaking": ({"breaking_strain", "memory", "switch"}, set()),
    "contact": ({"kernels", "memory"}, {"add_thread_contact"}),
    "j2": (
        {"gyroscopic", "kernels", "stiffness"},
        {"add_velocity_product", "add_two_body", "add_position_product"},
    ),
    "launch_force": ({"kernels"}, {"add_gas_launch"}),
    "molecular_drag": ({"kernels"}, {"add_molecular_drag"}),
    "self_contact": ({"kernels", "memory"}, {"add_together", "add_pair"}),
    "solar_pressure": ({"load"}, {"add_load"}),
    "thermal_strain": ({"free_strain"}, set()),
    "thrust": ({"kernels", "memory", "switch"}, {"add_thrust"}),
}


def source_of(start: Start) -> str:
    return text_of(net_kernel(start.system.forces))


def filled(forces: Forces) -> set[str]:
    """What there is beside the bare elements, by name."""
    linear, law = forces.linear or LinearTerm(), forces.cable.changes
    parts = {name: getattr(linear, name) for name in ("damping", "gyroscopic", "stiffness", "load")}
    parts |= {name: getattr(law, name) for name in ElementLaw.__dataclass_fields__}
    parts |= {"kernels": forces.kernels or None}
    parts |= {"memory": forces.memories or None, "switch": forces.switches or None}
    assert forces.linear is None or any(parts[name] is not None for name in list(parts)[:4])
    return {name for name, value in parts.items() if value is not None}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_absent_effect_leaves_nothing(name: str) -> None:
    """With every other effect's terms as without any: only its own appear when it is on."""
    on = ("orbit", "j2") if name == "j2" else (name,)
    more = {"bodies": {"ball": BALL}} if name in OF_BODIES else {}
    bare, with_it = start_with(**more), start_with(*on, **more)
    fields, functions = LEAVES[name]
    assert filled(bare.system.forces) == set()
    assert filled(with_it.system.forces) == fields
    plain, source = source_of(bare), source_of(with_it)
    for function in functions:
        assert f"def {function}(" in source
        assert function not in plain
    own = {line for line in source.splitlines() if line.startswith("def add_")}
    base = {line for line in plain.splitlines() if line.startswith("def add_")}
    assert {line.split("(")[0] for line in own - base} == {f"def {function}" for function in functions}
    # Twice the same bare net: the same text, so the same machine code.
    assert source_of(start_with(**more)) == plain
    items = model(start_with(engine={"backend": "exudyn"})).items()
    assert set(items) == {"MassPoint", "ObjectConnectorSpringDamper"}
    assert items["MassPoint"] == bare.net.n_nodes


def test_effects_without_a_function_of_their_own_do_not_change_the_code() -> None:
    """Thermal strain and breaking change numbers only; a limit is looked at by the run, not by the kernel."""
    assert source_of(start_with("thermal_strain", "breaking")) == source_of(start_with())


def test_zero_coefficients_leave_nothing_either() -> None:
    for name, keys in {
        "mass_damping": {"alpha": 0.0},
        "rayleigh_damping": {"alpha": 0.0, "beta": 0.0},
        "material_damping": {"relaxation_time": 0.0},
        "bending": {"modulus": 0.0},
        "thermal_strain": {"temperature_change": 0.0, "expansion_coefficient": 1e-5},
    }.items():
        start = prepare(Scene.model_validate(case() | {"effects": {name: keys}}))
        assert filled(start.system.forces) == set(), name
