"""Ports that the net only touches: the largest stable macro step counts contact."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import exudyn as exu
import numpy as np
import pytest
from exudyn.itemInterface import (
    LoadMassProportional,
    MarkerBodyMass,
    MarkerBodyRigid,
    NodeRigidBodyRotVecLG,
    ObjectRigidBody,
)

import exunet
from exunet import BodiesHost, Cosimulation, NetSystem
from exunet.coupling.prediction import CONTRACTING, MARGIN, STABLE, longest_step
from exunet.coupling.stability import ratios_of

# Each compiles kernels of its own.
pytestmark = pytest.mark.slow

BALL = """
format = 1
title = "A ball on a trampoline"
time = { end = 2.0, output_step = 0.1 }
solver = { method = "RK44", step = 1e-4 }
engine.backend = "compiled"
initial.packing = 1.0
effects.gravity.acceleration = [0.0, 0.0, -9.81]
effects.material_damping.relaxation_time = 1e-4

[net]
topology = "explicit"
nodes = [[-0.5, 0.0, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.5, 0.0, 0.0]]
elements = [[0, 2], [1, 2], [2, 3], [2, 4]]
fixed = [0, 1, 3, 4]
node_masses = [0.1, 0.1, 0.1, 0.1, 0.1]
cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 1e8 }

[bodies.ball]
shape = "sphere"
radius = 0.25
mass = 0.2
position = [0.0, 0.0, 0.252]
motion = "port"

[effects.contact]
threads = ["ball"]
law = "linear"
stiffness = 1e4
restitution = 0.5
impact_speed = 0.5
"""

# A box that lies on a thread of 1 m between two fixed nodes: a mass on the spring K L, of K 1e4 N/m2.
MASS, STIFFNESS, GRAVITY = 2.0, 1e4, 9.81
DEPTH = MASS * GRAVITY / STIFFNESS  # [m] at rest
RADIUS = 0.001  # [m] of the thread
BOX = f"""
format = 1
title = "A box on a thread"
time = {{ end = 9.0, output_step = 1.0 }}
solver = {{ method = "RK44", step = 2e-4 }}
engine.backend = "compiled"
initial.packing = 1.0
effects.gravity.acceleration = [0.0, 0.0, -{GRAVITY}]

[net]
topology = "explicit"
nodes = [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.0, -5.0]]
elements = [[0, 1]]
fixed = [0, 1]
node_masses = [0.1, 0.1, 0.1]
cable = {{ diameter = {2.0 * RADIUS}, density = 1390.0, youngs_modulus = 1e8 }}

[bodies.box]
shape = "box"
size = [1.2, 0.2, 0.2]
edge_radius = 0.02
mass = {MASS}
inertia = [1e9, 1e9, 1e9]
position = [0.0, 0.0, {0.1 + RADIUS - DEPTH}]
velocity = [0.0, 0.0, 0.01]
motion = "port"

