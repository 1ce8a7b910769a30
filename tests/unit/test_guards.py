"""The guards: what stops a run, at which bound; steps that are refused; retries from the last good state."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from restarts import COARSE, engine
from scenes import BACKENDS, EFFECT_CASES, every_backend, pair_of_masses, thrown, with_any_effects

import exunet
from exunet.base.errors import CaseError, RunStopped
from exunet.forces.law import STRETCH_BOUND
from exunet.integrators.protocol import IntegrationFailed
from exunet.methods.method import Method, Plan, finer
from exunet.model import energy
from exunet.model.limits import SAFETY, largest_damping_rate, largest_frequency, stable_step
from exunet.model.states import States
from exunet.results.measures import energy_balance, energy_scale
from exunet.results.summary import summarise
from exunet.scene.scene import Scene
from exunet.simulation import integrate
from exunet.simulation.block import Observed
from exunet.simulation.guards import (
    ACTING,
    ENERGY_BOUND,
    SNAPPING,
    TOUCHING,
    TRANSLATION_PART,
    WORK_PART,
    EnergyScale,
    where_steps_fail,
)
from exunet.simulation.observers import GOOD_PART, EnergyBalance, EventLog
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.run import simulate

# Time, element, node and remedy are in every message of a divergence.
DIVERGED = re.compile(
    r"diverged at t = [\d.e+-]+ s: .* element is \d+ between nodes \d+ and \d+, .* node is \d+ at \(.*"
    r"(Use|Change) "
)
APART = [[-1, 0, 0], [1, 0, 0]]  # [m/s]


def thrown_until_it_stops(*arguments, **tables) -> RunStopped:
    with pytest.raises(RunStopped) as stop:
        exunet.run(thrown(*arguments, **tables))
    assert stop.value.result is not None
    return stop.value


def balance_of(start: Start, **how: int) -> EnergyBalance:
    balance = EnergyBalance(start.system, start.state, **how)
    balance.built(Plan(Method.RK44, step=1e-3), {}, 0.0)
    return balance


def moving(scale: float = 1.0) -> tuple[Start, np.ndarray, np.ndarray]:
    """Two masses of 0.5 kg that fly apart at 1 m/s each: E0 = 0.5 J, and no common translation."""
    start = prepare(pair_of_masses(initial={"packing": 0.5, "node_velocities": APART}))
    return start, start.position, start.velocity * scale


def look(start: Start, *states: tuple[np.ndarray, np.ndarray], **how: int) -> int:
    """Give the guards states that are stored every 0.1 s; return the number of valid states."""
    x, v = (np.array(part).reshape(len(states), -1) for part in zip(*states, strict=True))
    rows, balance = States(start.system, 0.1 * np.arange(len(states)), x, v, {}), balance_of(start, **how)
    judged = balance.judge(Observed(rows, [], [], [], balance.until_each(rows)))
    if judged.stop is not None:
        judged.stop.valid = judged.valid
        raise judged.stop
    return judged.valid


def gained(start: Start, position: np.ndarray, velocity: np.ndarray, taken: float = 0.0) -> list[float]:
    """What a state, after `taken` was dissipated [J], has added to the energy scale, and in all [J]."""
    scale = EnergyScale(States.of(start.system, start.state))
    (own,), (in_all,), _ = scale.gained(
        States.of(start.system, start.state.at(position, velocity)), np.array([taken])
    )
    return [own, in_all]


@pytest.mark.parametrize("part", [0.06, 0.04, -0.04, -0.06])
def test_energy_that_appears_or_vanishes_stops_the_run(part):
    """The kinetic energy of 0.5 J changes by that part; 0.025 J are allowed."""
    start, x, v = moving()
    states = (x, v), (x, v), (x, v * np.sqrt(1.0 + part))
    if abs(part) < ENERGY_BOUND:
        assert look(start, *states) == 3
        return
    word = "increased" if part > 0.0 else "decreased"
    with pytest.raises(RunStopped, match=f"the energy balance {word}.*by 0.03 J .allowed 0.025") as stop:
        look(start, *states)
    assert DIVERGED.match(str(stop.value))
    assert "snap" not in str(stop.value)  # both are slack
    assert stop.value.step_cause


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
@pytest.mark.parametrize("which", ["position", "velocity"])
def test_numbers_that_are_not_finite_stop_the_run_at_the_last_sound_state(bad, which):
    start, x, v = moving()
    broken = (x, v.copy()) if which == "velocity" else (x.copy(), v)
    broken[which == "velocity"][1, 2] = bad
    with pytest.raises(RunStopped, match=r"not finite; at t = 0\.1 s") as stop:
        look(start, (x, v), (x, v), broken)
    assert DIVERGED.match(str(stop.value))
    assert stop.value.valid == 2


def test_a_stretch_beyond_the_law_is_not_retried():
    """Masses that part at 12 m/s on EA = 10 N: E11 = v sqrt(mu / (EA L0)), so stretch 2.2."""
    scene = pair_of_masses(initial={"packing": 1.0, "node_velocities": [[-6, 0, 0], [6, 0, 0]]})
    strain = 12.0 * np.sqrt(0.25 / 10.0)
    assert np.sqrt(1.0 + 2.0 * strain) > STRETCH_BOUND
    with pytest.raises(RunStopped, match="element is longer than 2 times") as stop:
        exunet.run(scene)
    assert not stop.value.step_cause
    assert DIVERGED.match(str(stop.value))
    part = stop.value.result
    assert part is not None
    assert part.run.retries == ()
    assert np.sqrt(1.0 + 2.0 * part.strain.max()) < STRETCH_BOUND


@pytest.mark.parametrize(
    ("solver", "engine"),
    [
        ({"accuracy": 0.1}, "exudyn"),
        ({"method": "RK44", "step": 0.01}, "exudyn"),
        ({"method": "RK67", "step": 0.01, "force": True}, "exudyn"),
        ({"accuracy": 0.1}, "compiled"),
        ({"method": "RK44", "step": 0.01}, "compiled"),
        ({"method": "VelocityVerlet", "step": 0.01}, "compiled"),
    ],
    ids=str,
)
@pytest.mark.parametrize("output_step", [0.05, 0.5])
def test_no_result_holds_a_stretch_beyond_the_law(solver, engine, output_step):
    """As above, with so few states that the guards, which look at one in 32, pass over the peak.

    At the step 0.5 s no stored state has the peak, and the compiled loop does not keep each step.
    """
    initial = {"packing": 1.0, "node_velocities": [[-6, 0, 0], [6, 0, 0]]}
    time = {"end": 0.5, "output_step": output_step}
    scene = pair_of_masses(solver=solver, engine={"backend": engine}, initial=initial, time=time)
    with pytest.raises(RunStopped, match="element is longer than 2 times") as stop:
        exunet.run(scene)
    part = stop.value.result
    assert part is not None
    assert np.sqrt(1.0 + 2.0 * part.strain.max()) <= STRETCH_BOUND


def test_a_stretch_just_within_the_law_runs():
    """As above at 9 m/s: stretch 1.96."""
    scene = pair_of_masses(initial={"packing": 1.0, "node_velocities": [[-4.5, 0, 0], [4.5, 0, 0]]})
    run = exunet.run(scene)
    assert run.complete
    assert run.strain.max() > 1.2  # E11 at the stretch 1.84; stored states do not hit the peak


def test_a_light_node_that_runs_away_is_noticed_though_its_energy_is_small():
    scene = pair_of_masses().model_dump(mode="json")
    net = {
        "topology": "explicit",
        "nodes": [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        "elements": [[0, 1], [1, 2]],
        "node_masses": [1e3, 0.0, 1e3],
        "cable": {"area": 1e-9, "density": 10.0, "youngs_modulus": 1e5},
    }
    scene |= {"net": net, "initial": {"packing": 0.5, "node_velocities": [[-1, 0, 0], [0, 0, 0], [1, 0, 0]]}}
    start = prepare(Scene.model_validate(scene))
    wrong = start.velocity.copy()
    wrong[1] = [0.0, 3e3, 0.0]  # wave speed 100 m/s; 1e-8 kg, so 0.045 J of 1000 J
    with pytest.raises(RunStopped, match=r"moves at 3e\+03 m/s .*fastest node is 1"):
        look(start, (start.position, start.velocity), (start.position, wrong))


def test_guards_that_look_seldom_still_see_the_last_state_of_a_batch():
    start, x, v = moving()
    with pytest.raises(RunStopped):
        look(start, (x, v), (x, v), (x, 2 * v), every=100)
    with pytest.raises(RunStopped, match=r"diverged at t = 0\.1 s") as stop:
        look(start, (x, v), (x, 2 * v), (x, 2 * v), (x, v), every=2)  # and find the first that is wrong
    assert stop.value.valid == 1


def test_a_falling_net_may_turn_its_potential_into_motion():
    """Free fall for 3 s from rest: K grows from nothing to 4.4e2 J."""
    scene = thrown(
        {"method": "DOPRI5"}, end=3.0,
        launch={"radial_speed": 0.0, "axial_speed": 0.0},
        effects={"gravity": {"acceleration": [0.0, 0.0, -9.81]}},
    )  # fmt: skip
    run = exunet.run(scene)
    assert run.complete
    assert run.kinetic[-1] == pytest.approx(run.net.mass.sum() * (9.81 * 3.0) ** 2 / 2, rel=1e-9)


def test_a_net_at_rest_runs():
    run = exunet.run(thrown({"method": "DOPRI5"}, launch={"radial_speed": 0.0, "axial_speed": 0.0}))
    assert run.complete
    assert energy_balance(run) == 0.0


# Nets that nothing deforms: the errors are those of a translation, or of a body that has just met the net

AIR = {"density": 1.2, "drag_coefficient": 1.1}
BALL = {"shape": "sphere", "radius": 0.2, "mass": 1.0, "motion": "prescribed", "velocity": [0.0, 0.0, 5.0]}
CONTACT = {"threads": ["b"], "law": "linear", "stiffness": 1e3, "damping": 0.0}


def slack(end: float, modulus: float = 1e8, **tables: Any) -> dict[str, Any]:
    """A net of 2 m at rest, without bullets unless `net` is given."""
    cable = {"diameter": 2e-3, "density": 1390.0, "youngs_modulus": modulus}
    net = {"topology": "square", "size": 2.0, "meshes": 4, "cable": cable} | tables.pop("net", {})
    fixed = {"format": 1, "title": "slack", "time": {"end": end, "output_step": end}, "net": net}
    return fixed | {"initial": {"packing": 0.9}, **tables}


def run_of(tables: dict[str, Any], backend: str) -> exunet.Result:
    return exunet.run(with_any_effects(tables | {"engine": {"backend": backend}}))


@every_backend
@pytest.mark.parametrize("falls", [True, False])
def test_a_slack_net_in_air_is_not_stopped(backend, falls):
    """m v' = m g - rho C d v^2 / 2 of a thread across the flow: from rest; from 10 m/s without gravity."""
    gravity = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}} if falls else {}
    initial = {"packing": 0.9, "velocity": [0.0, 0.0, 0.0 if falls else -10.0]}
    run = run_of(slack(0.05, effects={"air_drag": AIR, **gravity}, initial=initial), backend)
    rate = 1.2 * 1.1 * 2e-3 / (2.0 * 1390.0 * np.pi / 4.0 * 2e-3**2)  # [1/m]
    terminal = np.sqrt(9.81 / rate)
    speed = terminal * np.tanh(9.81 * 0.05 / terminal) if falls else 10.0 / (1.0 + 10.0 * rate * 0.05)
    assert run.velocity[-1, :, 2] == pytest.approx(-speed, rel=1e-4)


