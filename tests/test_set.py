"""A script sets parameters of a scene: what that changes, against hand calculations, and its energy."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from listed_scenes import HEAD, hoist
from scenes import BACKENDS, continue_alike
from scipy.integrate import solve_ivp
from test_script import SCENE, case_of, entry, happened

import exunet
from exunet.base.errors import CaseError
from exunet.forces.cable_term import INTACT
from exunet.forces.effects.thrust import MEMORY as THRUST
from exunet.model.script import changed
from exunet.net.drive import WITHOUT_LIMIT
from exunet.scene.casefile import parse_case
from exunet.simulation.preparation import prepare_case
from exunet.simulation.simulation import Simulation

EVERY = pytest.mark.parametrize("form", BACKENDS.values(), ids=BACKENDS)
# 1 kg falls from where a tether of 100 N and 1 m, on a fixed body, begins to hold it.
SECTION = math.pi * 0.0005**2
EA, G = 100.0, 9.81
HANGS = f"""{HEAD}
time = {{ end = 0.6, output_step = 0.02 }}
solver = {{ method = "RK44", step = 5e-4 }}
initial.node_positions = [[0.0, 0.0, -1.0]]
net.nodes = [[0.0, 0.0, -1.0]]
net.elements = []
net.node_masses = [1.0]
effects.gravity.acceleration = [0.0, 0.0, {-G}]
[bodies.roof]
mass = 1.0
inertia = [0.3, 0.4, 0.5]
motion = "fixed"
[tethers.tow]
diameter = 0.001
density = 1.0
youngs_modulus = {EA / SECTION!r}
length = 1.0
start = {{ body = "roof" }}
end = {{ node = 0 }}
"""
SOFT = entry("soft", at=0.3, do="set", on="tow.youngs_modulus", value=0.4 * EA / SECTION)


def tension(length: float, stiffness: float) -> float:
    """Of a tether of 1 m [N]."""
    return max(0.0, 0.5 * stiffness * (length**2 - 1.0) * length)


def falls(t: float, y: np.ndarray, stiffness: float) -> list[float]:
    mass = 1.0 + 0.5 * SECTION  # with half of the tether
    return [y[1], tension(-y[0], stiffness) / mass - G]


@pytest.mark.slow_for("exudyn")
@EVERY
def test_a_tether_becomes_softer_while_it_is_stretched(form: str) -> None:
    """Against the weight's equation of motion, solved by itself; 0.6 of what the tether stored is lost."""
    result = exunet.run(case_of(SOFT, form, scene=HANGS))
    times, precise = result.time, {"rtol": 1e-10, "atol": 1e-12}
    first = solve_ivp(falls, (0.0, 0.3), [-1.0, 0.0], t_eval=times[:16], args=(EA,), **precise)
    after = solve_ivp(falls, (0.3, 0.6), first.y[:, -1], t_eval=times[15:], args=(0.4 * EA,), **precise)
    np.testing.assert_allclose(result.position[:16, 0, 2], first.y[0], atol=1e-7)
    np.testing.assert_allclose(result.position[15:, 0, 2], after.y[0], atol=1e-7)
    balance = result.kinetic + result.elastic + result.potential + result.dissipated
    assert np.ptp(balance) < 1e-8
    (event,) = result.provenance["script"]
    stored = 0.5 * EA * (0.5 * (first.y[0, -1] ** 2 - 1.0)) ** 2
    assert event["energy_lost_J"] == pytest.approx(0.6 * stored, rel=1e-6)
    expected = [tension(-z, 0.4 * EA) for z in result.position[16:, 0, 2]]
    np.testing.assert_allclose(result.tension[16:, 0], expected, rtol=1e-9)


# A ball on a table.
SLIDES = f"""{HEAD}
time = {{ end = 0.3, output_step = 0.01 }}
solver = {{ method = "RK44", step = 1e-4 }}
initial.node_positions = [[0.0, 0.0, {0.51 - G / 1e4!r}]]
initial.node_velocities = [[1.0, 0.0, 0.0]]
net.nodes = [[0.0, 0.0, 0.0]]
net.elements = []
net.node_masses = [1.0]
effects.gravity.acceleration = [0.0, 0.0, {-G}]
effects.contact = {{ nodes = ["table"], node_radius = 0.01, law = "linear", node_stiffness = 1e4, damping = 0.0, friction = {{ law = "sticking", coefficient = 0.3 }} }}
[bodies.table]
shape = "box"
size = [4.0, 4.0, 1.0]
edge_radius = 0.1
mass = 1.0
motion = "fixed"
"""  # noqa: E501


