"""Effects: both codes, energy of random subsets, no trace of what is absent, estimates of their changes."""

from __future__ import annotations

import math
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import (
    CASES,
    EFFECT_CASES,
    STRONG,
    chain,
    every_backend,
    model,
    opening,
    text_of,
)

from exunet.base.errors import CaseError
from exunet.forces.cable_term import ElementLaw
from exunet.forces.effects import EFFECTS, Effects, cross_checks, launch_force, material_damping, orbit
from exunet.forces.environment import EARTH_RADIUS
from exunet.forces.estimate import EstimateBasis, hardest_strain, snap_of
from exunet.forces.linear_term import LinearTerm
from exunet.forces.total import Forces
from exunet.kernels.kernel import Kernel
from exunet.model.effect_survey import Advice, finding, setting_of, survey
from exunet.results.measures import energy_balance
from exunet.scene.casefile import load
from exunet.scene.scene import Scene
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate
from exunet.studies.ablation import ablate

SOFT = {"diameter": 0.002, "density": 1390.0, "youngs_modulus": 1e8}

BALL = {"shape": "sphere", "radius": 0.5, "mass": 10.0, "position": [0.0, 0.0, 2.0]}
WITH_A_BODY = ("contact", "launch_force")
OF_BODIES = {"contact"}  # without a body there is nothing to touch; contact has tests of its own


def case(on: tuple[str, ...] = (), **more: Any) -> dict[str, Any]:
    launch = {"launch": {"radial_speed": 2.5, "axial_speed": 1.0}}
    return {
        "format": 1,
        "title": "a net that stretches, bends and snaps",
        "time": {"end": 0.3, "output_step": 0.02},
        "solver": {"method": "DOPRI5", "tolerance": 2e-9},
        "net": {
            "topology": "square", "size": 2.0, "mesh": 1.0, "divisions": 2, "cable": SOFT,
            "strings": {"length": 0.5, **SOFT}, "bullets": {"mass": 0.2},
        },
        "initial": {"packing": 0.9, "spin": [0.2, 0.5, 1.0]},
        "effects": {name: STRONG[name] for name in on},
    } | ({"bodies": {"ball": BALL}} if "launch_force" in on else launch) | more  # fmt: skip


def start_with(*on: str, **more: Any) -> Start:
    return prepare(Scene.model_validate(case(on, **more)))


def subset(seed: int) -> tuple[str, ...]:
    """Effects drawn at random; of those that contradict each other or miss one, the first is left out."""
    draw = random.Random(seed)
    names = draw.sample(sorted(set(EFFECTS) - OF_BODIES), draw.randint(2, 7))
    if "j2" in names and "orbit" not in names:
        names.append("orbit")
    while True:
        scene = Scene.model_validate(case(bodies={"ball": BALL}))
        update: dict[str, Any] = {"effects": Effects(**{name: STRONG[name] for name in names})}
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


@pytest.mark.ci_for("compiled-7")
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
    "breaking": ({"breaking_strain", "discrete", "switch"}, {"add_no_force"}),
    "contact": ({"kernels", "discrete"}, {"add_thread_contact"}),
    "j2": (
        {"gyroscopic", "kernels", "stiffness"},
        {"add_velocity_product", "add_two_body", "add_position_product"},
    ),
    "launch_force": ({"kernels", "discrete", "switch"}, {"add_launch_of_body"}),
    "molecular_drag": ({"kernels"}, {"add_molecular_drag"}),
    "self_contact": ({"kernels", "discrete"}, {"add_together", "add_pair"}),
    "solar_pressure": ({"load"}, {"add_load"}),
    "thermal_strain": ({"free_strain"}, set()),
    "thrust": ({"kernels", "discrete", "switch"}, {"add_thrust"}),
}


def source_of(start: Start) -> str:
    return text_of(Kernel(start.system.forces))


