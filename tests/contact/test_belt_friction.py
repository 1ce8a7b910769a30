"""A thread over a drum that slides under it: Euler and Eytelwein's relation of the tensions at both ends.

One end of the thread is held, a mass hangs from the other, and the drum turns so that it drags the thread
away from the held end: T_held = T_mass exp(mu phi) over the angle phi that it is wrapped.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from contact_scenes import contact, simulation

pytestmark = pytest.mark.slow  # one kernel, compiled in a minute

RADIUS, SIDE, FREE = 0.1, 0.015, 4  # m, m; elements beyond the drum on each side
DIAMETER, DENSITY = 1e-3, 1000.0  # m, kg/m3
MASS, G = 0.2, 9.81  # kg, m/s2
END = 0.4  # s: as mass damping takes half of 100/s, what the start moves is down to exp(-20)
TURN = 0.4  # rad until then; the drum slides at 0.1 m/s


def drum(phi: float) -> str:
    """The scene of a thread that is wrapped by an angle [rad] around a drum about y; its mass is at x > 0."""
    reach = RADIUS + 0.5 * DIAMETER
    count = round(phi * reach / SIDE)
    angles = np.linspace(phi, 0.0, count + 1)  # from x towards z
    around = reach * np.stack([np.cos(angles), 0.0 * angles, np.sin(angles)], axis=1)
    side = phi * reach / count
    away = np.arange(1, FREE + 1)[:, None] * side
    # Backwards along the tangent at the beginning of the arc, and downwards from its end.
    back = away * [-math.sin(angles[0]), 0.0, math.cos(angles[0])]
    held, hanging = around[0] + back, around[-1] - away * [0.0, 0.0, 1.0]
    nodes = np.concatenate([held[::-1], around, hanging])
    masses = [0.0] * (len(nodes) - 1) + [MASS]
    elements = [[k, k + 1] for k in range(len(nodes) - 1)]
    return f"""
format = 1
title = "A thread over a drum"
time = {{ end = {END}, output_step = {END} }}
solver = {{ method = "RK44", step = 2.5e-5 }}
engine.backend = "compiled"
initial = {{ packing = 1.0 }}
net.topology = "explicit"
net.nodes = {nodes.tolist()}
net.elements = {elements}
net.node_masses = {masses}
net.fixed = [0]
net.cable = {{ diameter = {DIAMETER}, density = {DENSITY}, youngs_modulus = 3e8 }}
effects.gravity.acceleration = [0.0, 0.0, {-G}]
effects.mass_damping.alpha = 100.0
effects.contact = {{ threads = ["drum"], law = "linear", stiffness = 1e5, damping = 5.0 }}
[bodies.drum]
shape = "cylinder"
radius = {RADIUS}
length = 0.5
edge_radius = 0.02
mass = 1.0
motion = "prescribed"
pose_times = [0.0, {END}]
pose_positions = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
pose_attitudes = {[_turned(0.0), _turned(TURN)]}
"""


def _turned(angle: float) -> list[float]:
    """The attitude of the drum after a turn about y [rad], which carries its top towards x > 0."""
    c, s = math.cos(0.5 * angle), math.sin(0.5 * angle)
    h = math.sqrt(0.5)  # a quarter turn about x brings its axis into y
    return [c * h, c * h, s * h, -s * h]


STICKING = {"friction.law": "sticking"}
SMOOTH = {"friction.law": "regularised", "friction.slip_speed": 1e-4}


@pytest.mark.ci_for("0.5")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "phi", "law"),
    [
        (0.3, math.pi, STICKING),
        (0.3, math.pi, SMOOTH),
        (0.5, 0.5 * math.pi, STICKING),
    ],
)
def test_tensions_are_as_euler_and_eytelwein_say(
    friction: float, phi: float, law: dict[str, float | str], tmp_path: Path
) -> None:
    sim = simulation(tmp_path, drum(phi), *contact(**{"friction.coefficient": friction, **law}))
    sim.advance(END)
    tension = sim.net.tension
    assert np.abs(sim.net.velocity).max() < 1e-3  # the thread rests, the drum slides
    # What hangs is the mass, and half of each element; the last one bears the mass.
    assert tension[-1] == pytest.approx(MASS * G, rel=2e-3)
    assert tension[0] / tension[-FREE] == pytest.approx(math.exp(friction * phi), rel=0.02)
