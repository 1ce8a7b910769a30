"""What is due at one instant: commands of reels, nodes on and off drums, an ejection; in both codes alike."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import BACKENDS

import exunet
import reference_impl

# A body that carries a net of two nodes and turns, and one that drifts. Tethers, slack, have elements of 1 m.
SCENE = """
format = 1
title = "Round numbers"
time = {{ end = 0.4, output_step = 0.1 }}
net.topology = "explicit"
net.nodes = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
net.elements = [[0, 1]]
net.node_masses = [0.3, 0.1]
net.cable = {{ diameter = 0.002, density = 1390.0, youngs_modulus = 1e7 }}

[initial]
packing = 1.0
node_velocities = [[0.3, 0.0, 2.0], [0.3, 0.1, 2.0]]
[initial.frame]
body = "chaser"
position = [0.1, -0.2, 1.0]
eject_at = {eject_at}

[bodies.chaser]
mass = 3.0
inertia = [0.6, 0.7, 0.5]
angular_velocity = [0.5, 0.2, -0.8]
[bodies.target]
mass = 2.0
inertia = [0.5, 0.4, 0.6]
position = [0.6, 0.1, 0.0]
velocity = [0.1, 0.0, -0.1]
"""
TETHER = """
[tethers.{name}]
length = 4.0
divisions = 4
diameter = 0.004
density = 1390.0
youngs_modulus = 1e7
start = {{ body = "chaser", point = {point} }}
end = {{ body = "target" }}
[tethers.{name}.reel]
paid_out = {paid_out}
damping = 5.0
commands = [{{ at = 0.0, mode = "rate", rate = {rate} }}, {{ at = 0.2, {then} }}]
"""
BRAKE, LOCK = 'mode = "brake", force = 5.0', 'mode = "lock"'
# Until 0.2 s they come to an outlet of 3/2 of an element, or of a quarter.
OUT = {"paid_out": 1.0, "rate": -2.5}
IN = {"paid_out": 3.0, "rate": 3.75}
STEPS = {
    "adaptive": ("solver={method='DOPRI5', tolerance=1e-10}", {"rtol": 1e-11, "atol": 1e-11}),
    "equal": ("solver={method='RK44', step=2.5e-3}", {"method": "RK4", "step": 2.5e-3}),
}


def tether(name: str, given: dict[str, float], then: str, point: str = "[0.1, 0.05, -0.02]") -> str:
    return TETHER.format(name=name, point=point, then=then, **given)


def both(folder: Path, form: str, steps: str, text: str) -> tuple[exunet.Result, Any]:
    """The run in a form of exunet's, and in the reference, with the same kind of steps."""
    path = folder / "instants.toml"
    path.write_text(text)
    key, theirs = STEPS[steps]
    return exunet.run(exunet.load(path, [BACKENDS[form], key])), reference_impl.load(path, {}).integrate(
        **theirs
    )


def assert_alike(ours: exunet.Result, theirs: Any) -> None:
    """At all stored times; 1e-8 is ten times what the margin of 1e-9 of an element may make of a motion."""
    np.testing.assert_allclose(ours.position, theirs.x, atol=1e-8)
    np.testing.assert_allclose(ours.velocity, theirs.v, atol=1e-8)
    for number, body in enumerate(ours.bodies.values()):
        np.testing.assert_allclose(body.position, theirs.bodies.position[:, number], atol=1e-8)
        np.testing.assert_allclose(body.velocity, theirs.bodies.velocity[:, number], atol=1e-8)
    wound = [values.values[:, 0] for name, values in ours.states.items() if name.endswith("/wound_up")]
    np.testing.assert_allclose(np.transpose(wound), theirs.reels.wound_up, atol=1e-12)


@pytest.mark.ci_for("in-compiled-equal")
@pytest.mark.slow
@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("form", ["exudyn", "compiled"])
@pytest.mark.parametrize(
    ("given", "then", "held"),
    [(OUT, LOCK, [3, 3, 2, 2, 2]), (IN, LOCK, [1, 1, 2, 2, 2]), (OUT, BRAKE, [3, 3, 2, 2, 2])],
    ids=["out", "in", "brake"],
)
def test_a_command_where_a_node_is_due(
    tmp_path: Path, given: dict[str, float], then: str, held: list[int], form: str, steps: str
) -> None:
    """A drum that stops with an outlet at its limit hands over the node at that instant: it is so stored."""
    ours, theirs = both(tmp_path, form, steps, SCENE.format(eject_at=0.0) + tether("one", given, then))
    assert theirs.reels.held[:, 0].tolist() == held
    chain = ours.net.tethers[0].nodes
    at_drum = (ours.position[:, chain[1:-1]] == ours.position[:, [chain[0]]]).all(axis=-1).sum(axis=1)
    assert at_drum.tolist() == held
    assert_alike(ours, theirs)


@pytest.mark.ci_for("compiled-equal")
@pytest.mark.slow
@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("form", ["exudyn", "compiled"])
def test_all_at_one_instant(tmp_path: Path, form: str, steps: str) -> None:
    """Commands, then nodes tether by tether, then the ejection: each jumps with the body as left before."""
    one, two = tether("one", OUT, LOCK), tether("two", IN, LOCK, "[-0.3, 0.2, 0.4]")
    ours, theirs = both(tmp_path, form, steps, SCENE.format(eject_at=0.2) + one + two)
    assert theirs.reels.held[:, 0].tolist() == [3, 3, 2, 2, 2]
    assert theirs.reels.held[:, 1].tolist() == [1, 1, 2, 2, 2]
    told = [event for event in ours.provenance["reels"] if "node" in event]
    assert [event["event"].split(" ", 2)[2] for event in told] == ["comes off the drum", "goes onto the drum"]
    (ejection,) = ours.provenance["ejection"]
    assert ejection["time_s"] == 0.2
    assert_alike(ours, theirs)