@every_backend
@pytest.mark.parametrize(("alpha", "tolerance", "end"), [(2.0, 1e-8, 0.1), (20.0, 1e-10, 0.01)])
def test_adaptive_steps_of_a_slack_net_are_not_stopped(backend, alpha, tolerance, end):
    """v = g / alpha (1 - exp(-alpha t)); nothing deforms the net, so that its motion is the scale."""
    effects = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}, "mass_damping": {"alpha": alpha}}
    solver = {"method": "DOPRI5", "tolerance": tolerance, "retry": 0}
    run = run_of(slack(end, effects=effects, solver=solver), backend)
    speed = 9.81 / alpha * -np.expm1(-alpha * end)
    assert run.velocity[-1, :, 2] == pytest.approx(-speed, abs=20 * tolerance)  # of so many steps
    found = summarise(run)["energy"]
    assert found["scale_of"] == "motion"
    assert found["scale_J"] == pytest.approx(0.5 * run.net.mass.sum() * speed**2, rel=1e-6)


@every_backend
def test_a_thrust_that_is_switched_on_does_not_stop_a_net_at_rest(backend):
    """1 N on each of four bullets for 10 ms, with ramps of 1 us: 0.04 N s."""
    none, push = [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]
    keys = {"time": [0.03, 0.030001, 0.04, 0.040001], "force": [none, push, push, none]}
    effects = {"thrust": {"bullets": [0, 1, 2, 3], **keys}}
    run = run_of(slack(0.05, effects=effects, net={"bullets": {"mass": 0.25}}), backend)
    assert run.momentum[-1] == pytest.approx([0.0, 0.0, 0.04], abs=1e-9)