def filled(forces: Forces) -> set[str]:
    """What there is beside the bare elements, by name."""
    linear, law = forces.linear or LinearTerm(), forces.cable.changes
    parts = {name: getattr(linear, name) for name in ("damping", "gyroscopic", "stiffness", "load")}
    parts |= {name: getattr(law, name) for name in ElementLaw.__dataclass_fields__}
    parts |= {"kernels": forces.kernels or None}
    parts |= {"discrete": forces.discrete_states or None, "switch": forces.switches or None}
    assert forces.linear is None or any(parts[name] is not None for name in list(parts)[:4])
    return {name for name, value in parts.items() if value is not None}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_absent_effect_leaves_nothing(name: str) -> None:
    """With every other effect's terms as without any: only its own appear when it is on."""
    on = ("orbit", "j2") if name == "j2" else (name,)
    more = {"bodies": {"ball": BALL}} if name in WITH_A_BODY else {}
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


def test_an_effect_without_a_function_of_its_own_does_not_change_the_code() -> None:
    """Thermal strain changes numbers only."""
    assert source_of(start_with("thermal_strain")) == source_of(start_with())


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


def test_the_hardest_snap_is_that_of_the_largest_strain() -> None:
    """v sqrt(mu / (EA L)): 3 sqrt(0.2083 / 500) of the first element, 4 sqrt(0.5556 / 2000) of the second."""
    snap = snap_of(chain())
    reduced, other = 1.0 / (1.0 / 1.25 + 1.0), 1.0 / (1.0 / 0.25 + 1.0 / 1.25)
    assert 3.0 * math.sqrt(other / 500.0) < 4.0 * math.sqrt(reduced / 2000.0)
    assert snap.speed == 4.0
    assert snap.strain == pytest.approx(4.0 * math.sqrt(reduced / 2000.0), rel=1e-12)
    assert snap.frequency == pytest.approx(math.sqrt(1000.0 / 2.0 / reduced), rel=1e-12)


@pytest.mark.parametrize("duration", [0.4, 5.0])
def test_the_nominal_motion_opens_the_net_as_the_bullets_fly(duration: float) -> None:
    """0.9 sqrt(2) m at 2 m/s; 12 kg of cable and 12 kg of bullets, which alone rise at the start."""
    basis = opening(duration)
    net, time = basis.net, 0.9 * math.sqrt(2.0) / 2.0
    assert basis.opening_time == pytest.approx(time, rel=1e-12)
    # 12 sides of 1 kg; a corner ends two of them: 1 kg, and its bullet.
    rise = 4.0 * 4.0 / (12.0 + 12.0)
    wanted = 0.9 * net.reference_position / time + [0.0, 0.0, rise]
    wanted[net.bullet_nodes] = basis.velocity[net.bullet_nodes]
    np.testing.assert_allclose(basis.motion, wanted, rtol=1e-12, atol=1e-14)
    half = 0.5 * min(duration, time)
    np.testing.assert_allclose(basis.middle, basis.position + half * wanted, rtol=1e-12, atol=1e-14)
    assert basis.rms(wanted) == pytest.approx(
        math.sqrt(float(net.mass @ (wanted**2).sum(axis=1)) / 24.0), rel=1e-12
    )


def test_the_hardest_strain_is_of_a_bullet_that_one_element_stops() -> None:
    """sqrt(m v^2 / (EA L)) of 4 kg at the speed relative to the mean of the motion."""
    basis = opening(0.4)
    relative = basis.velocity[basis.net.bullet_nodes] - basis.motion.mean(axis=0)
    assert np.ptp(np.linalg.norm(relative, axis=1)) < 1e-12
    strain = math.sqrt(4.0 * float(relative[0] @ relative[0]) / 1000.0)
    assert strain > snap_of(basis).strain
    assert hardest_strain(basis) == pytest.approx(strain, rel=1e-12)
    stiffness, length = np.linspace(1.0, 0.5, 12), np.linspace(0.3, 1.5, 12)  # EA L is least of the first
    net = replace(basis.net, youngs_modulus=1e6 * stiffness, reference_length=length)
    mixed = replace(basis, net=net)
    assert hardest_strain(mixed) == pytest.approx(strain / math.sqrt(0.3), rel=1e-12)


