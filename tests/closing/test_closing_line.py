"""Closing lines in scenes, against hand calculations, in all forms of the engine."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from listed_scenes import HEAD, STRETCH, hoist
from scenes import BACKENDS
from scipy.optimize import brentq
from scipy.special import ellipeinc

import exunet
from exunet.base.errors import CaseError
from exunet.results.course import course_of
from exunet.results.headlines import headline, headlines_of
from exunet.simulation.preparation import prepare_case
from exunet.simulation.simulation import Simulation

Floats = np.ndarray

CASES = Path(__file__).parents[2] / "cases" / "verification" / "closing"
EVERY = pytest.mark.parametrize("form", BACKENDS.values(), ids=BACKENDS)


def case_of(folder: Path, text: str, *overrides: str) -> exunet.Case:
    path = folder / "closing.toml"
    path.write_text(HEAD + text)
    return exunet.load(path, overrides)


def state(result: exunet.Result, name: str) -> Floats:
    return np.asarray(result.states[f"closing/{name}"].values[:])[:, 0]


# A bead of 1 kg on a line of 2.6 m between two points that are 2 m apart; it starts on the short axis.
SHORT = math.sqrt(1.3**2 - 1.0)
BEAD = f"""
time = {{ end = 2.0, output_step = 0.05 }}
solver = {{ method = "RK44", step = 1e-4 }}
net.elements = []
net.nodes = [[-1.0, 0.0, 0.0], [0.0, {SHORT!r}, 0.0], [1.0, 0.0, 0.0]]
net.node_masses = [1.0, 1.0, 1.0]
net.fixed = [0, 2]
initial.node_velocities = [[0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [0.0, 0.0, 0.0]]
[closing]
kind = "line"
nodes = [1]
start = {{ node = 0 }}
end = {{ node = 2 }}
length = 2.6
stiffness = 1e7
linear_density = 0.0
ring_diameter = 0.001
friction = 0.0
"""


@pytest.mark.slow
@EVERY
def test_a_bead_follows_its_ellipse(tmp_path: Path, form: str) -> None:
    """The foci are the ends of the line. Its pull halves the angle at the bead, so that this keeps its speed:
    the arc from the short axis is 0.8 m/s t, E(phi) of the half axis 1.3 m at x = 1.3 m sin(phi).
    """
    result = exunet.run(case_of(tmp_path, BEAD, form))
    bead = result.position[:, 1]
    ways = sum(np.linalg.norm(bead - [x, 0.0, 0.0], axis=1) for x in (-1.0, 1.0))
    assert np.abs(ways / 2.6 - 1.0).max() < 1e-6  # a strain of 1e-7 by 0.6 N
    phi = [brentq(lambda p, s=s: 1.3 * ellipeinc(p, 1.0 / 1.69) - s, 0.0, 4.0) for s in 0.8 * result.time]
    exact = np.stack([1.3 * np.sin(phi), SHORT * np.cos(phi), np.zeros(len(phi))], axis=1)
    assert np.abs(bead - exact).max() < 2e-6
    energy = result.kinetic + result.potential
    assert np.ptp(energy) < 1e-8 * energy[0]
    np.testing.assert_array_equal(state(result, "tension_start"), state(result, "tension_end"))


# Six rings of different masses on a taut loop of constant length, which fly about; rings 0 and 3 through each
# other.
LOOP = """
time = { end = 0.5, output_step = 0.002 }
solver = { method = "DOPRI5", tolerance = 1e-12 }
net.elements = []
net.nodes = [[0.2, 0.0, 0.0], [0.5, 0.9, 0.1], [-0.5, 0.8, 0.0], [-0.2, 0.0, 0.0], [-0.6, -0.8, 0.1],
             [0.4, -0.9, 0.0]]
net.node_masses = [2.0, 0.1, 0.3, 2.0, 0.15, 0.25]
initial.node_velocities = [[-4.0, 0.0, 0.0], [1.0, 1.0, 0.0], [-0.3, 2.0, 0.5], [4.0, 0.0, 0.0],
                           [-1.0, -2.0, 0.0], [1.0, -1.0, 0.3]]
[closing]
kind = "line"
nodes = [0, 3, 1, 4, 2, 5]
length = 7.0
stiffness = 200.0
linear_density = 0.02
ring_diameter = 0.05
friction = 0.0
strength = 500.0
"""


@pytest.mark.slow_for("compiled")
@EVERY
def test_energy_and_momenta_are_kept_while_rings_meet(tmp_path: Path, form: str) -> None:
    """To 1e-8, of a line of constant length; the momenta are kept too, and the masses have the line's."""
    result = exunet.run(case_of(tmp_path, LOOP, form))
    masses = np.array([2.0, 0.1, 0.3, 2.0, 0.15, 0.25]) + 0.02 * 7.0 / 6.0  # six pieces, half at either end
    np.testing.assert_allclose(result.net.mass, masses, rtol=1e-14)
    apart = np.linalg.norm(result.position[:, 0] - result.position[:, 3], axis=1)
    assert apart.min() < 0.05  # m, the diameter of the rings
    assert state(result, "largest")[-1] > 10.0
    energy = result.kinetic + result.potential
    assert np.ptp(energy) < 1e-8 * energy[0]
    assert np.ptp(result.momentum, axis=0).max() < 1e-10
    assert np.ptp(result.angular_momentum, axis=0).max() < 1e-8
    found = headlines_of(course_of(result))
    assert found["closing_margin"] == pytest.approx(500.0 / state(result, "largest")[-1] - 1.0)
    assert found["closing_largest_tension_N"] == state(result, "largest")[-1]
    assert found["closing_wound_up_m"] == 0.0
    for key in found:
        assert headline(key).key == key


BODIES = (
    "net.fixed=",
    "bodies.left={mass=2.0, inertia=[0.2, 0.3, 0.4], position=[-1.2, 0.0, 0.1], "
    "angular_velocity=[0.3, -0.2, 0.5], attachments={a={node=0, point=[0.2, 0.0, -0.1]}}}",
    "bodies.right={mass=3.0, inertia=[0.4, 0.3, 0.4], position=[1.2, 0.1, 0.0], velocity=[0.5, 0.0, 0.0], "
    "attachments={a={node=2, point=[-0.2, -0.1, 0.0]}}}",
)


@pytest.mark.ci_for("0.2-compiled")
@pytest.mark.slow
@EVERY
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_line_between_two_bodies(tmp_path: Path, form: str, friction: float) -> None:
    """Its ends are nodes that are fixed to bodies, its winch pulls: momenta are kept, and the books close."""
    winch = "closing.winch={shortest=1.0, damping=10.0, commands=[{at=0.1, mode='tension', force=5.0}]}"
    soft = ("closing.stiffness=1e3", "time.end=1.0", f"closing.friction={friction}")
    result = exunet.run(case_of(tmp_path, BEAD, form, *BODIES, winch, *soft))
    assert state(result, "wound_up")[-1] > 0.2
    assert np.ptp(result.momentum, axis=0).max() < 1e-11
    assert np.ptp(result.angular_momentum, axis=0).max() < 1e-8
    balance = result.kinetic + result.potential + result.dissipated
    work = state(result, "work")[-1]
    assert work > 0.1
    assert np.ptp(balance) < 1e-5 * work
    if friction == 0.0:
        found = headlines_of(course_of(result))
        assert found["closing_work_J"] == work


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow
@EVERY
def test_a_tether_pulls_the_line(form: str) -> None:
    """The knot of 0.02 kg gets what the tether and both ends of the line pull, and no more.

    Impulses are summed by the trapezoidal rule over stored steps of 0.25 ms, without viscous stress, which
    jumps where something becomes slack.
    """
    short = ("time.end=0.1", "time.output_step=2.5e-4", "effects.material_damping=")
    result = exunet.run(exunet.load(CASES / "by_tether.toml", [form, *short]))
    tether = result.net.tethers[0].nodes
    knot, corner = tether[-1], result.net.rim[0]
    place = result.position[:]
    tow, line = result.tension[:, result.net.n_elements - 1], state(result, "tension_start")
    np.testing.assert_array_equal(line, state(result, "tension_end"))
    assert tow.max() > 2.0
    assert line.max() > 0.2

    def pull(tension: Floats, to: int) -> Floats:
        along = place[:, to] - place[:, knot]
        return np.asarray((tension / np.linalg.norm(along, axis=1))[:, None] * along)

    force = pull(tow, tether[-2]) + 2.0 * pull(line, corner)
    given = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(result.time)[:, None], axis=0)
    mass = 0.02 + result.net.mass[knot]
    gained = mass * (result.velocity[-1, knot] - result.velocity[0, knot])
    np.testing.assert_allclose(given, gained, atol=1e-5 * np.abs(gained).max())
    assert np.ptp(result.momentum, axis=0).max() < 1e-11
    assert np.ptp(result.angular_momentum, axis=0).max() < 1e-8
    energy = result.kinetic + result.elastic + result.potential
    assert np.ptp(energy) < 1e-8 * energy[0]