@pytest.mark.parametrize(("tied", "end"), [(False, 0.015), (True, 0.05)])
def test_a_prescribed_body_may_meet_a_net_at_rest(tied, end):
    """Exudyn's VelocityVerlet has the work of the body to first order in the step."""
    body = BALL | {"position": [0.0, 0.0, -0.25]}
    body |= {"attachments": {"x": {"node": 12, "point": [0.0, 0.0, 0.25]}}} if tied else {}
    tables = {"bodies": {"b": body}, "effects": {} if tied else {"contact": CONTACT}}
    run = run_of(slack(end, solver={"method": "VelocityVerlet", "retry": 0}, **tables), "exudyn")
    assert run.kinetic[-1] > 0.0


def test_a_pilot_run_ignores_round_off():
    """A slack thread on one free ball: nothing deforms, so that `SAFETY` of the stable step is right."""
    ends = {name: {"point": [x, 0.0, 0.0], "node": int(x)} for name, x in (("x", 0.0), ("y", 1.0))}
    tables = slack(0.2, 1e9, bodies={"b": BALL | {"motion": "free", "attachments": ends}})
    nodes = {"topology": "explicit", "nodes": [[0, 0, 0], [1, 0, 0]], "elements": [[0, 1]]}
    tables |= {"net": nodes | {"cable": tables["net"]["cable"]}, "solver": {"method": "RK44"}}
    tables |= {"initial": {"packing": 1.0}, "effects": {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}}
    start = prepare(with_any_effects(tables))
    assert start.plan.step == pytest.approx(
        SAFETY * stable_step(Method.RK44, largest_frequency(start.system))
    )