def test_ways_of_constant_accelerations_and_decaying_speeds() -> None:
    basis = opening(0.4)
    assert basis.ballistic(3.0) == pytest.approx(0.5 * 3.0 * 0.16, rel=1e-12)
    time = np.linspace(0.0, 0.4, 20001)
    for rate in (1e-6, 2e-4, 0.5, 30.0):  # the first two lose less than 1e-4, where digits would cancel
        way = basis.speed * np.trapezoid(-np.expm1(-rate * time), time)
        assert basis.braked(rate) == pytest.approx(way, rel=1e-4)


def test_a_launch_lags_behind_by_its_stroke_or_makes_the_way() -> None:
    """Springs of 60 N over 0.1 m do 3 J on bullets of 4 kg; 16 of 24 kg are the bullets'."""
    keys = launch_force.SpringLaunchForce.model_validate(
        {"kind": "spring", "force": 60.0, "stroke": 0.1, "spread_angle": 0.6, "body": "chaser"}
    )
    basis = opening(0.4)
    part = math.sqrt(16.0 / 24.0)
    flying = keys.magnitude(basis)
    assert flying.displacement == pytest.approx(0.1 * part, rel=1e-12)
    still = EstimateBasis(basis.net, 0.4, basis.position, np.zeros((9, 3)))
    launched = keys.magnitude(still)
    assert launched.displacement == pytest.approx(math.sqrt(2.0 * 3.0 / 4.0) * 0.4 * part, rel=1e-12)
    assert flying.acceleration == launched.acceleration == pytest.approx(60.0 / 4.0 * part, rel=1e-12)


def test_material_damping_takes_speed_in_the_hardest_snap() -> None:
    """v (1 - exp(-pi tau omega / 2)) over half of the time; beyond critical damping all of it."""
    basis = opening(0.4)
    snap = snap_of(basis)
    for ratio in (0.1, 0.7, 1.5):
        keys = material_damping.MaterialDamping(relaxation_time=2.0 * ratio / snap.frequency)
        found = keys.magnitude(basis)
        lost = 1.0 - math.exp(-math.pi * ratio) if ratio < 1.0 else 1.0
        assert found.displacement == pytest.approx(lost * basis.speed * 0.2, rel=1e-12)
        assert found.acceleration == pytest.approx(2.0 * ratio * snap.frequency * basis.speed, rel=1e-12)


def test_the_orbit_accelerates_the_nominal_motion_as_its_forces_do() -> None:
    """With 2 rad/s, Coriolis force and gradient are alike; without symmetry their signs matter."""
    keys = orbit.Orbit.model_validate(
        {"mean_motion": 2.0, "radial": [0.0, 0.6, 0.8], "along_track": [1.0, 0.0, 0.0], "model": "linear"}
    )
    basis = chain()
    (term,) = keys.terms(basis.blocks)
    force = -(term.gyroscopic @ basis.motion.ravel()) - term.stiffness @ basis.middle.ravel()
    wanted = basis.of_force(force.reshape(-1, 3))
    found = keys.magnitude(basis)
    assert found.acceleration == pytest.approx(wanted, rel=1e-12)
    assert found.displacement == pytest.approx(basis.ballistic(wanted), rel=1e-12)


PLANAR = CASES / "planar_deployment.toml"
IN_ORBIT = EFFECT_CASES / "orbit.toml"

# Case, overrides, effect: the list of docs/explanation/effects.md, in its order.
EARLY = ("time.end=1.2", "time.output_step=0.05")
EARLIER = ("time.end=0.5", "time.output_step=0.05")  # before snaps multiply what is so small
PAIRS: list[tuple[str, tuple[str, ...], str]] = [
    ("planar_deployment.toml", EARLY, "orbit"),
    ("planar_deployment.toml", EARLY, "gravity"),
    ("planar_deployment.toml", EARLY, "rayleigh_damping"),
    ("planar_deployment.toml", EARLY, "mass_damping"),
    ("planar_deployment.toml", EARLY, "launch_force"),
    ("planar_deployment.toml", EARLIER, "solar_pressure"),
    ("planar_deployment.toml", EARLIER, "molecular_drag"),
    ("planar_deployment.toml", EARLY, "air_drag"),
    ("planar_deployment.toml", EARLY, "bending"),
    ("effects/air_drag.toml", (), "air_drag"),
    ("effects/bending.toml", (), "bending"),
    ("effects/breaking.toml", (), "breaking"),
    ("effects/j2.toml", (), "j2"),
    ("effects/launch_force.toml", (), "launch_force"),
    ("effects/mass_damping.toml", (), "mass_damping"),
    ("effects/material_damping.toml", (), "material_damping"),
    ("effects/molecular_drag.toml", (), "molecular_drag"),
    ("effects/orbit.toml", (), "orbit"),
    ("effects/parabolic_flight.toml", (), "gravity"),
    ("effects/solar_pressure.toml", (), "solar_pressure"),
    ("effects/thermal_strain.toml", (), "thermal_strain"),
]