@pytest.mark.ci
@pytest.mark.slow
def test_each_end_has_a_reel_of_its_own() -> None:
    """At either end of a line with friction a tether that a reel winds up, of 1 and 2 m/s and 3 N."""
    reel = "reel={{damping=1.0, commands=[{{at=0.0, mode='rate', rate={}, force=3.0}}]}}"
    two = (
        "bodies.chaser.velocity=[0.0, 0.0, 0.0]",
        "bodies.other={mass=20.0, inertia=[2.0, 2.0, 2.0], position=[0.3, 0.3, -1.18]}",
        "bodies.end={mass=0.02, inertia=[1e-5, 1e-5, 1e-5], position=[0.4, 0.4, -0.2]}",
        "tethers.second={length=0.9, divisions=2, diameter=0.001, density=1390.0, youngs_modulus=1e8, "
        f"start={{body='other', point=[0.0, 0.0, 0.1]}}, end={{body='end'}}, {reel.format(2.0)}}}",
        f"tethers.tow.{reel.format(1.0)}",
        "closing.end={tether='second'}",
        "closing.rings=",
        "closing.nodes=[0, 1, 2, 3]",
        "closing.length=4.0",
        "closing.friction=0.1",
        "initial.velocity=[0.0, 0.0, 0.5]",
        "time.end=0.45",
    )
    result = exunet.run(exunet.load(CASES / "by_tether.toml", ["engine.backend=compiled", *two]))
    wound = [np.asarray(result.states[f"{name}/wound_up"].values[:])[:, 0] for name in ("tow", "second")]
    assert wound[0][-1] == pytest.approx(0.45, rel=0.01)
    assert wound[1][-1] > 1.5 * wound[0][-1]
    assert state(result, "wound_up").max() == 0.0
    tensions = state(result, "tension_start"), state(result, "tension_end")
    assert min(tension.max() for tension in tensions) > 0.2
    assert np.abs(tensions[0] - tensions[1]).max() > 0.01
    assert np.ptp(result.momentum, axis=0).max() < 1e-11
    assert np.ptp(result.angular_momentum, axis=0).max() < 1e-8