DAMPS = {"effects": {"mass_damping": {"alpha": 1.0}}}
TOUCHES = {"effects": {"contact": CONTACT}, "bodies": {"b": BALL | {"position": [0.6, 0.0, 0.0]}}}


@pytest.mark.parametrize(
    ("stretch", "tables", "where"),
    [(1.1, DAMPS, SNAPPING), (0.5, DAMPS, ACTING), (0.9, TOUCHES, TOUCHING), (0.9, {}, "")],
    ids=["taut", "damped", "touching", "none"],
)
def test_the_cause_of_an_error_is_what_acts(stretch, tables, where):
    start = prepare(pair_of_masses(initial={"packing": 0.5}, **tables))
    moved = start.state.at(start.position * stretch / 0.5, start.velocity)
    assert where_steps_fail(States.of(start.system, moved)) == where


EFFECTS: dict[str, dict[str, Any]] = {
    name: tomllib.loads((EFFECT_CASES / f"{name}.toml").read_text(encoding="utf-8"))["effects"]
    for name in (
        "air_drag", "bending", "mass_damping", "material_damping", "molecular_drag", "orbit",
        "parabolic_flight", "solar_pressure", "thermal_strain",
    )
}  # fmt: skip


def random_net(random: np.random.Generator, end: float, share: float) -> dict[str, Any]:
    """A slack net with bullets, under a share of the effects."""
    net = {"meshes": int(random.integers(2, 5)), "bullets": {"mass": 10.0 ** random.uniform(-2.0, 0.0)}}
    drawn = [keys.items() for keys in EFFECTS.values() if random.random() < share]
    effects = {name: keys for items in drawn for name, keys in items}
    initial = {"packing": random.uniform(0.4, 0.99)}
    return slack(end, 10.0 ** random.uniform(6.0, 8.0), net=net, effects=effects, initial=initial)


def quiet(seed: int) -> dict[str, Any]:
    """A net at rest or in uniform motion, with thrust, control, a prescribed body or none of them."""
    random = np.random.default_rng([seed, 3])
    tables = random_net(random, end := random.uniform(0.05, 0.3), 0.2)
    tables["time"]["output_step"] /= int(random.choice([1, 4, 50]))
    tables["solver"] = {"method": str(random.choice(["auto", "VelocityVerlet", "RK44"], p=[0.5, 0.3, 0.2]))}
    push, moves = (10.0 ** random.uniform(-2.0, 1.0, (2, 1)) * random.normal(size=(2, 3))).tolist()
    units, speed = [0, 1, 2, 3], 10.0 ** random.uniform(-1.0, 1.0)
    body = BALL | {"velocity": [0.0, 0.0, speed], "position": [0.1, -0.2, -0.3 - 0.3 * speed * end]}
    kind = str(random.choice(["thrust", "control", "met", "tied", "none"]))
    if kind != "tied" and random.random() < 0.5:
        tables["initial"]["velocity"] = moves
    if kind == "thrust":
        times = end * random.uniform(0.0, 0.5) + np.cumsum([0.0, *10.0 ** random.uniform(-6.0, -2.0, 3)])
        force = [[0.0] * 3, push, push, [0.0] * 3]
        tables["effects"]["thrust"] = {"bullets": units, "time": times.tolist(), "force": force}
    if kind == "control":
        law = {"kind": "point", "point": push, "stiffness": 1.0, "damping": 0.1, "largest_thrust": 2.0}
        tables["control"] = {"bullets": units, "period": random.uniform(0.01, 0.05), **law}
    if kind == "met":
        tables["bodies"] = {"b": body | {"angular_velocity": moves}}
        hit = {"bullets": ["b"], "bullet_radius": 0.02, "bullet_stiffness": 1e3}
        tables["effects"]["contact"] = CONTACT | hit | {"stiffness": 10.0 ** random.uniform(2.5, 4.5)}
    if kind == "tied":
        ties = {"attachments": {"x": {"node": 0, "point": [0.0, 0.0, 0.5]}}}
        corner = [-tables["initial"]["packing"]] * 2
        tables["bodies"] = {"b": body | ties | {"position": [*corner, -0.5]}}
    return tables


def is_stopped(tables: dict[str, Any], **solver: Any) -> bool:
    start = prepare(with_any_effects(tables | {"solver": tables["solver"] | solver}))
    try:
        return not simulate(start).complete
    except RunStopped:
        return True


@pytest.mark.ci_for("0")
@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 240, 24))
def test_no_quiet_net_is_stopped_that_an_adaptive_method_runs_through(first):
    """At rest and in uniform motion, in both back ends."""
    scenes = {(seed, name): quiet(seed) | {"engine": {"backend": name}}
              for seed in range(first, first + 24) for name in BACKENDS}  # fmt: skip
    stops = [key for key, tables in scenes.items() if is_stopped(tables)]
    assert [key for key in stops if not is_stopped(scenes[key], method="DOPRI5")] == []