@pytest.mark.parametrize(
    ("path", "overrides", "name"),
    [
        pytest.param(
            *pair,
            id=f"{Path(pair[0]).stem}-{pair[2]}",
            marks=[] if pair[0] == "effects/bending.toml" else pytest.mark.slow,
        )
        for pair in PAIRS
    ],
)
def test_an_estimate_is_right_within_a_factor_of_three(
    path: str, overrides: tuple[str, ...], name: str
) -> None:
    (toggled,) = ablate(load(CASES / path, overrides).scene, (name,))
    assert toggled.failure == ""
    assert toggled.until > 0.0
    assert toggled.ratio is not None
    assert 1 / 3 < toggled.ratio < 3, toggled


def test_the_orbit_in_the_papers_case() -> None:
    """Paper, sec. 3.1 and 4: gravitational, centrifugal and Coriolis forces disregarded for 2 s.

    By hand: 2 n v for the bullets (0.5 kg of 0.59 kg a corner), n = 1.060e-3 rad/s at 700 km, v = 2.5 m/s,
    turned in the plane where only the in-plane normal counts: |h x v| averages v / sqrt 2 over the four
    diagonals. Relative to the 7 m from bullet to bullet.
    """
    found = finding(load(PLANAR).scene, "orbit")
    assert found.estimate is not None
    coriolis = 2 * 1.060e-3 * 2.5 / math.sqrt(2)
    assert found.estimate.acceleration == pytest.approx(coriolis, rel=0.1)
    assert found.relative == pytest.approx(0.5 * coriolis * 2.0**2 / 7.0, rel=0.1)


# Keys that an acceleration is proportional to, whatever the scene.
PROPORTIONAL = {
    "air_drag": "density",
    "bending": "modulus",
    "gravity": "acceleration",
    "mass_damping": "alpha",
    "material_damping": "relaxation_time",
    "molecular_drag": "density",
    "solar_pressure": "flux",
    "thermal_strain": "expansion_coefficient",
}


@pytest.mark.parametrize("name", ["effects/mass_damping", "missions/throw_close_tow"])
def test_numerical_damping_is_never_advised(name: str) -> None:
    """Nor is what belongs on the ground."""
    found = {item.name: item for item in survey(load(CASES / f"{name}.toml").scene)}
    advice = {key: item.advice(1e-12) for key, item in found.items()}
    assert advice["mass_damping"] == advice["rayleigh_damping"] == Advice.NUMERICAL
    assert advice["gravity"] is Advice.GROUND
    assert advice["orbit"] is Advice.CONSIDER
    if found["contact"].on:
        assert advice["contact"] is Advice.KEEP