def test_a_mouth_that_a_tether_pulls_becomes_narrow() -> None:
    """It is the diagonal of 0.95 x 1 m at the start, and less than half of it in the end."""
    result = exunet.run(exunet.load(CASES / "by_tether.toml", ["engine.backend=compiled"]))
    rim = result.position[:, list(result.net.rim)]
    widest = np.linalg.norm(rim[:, :, None] - rim[:, None], axis=3).max(axis=(1, 2))
    assert widest[0] == pytest.approx(0.95 * math.sqrt(2.0), rel=1e-12)
    assert widest[-1] < 0.5 * widest[0]
    assert state(result, "wound_up").max() == 0.0


@pytest.mark.slow
def test_moved_starts_have_the_headlines_of_the_run(tmp_path: Path) -> None:
    case = case_of(tmp_path, hoist(0.3, 25.0), "engine.backend=compiled", "time.end=0.5")
    every = exunet.ensemble(case, runs=2, perturb=1e-12)
    run = headlines_of(course_of(exunet.run(case)))
    keys = {key for key in run if key.startswith("closing")}
    assert keys == {
        "closing_largest_tension_N", "closing_time_of_largest_tension_s", "closing_margin",
        "closing_wound_up_m", "closing_work_J",
    }  # fmt: skip
    for key in keys - {"closing_margin", "closing_time_of_largest_tension_s"}:
        # Steps end at other instants, and at their ends the line begins to slide or sticks.
        assert every.headlines[key] == pytest.approx(run[key], rel=1e-4)