@pytest.mark.ci_for("0")
@pytest.mark.slow
@pytest.mark.parametrize("seed", [seed for seed in range(21) if seed != 6])
def test_a_random_net_at_1_2_times_the_stable_step_is_stopped(seed):
    """Thrown open, with effects; these are stopped without the bound for forces without a potential too."""
    random = np.random.default_rng([seed, 12])
    tables = random_net(random, 0.4, 0.35)
    tables["launch"] = {"radial_speed": random.uniform(2.0, 6.0), "axial_speed": random.uniform(0.0, 3.0)}
    tables["engine"] = {"backend": str(random.choice(list(BACKENDS)))}
    tables["solver"] = {"method": str(random.choice(["VelocityVerlet", "RK44"])), "retry": 0}
    system = prepare(with_any_effects(tables)).system
    frequency, rate = largest_frequency(system), largest_damping_rate(system)
    step = 1.2 * stable_step(Method(tables["solver"]["method"]), frequency, rate)
    assert is_stopped(tables, step=step, force=True)


def test_a_method_that_swallows_energy_is_stopped():
    """RK44 at 0.9 of its stable step, undamped; it loses at each snap and looks calm."""
    stop = thrown_until_it_stops({"method": "RK44", "step": 2.3e-4, "retry": 0}, end=2.0)
    part = stop.result
    assert "the energy balance decreased" in str(stop)
    assert not part.complete
    assert part.verdict == str(stop)
    assert energy_balance(part) <= ENERGY_BOUND
    part.run.to_json()


@pytest.mark.parametrize(
    "effect",
    [
        {"gravity": {"acceleration": [0.0, 0.0, -9.81]}},
        {"orbit": {"radial": [0, 0, 1], "along_track": [1, 0, 0], "mean_motion": 1e-3, "model": "linear"}},
    ],
    ids=["gravity", "orbit"],
)
def test_what_moves_the_whole_net_hides_no_loss(effect):
    """A uniform field cannot change the energy in the centre-of-mass frame (Koenig's theorem): stopped where
    the net without it is. 20 m/s, or 1 km from an orbit's origin, make the energies of the common motion
    hundreds of times those of the frame.
    """
    solver = {"method": "RK44", "step": 2.3e-4, "retry": 0}
    tables = {"initial": {"packing": 0.5, "velocity": [0.0, 0.0, 20.0]}}
    stops = []
    for effects in ({}, effect):
        stop = thrown_until_it_stops(solver, end=2.0, effects=effects, **tables)
        part = stop.result
        assert "the energy balance decreased" in str(stop)
        # Four bullets at 5 m/s; of the energy of the common motion, some 2e3 J, a part of 1e-5.
        bullets = part.net.mass[part.net.bullet_nodes].sum()
        assert energy_scale(part) == pytest.approx(0.5 * bullets * 5.0**2, abs=0.1)
        stops.append(part.time[-1])
    assert stops[1] == pytest.approx(stops[0], abs=0.1)  # round-off differs, so snaps do


@pytest.mark.parametrize("effects", [{}, {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}])
def test_a_common_motion_hides_no_loss(effects):
    """7500 m/s as in an orbit hold 1e7 times the energy in play; a fall from 1 km ends at 140 m/s."""
    common = np.array([7.5e3, 0.0, 0.0])
    initial = {"packing": 0.5, "velocity": common.tolist(), "node_velocities": APART}
    start = prepare(pair_of_masses(initial=initial, effects=effects))
    fallen = np.array([0.0, 0.0, -1e3 if effects else 0.0])
    speed = np.array([7.5e3, 0.0, -np.sqrt(-2 * 9.81 * fallen[2])])
    x, v = start.position, start.velocity - common
    look(start, (x, v + common), (x + fallen, v * np.sqrt(0.97) + speed))
    with pytest.raises(RunStopped, match="the energy balance decreased"):
        look(start, (x, v + common), (x + fallen, v * np.sqrt(0.7) + speed))


def test_potentials_of_held_nets_and_of_parts_count_in_the_energy_scale():
    """A mass on a held cable that falls 0.4 m adds m g 0.4 m to the scale; the free one adds nothing."""
    scene = pair_of_masses(effects={"gravity": {"acceleration": [-10.0, 0.0, 0.0]}}).document()
    scene["net"]["fixed"] = [0]
    held = prepare(Scene.model_validate(scene))
    lower = held.position + np.array([[0.0, 0, 0], [-0.4, 0, 0]])
    own, in_all = gained(held, lower, held.velocity)
    assert own == pytest.approx(held.net.mass[1] * 10.0 * 0.4)
    assert in_all == pytest.approx(own)
    free = prepare(pair_of_masses(effects={"gravity": {"acceleration": [-10.0, 0.0, 0.0]}}))
    fallen = free.position - np.array([0.4, 0, 0])
    speed = np.tile([-np.sqrt(2 * 10.0 * 0.4), 0, 0], (2, 1))
    own, in_all = gained(free, fallen, speed)
    assert in_all == pytest.approx(free.net.mass.sum() * 10.0 * 0.4)
    assert own == pytest.approx(TRANSLATION_PART * in_all)


