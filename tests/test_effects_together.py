"""Effects together: the energy balance of random subsets, and no trace of an effect that is absent."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scenes import model, text_of

from exunet.base.record import config_of
from exunet.forces.cable_term import ElementLaw
from exunet.forces.effects import EFFECTS, cross_checks
from exunet.forces.linear_term import LinearTerm
from exunet.forces.total import Forces
from exunet.kernels.kernel import net_kernel, term_kernel
from exunet.model.effect_survey import setting_of
from exunet.model.energy import potential
from exunet.model.system import System
from exunet.results.measures import energy_balance
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate

CABLE = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e8}
AXES = {"radial": [0.0, 0.6, 0.8], "along_track": [1.0, 0.0, 0.0]}

# Strong enough that each turns over energy within the half second of the scene.
STRONG: dict[str, dict[str, Any]] = {
    "gravity": {"acceleration": [1.0, -2.0, -9.0]},
    "mass_damping": {"alpha": 0.5},
    "material_damping": {"relaxation_time": 1e-3},
    "orbit": {"mean_motion": 0.5, "model": "two_body", **AXES},
    "rayleigh_damping": {"alpha": 0.2, "beta": 1e-5},
    "air_drag": {"density": 1.2, "drag_coefficient": 1.1, "bullet_drag_coefficient": 0.5,
                 "bullet_area": 0.01},
    "bending": {"modulus": 1e9},
    "breaking": {"strain": 0.02},
    "contact": {"threads": ["ball"], "law": "linear", "stiffness": 1e3, "damping": 0.1,
                "friction": {"law": "sticking", "coefficient": 0.3}},
    "j2": {"mean_motion": 0.5, "inclination": 1.0, "argument_of_latitude": 0.5, **AXES},
    "launch_force": {"kind": "gas", "force": 30.0, "stroke": 0.1, "spread_angle": 0.8, "chaser_mass": 3.0,
                     "dead_length": 0.2, "exponent": 1.4},
    "molecular_drag": {"density": 1e-4, "flow": [-300.0, 50.0, 0.0], "drag_coefficient": 2.2,
                       "bullet_area": 0.01},
    "self_contact": {"stiffness": 1e5, "radius": 0.002, "damping": 0.5},
    "solar_pressure": {"flux": 1e10, "direction": [0.0, 1.0, 0.0], "pressure_coefficient": 1.3,
                       "bullet_area": 0.01},
    "thermal_strain": {"temperature_change": -80.0, "expansion_coefficient": 1e-4},
    "thrust": {"bullets": [0, 3], "time": [0.05, 0.1, 0.22],
               "force": [[0.0, 0.0, 20.0], [5.0, 0.0, 10.0], [0.0, -8.0, 0.0]]},
}  # fmt: skip


BALL = {"shape": "sphere", "radius": 0.5, "mass": 10.0, "position": [0.0, 0.0, 2.0]}
OF_BODIES = {"contact"}  # without a body there is nothing to touch; see tests/contact


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


def balanced(seed: int, form: str) -> None:
    on = subset(seed)
    engine = {"backend": form}
    run = simulate(start_with(*on, engine=engine))
    turned_over = np.abs(np.diff(run.kinetic)).sum() + run.kinetic[0]
    assert turned_over > 0.5, on
    # Of the energy in play (metrics.energy_balance), which is not larger than what is turned over.
    assert energy_balance(run) < 1e-5, on


@pytest.mark.slow
@pytest.mark.parametrize(("form", "seed"), [
    ("exudyn", 0), ("exudyn", 1),
    pytest.param("compiled", 0, marks=pytest.mark.slow),
])  # fmt: skip
def test_energy_balances_with_some_effects(form: str, seed: int) -> None:
    balanced(seed, form)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 30))
@pytest.mark.parametrize("form", ["exudyn", "compiled"])
def test_energy_balances_with_any_effects(seed: int, form: str) -> None:
    balanced(seed, form)


# Pay for use


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


def test_a_net_that_had_its_effects_removed_costs_as_much_as_a_bare_one() -> None:
    """The same machine code on numbers of the same kinds and sizes, so the same work; and not so before."""
    bare = start_with()
    loaded = start_with("air_drag", "bending", "material_damping")
    emptied = replace(loaded, system=System(loaded.system.blocks, Forces.of(loaded.net)))
    one, other, more = (net_kernel(start.system.forces) for start in (bare, emptied, loaded))
    assert text_of(other) == text_of(one)
    assert len(other.calls) == len(one.calls) < len(more.calls)
    for mine, theirs in zip(*(chain.from_iterable(k.table().data) for k in (other, one)), strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert np.asarray(mine).dtype == np.asarray(theirs).dtype
    assert text_of(more) != text_of(one)


def test_the_potential_of_kernel_terms_is_that_of_their_force() -> None:
    """Central differences of the potential of the launch against its force, in and out of the barrels."""
    start = start_with("launch_force")
    forces, chaser = start.system.forces, start.system.blocks.body["chaser"]
    still = np.zeros_like(start.position)
    place = start.position.copy()
    place[start.net.bullet_nodes] *= 1.01  # away from the start, where the force of gas has a kink
    place[start.net.bullet_nodes[0]] += [0.03, 0.02, 0.01]
    place[start.net.bullet_nodes[1]] += [-1.0, 1.0, 2.0]
    force = term_kernel(forces.kernels).forces(0.0, place, still)
    for node in (*start.net.bullet_nodes[:3], chaser):
        for axis in range(3):
            off = np.zeros_like(place)
            off[node, axis] = 1e-6
            ends = potential(forces, np.stack([place + off, place - off]).reshape(2, -1))
            assert -(ends[0] - ends[1]) / 2e-6 == pytest.approx(force[node, axis], abs=1e-5)


def test_settings_know_the_launch() -> None:
    start = start_with("launch_force")
    setting = setting_of(start.scene)
    assert setting.net.n_nodes == start.net.n_nodes == start.system.blocks.n_points - 1
    assert np.linalg.norm(setting.velocity[setting.net.bullet_nodes], axis=1).min() > 1.0