@pytest.mark.parametrize("path", sorted(EFFECT_CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_effect_is_estimated_on_every_case(path: Path) -> None:
    """What must hold whatever the numbers: proportions, growth with time."""
    scene = load(path).scene
    for item in survey(scene):
        if item.estimate is None:
            assert EFFECTS[item.name].nominal(setting_of(scene, item.name)) is None
            assert not item.on
            continue
        basis = setting_of(scene, item.name)
        given = getattr(scene.effects, item.name)
        assert (item.keys == given) != bool(item.assumption)
        assert item.relative == pytest.approx(item.estimate.displacement / basis.size, rel=1e-12)
        longer = finding(scene, item.name, 2.0 * scene.time.end).estimate
        assert longer is not None
        assert 0.0 <= item.estimate.displacement <= longer.displacement * (1.0 + 1e-12)
        key = PROPORTIONAL.get(item.name)
        if key is None or getattr(item.keys, key) is None:
            continue
        twice = item.keys.model_copy(update={key: (2.0 * np.array(getattr(item.keys, key))).tolist()})
        more = twice.magnitude(basis)
        assert more.acceleration == pytest.approx(2.0 * item.estimate.acceleration, rel=1e-3)


def test_speeds_count_as_often_as_the_law_of_each_drag_says() -> None:
    """The same way twice as fast, in half the time: drag as its square, damping as itself."""

    def launched(speed: float, name: str) -> float:
        speeds = [f"launch.{key}_speed={speed}" for key in ("radial", "axial")]
        found = finding(
            load(EFFECT_CASES / "air_drag.toml", speeds).scene, name, duration=0.2 / speed
        ).estimate
        assert found is not None
        return found.acceleration

    for name, power in (("air_drag", 2), ("mass_damping", 1), ("gravity", 0)):
        assert launched(2.0, name) == pytest.approx(2.0**power * launched(1.0, name), rel=1e-9), name


# The automatic choice


def test_auto_switches_on_what_matters() -> None:
    start = prepare(load(EFFECT_CASES / "auto.toml", ["effects.threshold=3e-3"]).scene)
    on = set(start.scene.effects.on)
    assert "mass_damping" in on
    assert not on & {"orbit", "solar_pressure"}
    linear = start.system.forces.linear
    assert linear is not None
    assert linear.gyroscopic is None
    lower = prepare(load(EFFECT_CASES / "auto.toml", ["effects.threshold=1e-12"]).scene).scene.effects
    assert all(getattr(lower, name) for name in ("mass_damping", "orbit", "solar_pressure", "bending"))


@pytest.mark.slow
def test_an_ablation_under_auto_toggles_what_auto_came_to() -> None:
    """A candidate left off is switched on, and one without a table too, whatever the threshold."""
    scene = load(EFFECT_CASES / "auto.toml").scene
    for item in ablate(scene, ("orbit", "rayleigh_damping", "mass_damping")):
        assert item.ratio is not None
        assert 1 / 3 < item.ratio < 3


# What a case must have

DRAG = "{flow=[1.0,0.0,0.0], drag_coefficient=2.2, bullet_area=1e-3"
AIR = "density=1.2,drag_coefficient=1.0,bullet_drag_coefficient=0.5"
AXES = "radial=[0.0,0.0,1.0], along_track=[1.0,0.0,0.0]"
ON_ORBIT = f'effects.orbit={{altitude=7e5, {AXES}, model="linear"}}'
GUN = "force=1.0,stroke=0.1,spread_angle=0.1,body='chaser'"
CHASER = "bodies.chaser={mass=1.0, inertia=[1.0, 1.0, 1.0]}"
SUN = "{flux=1.0,direction=[0,0,0],pressure_coefficient=1.0,bullet_area=0.0}"
BREAKING = ["effects.rayleigh_damping=", "effects.breaking.strain=0.1"]
J2 = f"effects.j2={{altitude=7e5, {AXES}, inclination=1.0, argument_of_latitude=0.0}}"
LONG = "time={end=400.0,output_step=1.0}"  # J2 holds for 296 s of this orbit
WARM = "effects.thermal_strain={temperature_change=1e4,expansion_coefficient=1e-3}"
FAULTS = {
    "orbit without altitude": ("effects.orbit", [f'effects.orbit={{{AXES}, model="linear"}}']),
    "drag without density": ("effects.molecular_drag", [f"effects.molecular_drag={DRAG}}}"]),
    "drag with both": ("effects.molecular_drag.altitude",
                       [f"effects.molecular_drag={DRAG}, density=1e-9, altitude=3e5}}"]),
    "too low": ("effects.molecular_drag.altitude", [f"effects.molecular_drag={DRAG}, altitude=1e4}}"]),
    "no area of bullets": ("effects.air_drag.bullet_area", [f"effects.air_drag={{{AIR}}}"]),
    "two gravities": ("effects.gravity", ["effects.gravity.acceleration=[0,0,-9]", ON_ORBIT]),
    "two atmospheres": ("effects.air_drag", [f"effects.air_drag={{{AIR},bullet_area=1e-3}}",
                                             f"effects.molecular_drag={DRAG}, density=1e-9}}"]),
    "two heights": ("effects.molecular_drag.altitude",
                    [f"effects.molecular_drag={DRAG}, altitude=3e5}}", ON_ORBIT]),
    "J2 without an orbit": ("effects.j2", [J2]),
    "J2 of a long scene": ("effects.j2", [ON_ORBIT, J2, LONG]),
    "two launches": ("effects.launch_force", [CHASER, f'effects.launch_force={{kind="spring",{GUN}}}']),
    "gas without a volume": ("effects.launch_force.dead_length",
                             [CHASER, "launch=", f'effects.launch_force={{kind="gas",exponent=1.4,{GUN}}}']),
    "two limits": ("effects.breaking.force", ["effects.breaking={strain=0.1,force=3.0}"]),
    "breaking with eq. (13)": ("effects.breaking", ["effects.breaking.strain=0.1"]),
    "breaking with Verlet": ("effects.breaking", [*BREAKING, "solver={method='VelocityVerlet'}"]),
    "auto without a threshold": ("effects.threshold", ["effects.choose=auto"]),
    "a threshold without auto": ("effects.threshold", ["effects.threshold=0.1"]),
    "two kinds of launch": ("launch", ["launch.speed=3.0"]),
    "an absurd strain": ("effects.thermal_strain", [WARM]),
    "light without a direction": ("effects.solar_pressure.direction", [f"effects.solar_pressure={SUN}"]),
}  # fmt: skip


@pytest.mark.parametrize("what", FAULTS)
def test_keys_that_are_missing_or_contradict_others(what: str) -> None:
    key, overrides = FAULTS[what]
    with pytest.raises(CaseError) as caught:
        load(PLANAR, overrides)
    assert {fault.key for fault in caught.value.faults} == {key}


@pytest.mark.parametrize(
    "override",
    [
        "effects.gravity.acceleration=[0.0,0.0,1e300]",
        "effects.material_damping.relaxation_time=1e300",
        "effects.bending.modulus=1e300",
        f'effects.orbit={{mean_motion=1e-300, {AXES}, model="two_body"}}',
    ],
)
def test_numbers_that_overflow_are_refused(override: str) -> None:
    scene = load(PLANAR, [override]).scene
    name = override.split("effects.")[1].split("=")[0].split(".")[0]
    with pytest.raises(CaseError, match=f"effects.{name}: "):
        prepare(scene)


@pytest.mark.parametrize(
    ("override", "height"),
    [("effects.orbit.altitude=400e3", 400e3), ("effects.orbit.along_track=[0.0,1.0,0.0]", None)],
)
def test_effects_assume_the_orbit_of_the_case(override, height):
    scene = load(IN_ORBIT, [override]).scene
    orbit = scene.effects.orbit
    height = height or orbit.altitude
    for name in ("j2", "molecular_drag"):
        found = finding(scene, name)
        assert not found.on
        assert found.keys.altitude == height
    assert finding(scene, "j2").keys.along_track == orbit.along_track
    flow = finding(scene, "molecular_drag").keys.flow
    speed = math.sqrt(3.986004418e14 / (EARTH_RADIUS + height))
    assert flow == pytest.approx(tuple(-speed * part for part in orbit.along_track), rel=1e-6)


def test_an_orbit_by_its_mean_motion_is_taken_too():
    scene = load(IN_ORBIT, ["effects.orbit.altitude=", "effects.orbit.mean_motion=1.1e-3"]).scene
    assert finding(scene, "j2").keys.mean_motion == 1.1e-3
    assert finding(scene, "molecular_drag").keys.altitude == pytest.approx(528.2e3, abs=200.0)


def test_nothing_is_assumed_below_the_known_atmosphere():
    assert finding(load(IN_ORBIT, ["effects.orbit.altitude=100e3"]).scene, "molecular_drag").keys is None