def test_a_potential_at_the_start_does_not_count_in_the_energy_scale():
    """Free fall by 0.4 m of two masses that start 50 m above the origin of the potential, and in flight.

    All that gravity does here goes into the common motion, whatever the potential was at the start. Catches
    a change of potential that is counted from zero, or the start's potential added to it.
    """
    start = prepare(
        pair_of_masses(
            initial={
                "packing": 1.0,
                "node_positions": [[49.5, 0, 0], [50.5, 0, 0]],
                "velocity": [-3.0, 0, 0],
            },
            effects={"gravity": {"acceleration": [-10.0, 0.0, 0.0]}},
        )
    )
    assert abs(float(energy.potential(start.system.forces, start.position.reshape(1, -1))[0])) > 100.0
    fallen = start.position - np.array([0.4, 0, 0])
    speed = np.tile([-np.sqrt(3.0**2 + 2 * 10.0 * 0.4), 0, 0], (2, 1))
    own, in_all = gained(start, fallen, speed)
    work = start.net.mass.sum() * 10.0 * 0.4
    assert in_all == pytest.approx(work)
    assert own == pytest.approx(TRANSLATION_PART * work, rel=1e-3)  # the change loses digits to the 500 J


def test_work_that_forces_do_counts_in_the_energy_scale_but_for_what_the_whole_net_gains():
    """Forces without a potential push two masses that fly at 3 m/s to 5 m/s, and do 2 J more on them.

    The momentum theorem gives the former to the common motion: m (25 - 9) / 2. It stops a common motion that
    is counted from rest, and work that is left out.
    """
    start = prepare(
        pair_of_masses(
            initial={"packing": 0.5, "velocity": [0, 0, 3.0]}, effects={"mass_damping": {"alpha": 0.1}}
        )
    )
    pushed = 0.5 * start.net.mass.sum() * (5.0**2 - 3.0**2)
    speed = np.tile([0, 0, 5.0], (2, 1))
    own, in_all = gained(start, start.position, speed, taken=-(pushed + 2.0))
    assert in_all == pytest.approx(pushed + 2.0, rel=1e-12)
    assert own == pytest.approx(2.0 + WORK_PART * (pushed + 2.0), rel=1e-9)


def test_a_failure_of_newtons_method_is_retried_with_half_the_step(monkeypatch):
    """The engine itself hardly ever fails at these scenes."""
    from exunet.integrators.exudyn import stepper

    def give_up(self: stepper.ExudynStepper, times: list[float], *_: object) -> None:
        raise IntegrationFailed("Newton did not converge")

    monkeypatch.setattr(stepper.ExudynStepper, "step", give_up)
    stop = thrown_until_it_stops({"method": "GeneralizedAlpha", "step": 1e-3, "retry": 1})
    assert "Newton did not converge" in str(stop)
    assert [retry.step_s for retry in stop.result.run.retries] == [5e-4]


def forced(plan: Plan) -> bool:
    return any("forced" in note for note in plan.notes)


@pytest.mark.parametrize("method", ["RK33", "RK44", "VelocityVerlet"])
def test_a_step_above_the_stable_one_is_refused_unless_forced(method):
    limit = stable_step(method, largest_frequency(prepare(thrown({})).system))
    with pytest.raises(CaseError, match="above the stable step") as refusal:
        prepare(thrown({"method": method, "step": 1.02 * limit}))
    assert refusal.value.faults[0].key == "solver.step"
    assert refusal.value.exit_code == 2
    assert not forced(prepare(thrown({"method": method, "step": 0.99 * limit})).plan)
    plan = prepare(thrown({"method": method, "step": 1.02 * limit, "force": True})).plan
    assert forced(plan)
    assert plan.step == 1.02 * limit


@pytest.mark.parametrize(
    # Where the mode of angular frequency w grows by 1 % a step, |R(i h w)| = 1.01: of Euler's method
    # sqrt(1 + y^2), of the mid-point rule sqrt(1 + y^4 / 4); y = h w.
    ("method", "radius"),
    [("ExplicitEuler", 0.0201**0.5), ("ExplicitMidpoint", 0.0804**0.25)],
)
def test_a_step_at_which_a_weak_method_grows_fast_is_refused_unless_forced(method, radius):
    limit = radius / largest_frequency(prepare(thrown({})).system)
    assert not forced(prepare(thrown({"method": method, "step": 0.99 * limit})).plan)
    with pytest.raises(CaseError, match=r"above the step limit .* grows by 1% a step"):
        prepare(thrown({"method": method, "step": 1.01 * limit}))
    assert forced(prepare(thrown({"method": method, "step": 2.0 * limit, "force": True})).plan)