@pytest.mark.slow
@EVERY
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_winch_of_constant_force_lifts_a_weight(tmp_path: Path, form: str, friction: float) -> None:
    """It winds up at (force - N) / c with N = 9.81 N e^(mu pi / 2). Between two instants its work is weight
    times height, with what friction takes: N - 9.81 N times the way.
    """
    text = hoist(friction, 25.0)
    result = exunet.run(case_of(tmp_path, text, form))
    steady = (result.time > 0.79) & (result.time < 1.19)
    at_winch = 9.81 * math.exp(friction * math.pi / 2.0)
    first = np.flatnonzero(steady)[[0, -1]]
    np.testing.assert_allclose(state(result, "tension_start")[steady], at_winch, rtol=1e-4)
    ratio = state(result, "tension_start")[steady] / state(result, "tension_end")[steady]
    np.testing.assert_allclose(ratio, math.exp(friction * math.pi / 2.0), rtol=1e-8)
    span = float(np.diff(result.time[first])[0])
    wound, work = (np.diff(state(result, name)[first])[0] for name in ("wound_up", "work"))
    assert wound == pytest.approx(span * (25.0 - at_winch) / 20.0, rel=1e-4)
    height = np.diff(result.position[first, 2, 2])[0]
    assert height == pytest.approx(
        wound, rel=3e-3
    )  # the line that is wound up is stretched by 1 to 1.6 permille
    assert work == pytest.approx(at_winch * height, rel=3e-3)
    after = result.time > 1.21
    assert np.ptp(state(result, "wound_up")[after]) == 0.0
    assert np.ptp(state(result, "work")[after]) == 0.0
    balance = result.kinetic + result.potential + result.dissipated
    assert np.ptp(balance) < 1e-6 * work
    if friction > 0.0:
        taken = np.diff(state(result, "friction")[first])[0]
        assert taken == pytest.approx((at_winch - 9.81) * height, rel=3e-3)
    told = [item["time_s"] for item in result.provenance["closing"]]
    assert told == pytest.approx([0.1, 1.2])


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow
@EVERY
def test_a_winch_of_constant_rate(tmp_path: Path, form: str) -> None:
    """A weight on a spring whose end moves at w: its height is w t - w / W sin(W t), W^2 = k / m.

    k = dN/dL = EA (3 s^2 - 1) / (2 L) at the weight's tension; the line becomes shorter by 1 % in 0.3 s, so
    that W grows by 0.5 %, and the swing of 1.7 mm is known to 1e-4 m.
    """
    text = hoist(0.0, 1.0).replace('mode = "tension", force = 1.0', 'mode = "rate", rate = 0.1')
    result = exunet.run(case_of(tmp_path, text, form, "time.end=0.4", "time.output_step=0.01",
                                "closing.winch.commands=[{at=0.1, mode='rate', rate=0.1}]"))  # fmt: skip
    moved = np.maximum(result.time - 0.1, 0.0)
    omega = math.sqrt(1e4 * (3.0 * STRETCH**2 - 1.0) / 2.0 / (3.0 / STRETCH))
    height = 0.1 * moved - 0.1 / omega * np.sin(omega * moved)
    assert np.abs(result.position[:, 2, 2] + 2.0 - height).max() < 1e-4
    assert state(result, "wound_up")[-1] == pytest.approx(0.03, rel=1e-10)
    balance = result.kinetic + result.potential + result.dissipated
    assert np.ptp(balance) < 1e-8


@pytest.mark.slow_for("compiled")
@EVERY
def test_a_winch_of_a_rate_pulls_by_its_force_at_most(tmp_path: Path, form: str) -> None:
    """0.1 m/s with 11 N: at the weight's 9.81 N it winds up at 1.19 N / 20 N s/m, and never pulls by
    more than 11 N, though the weight swings on the line.
    """
    orders = "closing.winch.commands=[{at=0.1, mode='rate', rate=0.1, force=11.0}]"
    result = exunet.run(case_of(tmp_path, hoist(0.0, 1.0), form, orders, "time.end=1.2"))
    steady = result.time > 0.79
    rate = np.gradient(state(result, "wound_up"), result.time)[steady]
    np.testing.assert_allclose(rate, (11.0 - 9.81) / 20.0, rtol=1e-3)
    largest = state(result, "largest").max()
    assert 10.0 < largest < 11.0