@pytest.mark.slow_for("exudyn")
@EVERY
def test_friction_of_contact_changes(form: str) -> None:
    """A ball of 1 kg on a table slows down at mu g, with another mu from 0.1 s, and none from 0.2 s on."""
    script = entry("rough", at=0.1, do="set", on="contact.friction", value=0.1)
    script += entry("smooth", at=0.2, do="set", on="contact.friction", value=0.0)
    result = exunet.run(case_of(script, form, scene=SLIDES))
    t, speed = result.time, result.velocity[:, 0, 0]
    expected = 1.0 - G * (0.3 * np.minimum(t, 0.1) + 0.1 * np.clip(t - 0.1, 0.0, 0.1))
    # The first 1e-3 s it leans against its anchor: 0.3 g of 1 kg on a spring of 5 kN/m.
    np.testing.assert_allclose(speed, expected, atol=2e-3)
    lost = 0.5 - 0.5 * speed**2
    np.testing.assert_allclose(result.states["contact/friction"].values[:, 0], lost, atol=1e-6)
    balance = result.kinetic + result.potential + result.dissipated
    assert np.ptp(balance) < 1e-6


LIFTS = HEAD + hoist(friction=0.3)
FINE = ("time.end=0.9", "time.output_step=0.01", "solver.step=1e-4")
LIFT = entry("lift", at=0.05, do="close", force=25.0)


@pytest.mark.ci_for("exudyn")
@pytest.mark.slow_for("exudyn")
@EVERY
def test_friction_of_a_closing_line_changes(form: str) -> None:
    """The tensions beside the ring have the ratio e^(mu pi / 2) while the winch lifts, with mu as it is then.

    Where mu falls, the line slides at once, and friction takes what it stores less; where it grows, nothing
    does. All energy is accounted for.
    """
    script = LIFT + entry("slip", at=0.4, do="set", on="closing.friction", value=0.1)
    script += entry("hold", at=0.6, do="set", on="closing.friction", value=0.2)
    result = exunet.run(case_of(script, form, *FINE, scene=LIFTS))
    start, end = (result.states[f"closing/tension_{name}"].values[:, 0] for name in ("start", "end"))
    for until, friction in ((0.395, 0.3), (0.595, 0.1), (0.895, 0.2)):
        late = (result.time > until - 0.1) & (result.time < until)
        np.testing.assert_allclose(start[late] / end[late], math.exp(0.5 * math.pi * friction), rtol=1e-8)
    _, slip, hold = result.provenance["script"]
    assert slip["energy_taken_J"] > 1e-4
    assert hold["energy_taken_J"] == pytest.approx(0.0, abs=1e-12)
    balance = result.kinetic + result.potential + result.dissipated
    work = result.states["closing/work"].values[-1, 0]
    assert np.ptp(balance) < 1e-6 * work
    lengths = np.array([1.0, -result.position[-1, 2, 2]])  # N^2 L / (2 EA) of each part, nearly
    stored = 0.5 / 1e4 * np.array([start[-1], end[-1]]) ** 2 @ lengths
    assert result.states["closing/elastic"].values[-1, 0] == pytest.approx(stored, rel=5e-3)


def test_what_a_drive_does_goes_on_with_another_force_or_rate() -> None:
    """To the last bit as with a command that says both; of what it does not do nothing changes."""
    fast = ["bodies.right.velocity=[2.0, 0.0, 0.0]", "tethers.tow.reel.paid_out=3.0"]
    begin = entry("in", at=0.05, do="reel", on="tow", rate=0.4, force=30.0)
    sets = entry("weak", at=0.2, do="set", on="tow.force", value=10.0)
    sets += entry("slow", at=0.3, do="set", on="tow.rate", value=0.1)
    says = entry("weak", at=0.2, do="reel", on="tow", rate=0.4, force=10.0)
    says += entry("slow", at=0.3, do="reel", on="tow", rate=0.1, force=10.0)
    hold = entry("hold", at=0.6, do="lock", on="tow")
    late = entry("late", at=0.7, do="set", on="tow.force", value=1.0)
    note = entry("late", at=0.7, do="note")
    ours, theirs = (
        exunet.run(case_of(begin + item, *fast)) for item in (sets + hold + late, says + hold + note)
    )
    assert np.array_equal(ours.position, theirs.position)
    wound = [element.states["tow/wound_up"].values for element in (ours, theirs)]
    assert np.array_equal(*wound)
    assert wound[0][-1, 0] > 0.1  # m: it has wound up
    assert [name for name, _ in happened(ours)] == ["in", "weak", "slow", "hold", "late"]
    last = ours.provenance["script"][-1]["event"]
    assert last == "set tow.force; no effect: the command of tow does not have a force"


@pytest.mark.slow_for("exudyn")
@EVERY
@pytest.mark.parametrize("scene", ["tether", "line"])
def test_a_snapshot_between_goes_on(tmp_path: Path, form: str, scene: str) -> None:
    slip = LIFT + entry("slip", at=0.2, do="set", on="closing.friction", value=0.1)
    text = HANGS + SOFT if scene == "tether" else LIFTS + slip
    case = parse_case(text, Path("set.toml"), [form, *(FINE if scene == "line" else ())])
    one, other = Simulation(case), Simulation(case)
    one.advance_to(0.35)
    continue_alike(one, other, 0.5, tmp_path)