METHODS_TRIED = ("ExplicitEuler", "RK33", "RK67", "VelocityVerlet", "GeneralizedAlpha", "TrapezoidalIndex2")
SNAP = 0.1  # [s]: at packing 0.5, strings of 1 m are taut when the bullets have gone 0.5 m at 5 m/s


def energy_by_hand(run: exunet.Result) -> np.ndarray:
    """(k,) kinetic and elastic energy [J] of the stored states, by eq. (19) written out."""
    net = run.net
    span = run.position[:, net.element_nodes[:, 1]] - run.position[:, net.element_nodes[:, 0]]
    strain = 0.5 * ((span**2).sum(axis=-1) / net.reference_length**2 - 1.0)
    held = net.youngs_modulus * net.area * net.reference_length * np.maximum(strain, 0.0) ** 2
    return 0.5 * ((run.velocity**2).sum(axis=-1) @ net.mass + held.sum(axis=-1))


@pytest.mark.parametrize("method", METHODS_TRIED)
def test_steps_ten_times_the_stable_one_are_stopped_at_the_first_snap(method):
    """Which each passes by 2.4 ms, of the 0.8 ms that it lasts; before it all of them are exact.

    It stops guards that look too late, and a good part that does not end with the last good state.
    """
    solver = {"method": method, "step": 2.4e-3, "retry": 0, "force": True}
    stop = thrown_until_it_stops(solver, end=0.3)
    part = stop.result
    assert part.time == pytest.approx(0.005 * np.arange(21), abs=1e-12)
    flown = part.position[0] + part.time[:, None, None] * part.velocity[0]
    assert np.abs(part.position - flown).max() < 1e-13
    time = re.search(r"diverged at t = ([\d.]+) s: the energy balance increased", str(stop))
    assert time
    assert SNAP < float(time[1]) <= SNAP + 2 * 2.4e-3


@pytest.mark.slow_for("GeneralizedAlpha", "TrapezoidalIndex2")
@pytest.mark.parametrize("method", METHODS_TRIED)
def test_what_is_kept_of_a_run_has_its_energy_within_the_bound(method):
    """At 0.4 of the stable step of RK44; energies by the formulas of this test and not by the result's own.

    It stops guards that do not look, or look at energies of another law. Euler's method gains 5 % in the
    first snap already; RK67, of order 6, comes to the end.
    """
    try:
        run = exunet.run(thrown({"method": method, "step": 1e-4, "retry": 0, "force": True}, end=0.3))
    except RunStopped as stop:
        run = stop.result  # type: ignore[assignment]
    total = energy_by_hand(run)
    assert np.abs(total - total[0]).max() <= ENERGY_BOUND * total[0]
    assert (run.time[-1] <= SNAP + 0.005) == (method == "ExplicitEuler")
    assert run.complete == (method == "RK67")


# Retries: from the last good state, with finer steps, recorded, bounded, and the same every time


DAMPED = {"rayleigh_damping": {"alpha": 1e-2, "beta": 1e-7}}


def stopped(*arguments, **tables) -> RunStopped:
    with pytest.raises(RunStopped) as stop:
        exunet.run(thrown(*arguments, **tables))
    return stop.value


def goes_on_as_a_run_from_there(run: exunet.Result, start: Start) -> None:
    """After its last retry, `run` is what a run of its own from there gives, here for four stored times.

    It stops a retry from another state, at another time, or with the steps that were too long.
    """
    last = run.run.retries[-1]
    kept = int(np.searchsorted(run.time, last.from_time_s + 1e-9)) - 1
    plan = start.plan
    for _ in run.run.retries:
        finer_plan = finer(plan)
        assert finer_plan is not None
        plan = finer_plan
    few = start.scene.time.model_copy(update={"end": 0.02})  # 4 of the times that are stored every 0.005 s
    again = simulate(
        replace(start, scene=start.scene.model_copy(update={"time": few}), plan=plan).moved(
            run.position[kept], run.velocity[kept]
        )
    )
    assert again.complete
    for name in ("position", "velocity"):
        ours, theirs = (getattr(item, name) for item in (run, again))
        assert np.abs(ours[kept : kept + 5] - theirs).max() < 1e-10  # snaps multiply the round-off of t


@pytest.mark.slow
@every_backend
def test_a_retry_mends_what_coarse_steps_spoil(backend):
    scene = thrown(COARSE, end=1.5, engine=engine(backend), effects=DAMPED)
    run = exunet.run(scene)
    assert run.complete
    retries = run.run.retries
    assert 1 <= len(retries) <= 2
    assert [r.step_s for r in retries] == [2.3e-4 / 2, 2.3e-4 / 4][: len(retries)]
    goes_on_as_a_run_from_there(run, prepare(scene))
    assert np.all(np.diff(run.dissipated) >= 0.0)  # the ledger goes on from the state gone back to
    assert run.time.tolist() == pytest.approx(np.arange(301) * 0.005)

    first = stopped({**COARSE, "retry": 0}, end=1.5, engine=engine(backend), effects=DAMPED).result
    assert first is not None
    back = retries[0].from_time_s
    assert 0 < back < first.time[-1]
    kept = int(np.searchsorted(run.time, back, side="right"))
    assert np.array_equal(run.position[:kept], first.position[:kept])  # what was good stays, bit for bit
    total = first.kinetic + first.elastic + first.dissipated
    off = np.abs(total - total[0]) / total[0]
    assert off[:kept].max() <= GOOD_PART * ENERGY_BOUND
    assert off[kept] > GOOD_PART * ENERGY_BOUND