@pytest.mark.slow
def test_friction_holds_what_hangs(tmp_path: Path) -> None:
    """A brake of 6.5 N lets a weight of 9.81 N hang: e^(0.3 pi / 2) = 1.602 times 6.5 N are 10.4 N."""
    brake = "closing.winch.commands=[{at=0.0, mode='rate', rate=0.1}, {at=0.3, mode='brake', force=6.5}]"
    engine = "engine.backend=exudyn"
    held = exunet.run(case_of(tmp_path, hoist(0.3, 1.0), engine, brake, "time.end=1.2"))
    let_go = exunet.run(case_of(tmp_path, hoist(0.0, 1.0), engine, brake, "time.end=1.2"))
    late = held.time > 0.9
    assert np.ptp(state(held, "wound_up")[late]) < 1e-4
    assert state(let_go, "wound_up")[-1] < 0.01


@pytest.mark.ci
@pytest.mark.slow
def test_a_script_commands_the_winch(tmp_path: Path) -> None:
    """As commands of the case do, at the same instant."""
    common = ("engine.backend=exudyn", "time.end=0.3", "time.output_step=0.1")
    told = "closing.winch.commands=[{at=0.1, mode='tension', force=25.0}]"
    of_case = exunet.run(case_of(tmp_path, hoist(0.0, 1.0), *common, told))
    sim = Simulation(case_of(tmp_path, hoist(0.0, 1.0), *common, "closing.winch.commands="))
    sim.advance_to(0.1)
    sim.command("closing", "tension", force=25.0)
    sim.advance_to(0.3)
    np.testing.assert_allclose(sim.net.position[2], of_case.position[-1, 2], atol=1e-12)


@pytest.mark.ci
@pytest.mark.slow
def test_a_checkpoint_goes_on_to_the_last_bit(tmp_path: Path) -> None:
    """What the line has slid is in the snapshot."""
    sim = Simulation(case_of(tmp_path, hoist(0.3, 25.0), "engine.backend=exudyn"))
    sim.advance_to(0.3)
    here = sim.snapshot()
    sim.advance_to(0.5)
    once = sim.net.position.copy()
    sim.restore(here)
    sim.advance_to(0.5)
    np.testing.assert_array_equal(sim.net.position, once)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["closing.nodes=[7]"], "closing.nodes[0]:"),
        (["closing.nodes=[1, 1]"], "closing.nodes[1]: "),
        (["closing.nodes=[1, 0, 1]", "closing.start=", "closing.end="], "closing.nodes[2]: "),
        (["closing.nodes=", "closing.rings=edge"], "closing.rings:"),
        (["closing.nodes=", "closing.rings=corners"], "closing.rings:"),
        (["closing.nodes="], "closing: "),
        (["closing.start="], "closing.end:"),
        (["closing.start={bullet=0}"], "closing.start.bullet: "),
        (["closing.start={node=1}"], "closing.start: "),
        (["closing.start={tether='tow'}"], "closing.start.tether:"),
        (["closing.end={node=2, tether='tow'}"], "closing.end.tether:"),
        (["closing.length="], "closing.length: "),
        (["closing.length=1.0"], "closing.length:"),
        (["closing.rate=0.5"], "closing.rate: "),
        (["closing.winch.shortest=4.0"], "closing.winch.shortest: "),
        (
            ["closing.friction=3.0"],
            "closing.friction:",
        ),
        (["closing.stiffness=1e305"], "closing:"),
        (
            ["closing.winch.largest_rate=0.1", "closing.winch.commands=[{at=0.0, mode='rate', rate=0.2}]"],
            "commands[0].rate:",
        ),
        (["closing.winch.damping="], "closing.winch.commands[0].force: "),
        (["closing.kind=perimeter"], "closing.length: "),
        (["bodies.closing={mass=1.0, inertia=[1.0, 1.0, 1.0]}"], "bodies.closing: "),
        (["solver={method='GeneralizedAlpha', step=1e-3}"], "closing/wound_up"),
    ],
)
def test_what_is_refused(tmp_path: Path, overrides: list[str], words: str) -> None:
    with pytest.raises(CaseError) as refused:
        prepare_case(case_of(tmp_path, hoist(0.0, 1.0), *overrides))
    assert words in str(refused.value)