[effects.contact]
threads = ["box"]
law = "linear"
stiffness = {STIFFNESS}
restitution = 1.0
impact_speed = 0.1
"""


def written(folder: Path, case: str) -> Path:
    file = folder / "case.toml"
    file.write_text(case)
    return file


@pytest.mark.slow
def test_a_ball_that_falls_onto_a_net_does_as_in_one_system(tmp_path: Path) -> None:
    """Asked for steps of 20 ms, which threw the ball up at 1.2 m/s, it takes shorter ones."""
    file = written(tmp_path, BALL)
    whole = exunet.Simulation(file, ["bodies.ball.motion=free"])
    net = NetSystem(file)
    host = BodiesHost.of_ports(net)
    both = Cosimulation(net, host, step=0.02)
    assert both.longest < 2e-3
    assert "macro steps of 0.02 s cut to" in both.books.cut
    for time in (0.2, 0.4):  # on the net, and thrown up by it
        whole.advance_to(time)
        both.advance_to(time)
        known, found = whole.bodies["ball"], host.frames()["ball"]
        np.testing.assert_allclose(found.position, known.position, atol=2e-6)
        np.testing.assert_allclose(found.velocity, known.velocity, atol=2e-5)


@pytest.mark.ci
@pytest.mark.slow
def test_what_counts(tmp_path: Path) -> None:
    """By hand: K L of all threads at the mobility of the surface, damping by the depth of an impact."""
    file = written(tmp_path, BALL)
    mobility = 1.0 / 0.2 + 0.25**2 / (0.4 * 0.2 * 0.25**2)
    spring = 1e4 * 2.0 * mobility
    undamped = ["effects.contact.restitution=1.0"]
    assert ratios_of(NetSystem(file, undamped), "ball")[:2] == pytest.approx((spring, 0.0), rel=1e-12)
    assert longest_step(NetSystem(file, undamped), CONTRACTING) == pytest.approx(
        MARGIN * math.sqrt(6.0 / spring)
    )
    smooth = [
        *undamped,
        *(f"effects.contact.friction.{key}" for key in ("coefficient=0.3", "slip_speed=0.01")),
    ]
    smooth.append("effects.contact.friction.law=regularised")
    # the body alone at 0.5 m/s on that spring gets v / omega deep, with the force k v / omega = m omega v
    rubbing = math.sqrt(spring) * 0.5 * 0.3 / 0.01
    assert ratios_of(NetSystem(file, smooth), "ball")[:2] == pytest.approx((spring, rubbing), rel=1e-12)
    sticking = [
        *undamped,
        *(f"effects.contact.friction.{key}" for key in ("coefficient=0.3", "law=sticking")),
    ]
    # k_t theta = 2 zeta sqrt(m k_t) of each of four threads of 0.5 m and 2 mm, with k_t = K L / 2, zeta = 0.1
    thread = 1390.0 * math.pi * 0.001**2 * 0.5
    rubbing = 4.0 * 2.0 * 0.1 * math.sqrt(thread * 0.5 * 1e4 * 0.5) * mobility
    assert ratios_of(NetSystem(file, sticking), "ball")[:2] == pytest.approx((spring, rubbing), rel=1e-12)
    damped = ratios_of(NetSystem(file), "ball").damper
    assert damped == pytest.approx(math.sqrt(spring) * 0.5 * _damping(0.5, 0.5), rel=1e-9)


@pytest.mark.slow
def test_bullets_count_beside_threads() -> None:
    """The net of a capture: 7 + 7 threads of 1.5 m, and 4 bullets, on a sphere of 2 kg."""
    case = Path(__file__).parents[1] / "cases" / "capture" / "free_sphere.toml"
    net = NetSystem(case, ["engine.backend=compiled", "bodies.ball.motion=port"])
    stiffness = 1e3 * 14 * 1.5 + 5e3 * 4
    mobility = (1.0 + 1.0 / 0.4) / 2.0  # at its radius, whatever that is
    assert ratios_of(net, "ball").spring == pytest.approx(stiffness * mobility, rel=1e-12)


def _damping(restitution: float, speed: float) -> float:
    """a: d (1 + e) = ln((1 + d) / (1 - e d)) with d = a v, by bisection."""
    low, high = 1e-6, 1.0 / restitution - 1e-12
    for _ in range(200):
        d = 0.5 * (low + high)
        if d * (1.0 + restitution) > math.log((1.0 + d) / (1.0 - restitution * d)):
            low = d
        else:
            high = d
    return 0.5 * (low + high) / speed


class Box:
    """The box in Exudyn, coupled to its thread, at rest on it but for 1 cm/s."""

    def __init__(self, file: Path) -> None:
        self.net = NetSystem(file)
        self.mbs: Any = exu.SystemContainer().AddSystem()
        moves = {"initialCoordinates": [0, 0, 0.1 + RADIUS - DEPTH, 0, 0, 0]}
        moves["initialVelocities"] = [0, 0, 0.01, 0, 0, 0]
        node = self.mbs.AddNode(NodeRigidBodyRotVecLG(referenceCoordinates=[0.0] * 6, **moves))
        body = ObjectRigidBody(mass=MASS, inertia=[1e9] * 3 + [0] * 3, nodeNumber=node)
        number = self.mbs.AddObject(body)
        weight = self.mbs.AddMarker(MarkerBodyMass(bodyNumber=number))
        self.mbs.AddLoad(LoadMassProportional(markerNumber=weight, loadVector=[0, 0, -GRAVITY]))
        self.marker = self.mbs.AddMarker(MarkerBodyRigid(bodyNumber=number))

    def swing(self, step: float, number: int, **longest: float) -> float:
        """Largest distance from where it rests in the last quarter of all steps, in amplitudes."""
        places: list[float] = []

        def look(mbs: Any, t: float) -> bool:
            places.append(float(mbs.GetMarkerOutput(self.marker, exu.OutputVariableType.Position)[2]))
            return True

        self.mbs.SetPreStepUserFunction(look)
        exunet.couple(self.mbs, self.net, {"box": self.marker}, **longest)
        settings = exu.SimulationSettings()
        settings.solution.file.write = False
        settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = number, number * step
        settings.timeIntegration.explicit.useLieGroupIntegration = True
        self.mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.RK44)
        off = np.abs(np.array(places) - (0.1 + RADIUS - DEPTH))
        return float(off[-number // 4 :].max() / (0.01 * math.sqrt(MASS / STIFFNESS)))


@pytest.mark.ci
@pytest.mark.slow
def test_where_the_box_on_a_thread_begins_to_swing_up(tmp_path: Path) -> None:
    """Predicted and measured: sqrt(m / K L), 14.1 ms. It dies out below and grows above."""
    file = written(tmp_path, BOX)
    bound = longest_step(NetSystem(file), STABLE) / MARGIN
    assert bound == pytest.approx(math.sqrt(MASS / STIFFNESS), rel=1e-6)
    assert Box(file).swing(0.94 * bound, 60) < 0.5
    assert Box(file).swing(1.05 * bound, 60, longest=1.0) > 1.5
    with pytest.raises(exu.ModelError, match="is beyond the largest stable one of its method"):
        Box(file).swing(1.05 * bound, 60)


@pytest.mark.slow
def test_how_far_on_the_safe_side_a_ball_on_a_net_is(tmp_path: Path) -> None:
    """Predicted 0.50 ms; up to 16 times that takes energy out, 18 times adds some, which is told."""
    file, radius, mass = written(tmp_path, BALL), 0.25, 0.2
    bound = longest_step(NetSystem(file), STABLE)
    assert bound == pytest.approx(5.05e-4, rel=0.01)
    for times, adds in ((12, False), (20, True)):
        mbs: Any = exu.SystemContainer().AddSystem()
        node = mbs.AddNode(NodeRigidBodyRotVecLG(referenceCoordinates=[0.0, 0.0, 0.252, 0.0, 0.0, 0.0]))
        inertia = [0.4 * mass * radius**2] * 3 + [0] * 3
        number = mbs.AddObject(ObjectRigidBody(mass=mass, inertia=inertia, nodeNumber=node))
        weight = mbs.AddMarker(MarkerBodyMass(bodyNumber=number))
        mbs.AddLoad(LoadMassProportional(markerNumber=weight, loadVector=[0, 0, -GRAVITY]))
        marker = mbs.AddMarker(MarkerBodyRigid(bodyNumber=number))
        coupling = exunet.couple(mbs, NetSystem(file), {"ball": marker}, longest=1.0)
        settings, steps = exu.SimulationSettings(), round(1.0 / (times * bound))
        settings.solution.file.write = False
        settings.timeIntegration.numberOfSteps = steps
        settings.timeIntegration.endTime = steps * times * bound
        settings.timeIntegration.explicit.useLieGroupIntegration = True
        mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.RK44)
        report = coupling.report()
        assert (report.residual > 0.0) == adds
        assert bool(report.doubts) == adds