@pytest.mark.slow
@every_backend
def test_the_same_case_retries_to_the_same_bits(backend):
    run, again = (exunet.run(thrown(COARSE, end=0.7, engine=engine(backend))) for _ in range(2))
    retries = run.run.retries
    assert retries
    assert np.array_equal(run.position, again.position)
    assert np.array_equal(run.velocity, again.velocity)
    summary = summarise(run)
    assert [item["from_time_s"] for item in summary["retries"]] == [item.from_time_s for item in retries]
    assert summary["method"]["step_s"] == retries[-1].step_s


def test_retries_are_bounded_and_can_be_turned_off():
    hopeless = {"method": "RK44", "step": 4e-3, "force": True}
    off, default = (stopped({**hopeless, **keys}) for keys in ({"retry": 0}, {}))
    assert off.result is not None
    assert default.result is not None
    assert off.result.run.retries == ()
    assert [r.step_s for r in default.result.run.retries] == [2e-3, 1e-3]


def test_a_loose_tolerance_is_tightened():
    run = exunet.run(thrown({"method": "DOPRI5", "tolerance": 0.1}, end=0.7))
    assert run.complete
    retries = run.run.retries
    assert [r.tolerance for r in retries] == pytest.approx([0.01, 0.001])
    assert 0.0 < retries[0].from_time_s < retries[1].from_time_s
    assert run.run.plan.tolerance == retries[-1].tolerance


def test_restarts_change_nothing_but_round_off():
    """A smooth motion, stopped by hand half way and continued with the same steps, is the same motion."""
    scene = pair_of_masses(
        solver={"method": "RK44", "step": 1e-3},
        initial={"packing": 1.0, "spin": [0.0, 0.0, 2.0]},
        effects={"mass_damping": {"alpha": 0.5}},
    )
    whole = exunet.run(scene)
    plans: list[Plan] = []

    def same(plan: Plan) -> Plan:
        plans.append(plan)
        return plan

    observe, calls = EnergyBalance.observe, []

    def once(self: EnergyBalance, steps: Observed) -> None:
        observe(self, steps)
        if steps.states.time[0] >= 0.2 and not calls:
            calls.append(steps.states.time[0])
            raise RunStopped("by hand", step_cause=True)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(integrate, "finer", same)
        patch.setattr(EnergyBalance, "observe", once)
        again = exunet.run(scene)
    assert len(plans) == len(calls) == 1
    assert 0.2 <= again.run.retries[0].from_time_s < 0.5  # the last stored state that was seen
    assert np.abs(again.position - whole.position).max() < 1e-14
    assert np.abs(again.dissipated - whole.dissipated).max() < 1e-14
    assert again.run.cost.steps > whole.run.cost.steps  # those of both attempts are counted


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow
@every_backend
def test_what_broke_after_the_state_gone_back_to_is_whole_again(backend):
    """Eight elements break in the second snap; the run is stopped by hand right after, and goes on as before.

    It stops elements that stay broken, break twice, are reported twice, or whose energy is counted twice.
    """
    scene = thrown(COARSE, end=0.25, engine=engine(backend), effects={"breaking": {"strain": 0.001}})
    whole = exunet.run(scene)
    assert whole.run.retries == ()
    broken = whole.run.breaks
    assert len(broken) == 8
    observe, calls = EventLog.observe, []

    def once(self: EventLog, steps: Observed) -> None:
        if self.events and not calls:
            calls.append([event.element for event in self.events])
            raise RunStopped("by hand", step_cause=True)
        observe(self, steps)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(integrate, "finer", lambda plan: plan)
        patch.setattr(EventLog, "observe", once)
        again = exunet.run(scene)
    assert calls == [[element.element for element in broken]]
    assert again.run.retries[0].from_time_s < broken[0].time_s
    breaks = again.run.breaks
    assert [item.element for item in breaks] == calls[0]
    times = [item.time_s for item in broken]
    assert [item.time_s for item in breaks] == pytest.approx(times, abs=1e-12)
    assert again.dissipated[-1] == pytest.approx(sum(item.energy_J for item in broken), rel=1e-9)
    for name in ("position", "velocity", "tension", "dissipated"):
        ours, theirs = (np.asarray(getattr(run, name)) for run in (again, whole))
        assert np.abs(ours - theirs).max() <= 1e-9 * np.abs(theirs).max()  # round-off of t, in snaps