def setting(what: str, value: float = 1.0) -> str:
    return entry("set", at=0.1, do="set", on=what, value=value)


BARE = SLIDES.replace(', friction = { law = "sticking", coefficient = 0.3 }', "")
COMMANDS = 'tethers.tow.reel.commands=[{at=0.2, mode="lock"}]'
REFUSED = {  # script, key of the error, scene, overrides
    "twice": (
        setting("tow.rate", 0.1) + entry("other", at=0.1, do="set", on="tow.rate", value=0.2),
        "do",
        SCENE,
        (),
    ),
    "no parameter": (setting("tow"), "on", SCENE, ()),
    "contact": (setting("contact.friction"), "on", SCENE, ()),
    "closing": (setting("closing.friction"), "on", SCENE, ()),
    "rate of 0": (setting("tow.rate", 0.0), "value", SCENE, ()),
    "outlet": (setting("tow.youngs_modulus"), "on", SCENE, ()),
    "commanded": (setting("tow.force"), "on", SCENE, (COMMANDS,)),
    "undamped": (setting("tow.force"), "on", SCENE, ("tethers.tow.reel.damping=",)),
    "stiffer": (setting("tow.youngs_modulus", 2e9), "value", HANGS, ()),
    "rough line": (setting("closing.friction", 3.0), "value", LIFTS, ()),
    "smooth line": (setting("closing.friction", 0.1), "on", LIFTS, ("closing.friction=0.0",)),
    "without a law": (setting("contact.friction", 0.1), "on", BARE, ()),
    "breaking": (setting("tow.youngs_modulus", 1e3), "on", HANGS, ("effects.breaking={strain=0.5}",)),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_may_be_set_is_a_closed_list_with_bounds(name: str) -> None:
    script, key, scene, overrides = REFUSED[name]
    with pytest.raises(CaseError, match=rf"^script\.toml:\d+: script\[0\]\.{key}: "):
        case_of(script, *overrides, scene=scene)


def asked(parameter: str, value: float, *command: float) -> list[float] | str:
    """What a drive is asked for after that; the words if nothing changes."""
    system = prepare_case(case_of("")).system
    every = dict(system.memory) | {"reel/tow": np.array(command)}
    what, words = changed(system, parameter, value, (0.1, np.zeros(0), np.zeros(0)), every)
    if not what:
        return str(words["event"])
    assert words == {}
    (after,) = what["others"].values()
    assert list(what["others"]) == ["reel/tow"]
    return [float(item) for item in after]


def test_a_rate_or_a_force_that_a_drive_has() -> None:
    """A rate keeps its direction; one without limit, or of 0, is none; what holds hard has no force."""
    assert asked("tow.rate", 0.5, 1.0, 0.2, 10.0, 0.05) == [1.0, 0.5, 10.0, 0.05]
    assert asked("tow.rate", 0.5, 1.0, -0.2, 10.0, 0.05) == [1.0, -0.5, 10.0, 0.05]
    assert asked("tow.force", 7.0, 1.0, -0.2, 10.0, 0.05) == [1.0, -0.2, 7.0, 0.05]
    assert asked("tow.force", 7.0, 1.0, WITHOUT_LIMIT, 10.0, 0.05) == [1.0, WITHOUT_LIMIT, 7.0, 0.05]
    nothing = "set tow.{0}; no effect: the command of tow does not have a {0}"
    assert asked("tow.rate", 0.5, 1.0, WITHOUT_LIMIT, 10.0, 0.05) == nothing.format("rate")
    assert asked("tow.rate", 0.5, 1.0, 0.0, 10.0, 0.05) == nothing.format("rate")
    assert asked("tow.rate", 0.5, 0.0, 0.2, 10.0, 0.05) == nothing.format("rate")
    assert asked("tow.force", 7.0, 1.0, 0.2, 0.0, 0.0) == nothing.format("force")
    assert asked("tow.force", 7.0, 0.0, 0.2, 10.0, 0.05) == nothing.format("force")


def test_other_parameters_that_are_set() -> None:
    """The factor of a thrust; the part of its modulus that a tether keeps, but for what has broken."""
    system = prepare_case(case_of("")).system
    now = 0.1, np.zeros(0), np.zeros(0)
    what, _ = changed(system, "thrust.factor", 0.25, now, {THRUST: np.array([2.0, 0.5, 1.0])})
    assert what["others"][THRUST].tolist() == [2.0, 0.5, 0.25]
    what, _ = changed(system, "tow.youngs_modulus", 0.25e9, now, {INTACT: np.array([0.5, 0.0])})
    assert what["others"][INTACT].tolist() == [0.25, 0.0]
    what, _ = changed(system, "contact.friction", 0.3, now, {})
    assert {name: one.tolist() for name, one in what["others"].items()} == {"set/contact.friction": [0.3]}
