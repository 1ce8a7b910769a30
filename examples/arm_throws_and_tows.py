"""A chaser of one's own throws a net and tows a target: python examples/arm_throws_and_tows.py [END] [FIGURE]

The chaser is an Exudyn system of base, two-joint arm and reaction wheel, solved implicitly. The net, its
tether and the target are the case arm_net.toml, whose port "hand" is the end of the arm.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

import exudyn
import exudyn.utilities as items
import numpy as np
from exudyn import OutputVariableType as Output
from matplotlib.figure import Figure

import exunet

CASE = Path(__file__).with_name("arm_net.toml")
STEP, EVERY = 4e-3, 5  # s, of the chaser (the net takes its own); steps between two rows
THRUST = np.array([0.0, 0.0, -40.0])  # N, on the base all the time
SWING, LASTS, ANGLE = 2.0, 1.5, np.pi / 4  # the shoulder turns from 2 s on, for 1.5 s, by so much
STIFF, DAMPED = 200.0, 150.0  # of the wheel's control: N m/rad, N m s/rad
SHOWN = (0.2, 0.7, 3.6, 6.4)  # s, in the figure


class Row(NamedTuple):
    """At one time [s].

    tension   : largest of the tether [N]
    turned    : angle of the base about x [rad]
    wheel     : how fast the wheel turns in the base [rad/s]
    target    : how fast the target moves along z [m/s]
    unbalance : momentum of chaser, net and target, less what the thruster gave [N s]
    """

    time: float
    tension: float
    turned: float
    wheel: float
    target: float
    unbalance: float


class Chaser:
    """Base, upper arm, forearm, wheel, at rest; the hand is at the scene's origin, joints turn about x."""

    def __init__(self) -> None:
        self.mbs = exudyn.SystemContainer().AddSystem()
        self.base = self.body(items.InertiaCuboid(120.0, [1.0, 1.0, 1.0]), [0.0, -0.7, -1.25])
        self.upper = self.body(items.InertiaCuboid(1500.0, [0.08, 0.7, 0.08]), [0.0, -0.35, -0.7])
        self.fore = self.body(items.InertiaCuboid(1500.0, [0.08, 0.08, 0.7]), [0.0, 0.0, -0.35])
        self.wheel = self.body(items.InertiaCylinder(2700.0, 0.03, 0.3, axis=0), [0.0, -0.7, -1.25])
        drive = {"stiffness": 5000.0, "damping": 500.0}  # N m/rad, N m s/rad
        self.shoulder = self.joint(self.base, self.upper, [0.0, -0.7, -0.7], **drive)
        self.joint(self.upper, self.fore, [0.0, 0.0, -0.7], **drive)
        self.motor = self.joint(self.base, self.wheel, [0.0, -0.7, -1.25])
        self.hand = self.marker(self.fore, [0.0, 0.0, 0.35])
        thruster = self.marker(self.base, [0.0, 0.0, 0.0])
        self.mbs.AddLoad(items.LoadForceVector(markerNumber=thruster, loadVector=THRUST))

    def body(self, inertia: Any, position: list[float]) -> int:
        return self.mbs.CreateRigidBody(referencePosition=position, inertia=inertia)

    def joint(self, one: int, other: int, position: list[float], **drive: float) -> int:
        """A hinge with a drive; returns the drive's number."""
        where = {"itemNumbers": [one, other], "position": position, "axis": [1.0, 0.0, 0.0]}
        self.mbs.CreateRevoluteJoint(**where)
        return self.mbs.CreateTorsionalSpringDamper(**where, **drive)

    def marker(self, body: int, point: list[float]) -> int:
        return self.mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localPosition=point))

    def of(self, body: int, what: Any, point: tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
        return self.mbs.GetObjectOutputBody(body, what, point)

    def control(self, until: float) -> None:
        """Before a step: the wheel's motor holds the base's attitude, the shoulder goes through its swing."""
        spin = self.of(self.base, Output.AngularVelocity)[0]
        self.mbs.SetObjectParameter(self.motor, "torque", -STIFF * self.turned - DAMPED * spin)
        part = np.clip((until - SWING) / LASTS, 0.0, 1.0)
        self.mbs.SetObjectParameter(self.shoulder, "offset", ANGLE * part**2 * (3.0 - 2.0 * part))

    @property
    def turned(self) -> float:
        return float(self.of(self.base, Output.Rotation)[0])

    @property
    def wheel_speed(self) -> float:
        spins = [self.of(body, Output.AngularVelocity)[0] for body in (self.wheel, self.base)]
        return float(spins[0] - spins[1])

    @property
    def momentum(self) -> np.ndarray:
        bodies = (self.base, self.upper, self.fore, self.wheel)
        masses = [self.mbs.GetObjectParameter(body, "mass") for body in bodies]
        return sum(m * self.of(body, Output.Velocity) for m, body in zip(masses, bodies, strict=True))

    @property
    def outline(self) -> np.ndarray:
        """(k, 3) corners of the base in the plane of the arm, shoulder, elbow, hand."""
        square = [(0.0, y, z) for y, z in ((0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5))]
        corners = [self.of(self.base, Output.Position, point) for point in [*square[2:], *square[1:3]]]
        arm = [(self.upper, (0.0, -0.35, 0.0)), (self.upper, (0.0, 0.35, 0.0)), (self.fore, (0.0, 0.0, 0.35))]
        return np.array([*corners, *(self.of(body, Output.Position, point) for body, point in arm)])


def main(end: str = "8.0", figure: str = "") -> list[Row]:
    """Print the coupling's report and the motion of chaser and target; draw a figure if named."""
    exudyn.config.printToConsole = False
    chaser, net = Chaser(), exunet.NetSystem(CASE)
    rows: list[Row] = []
    seen: dict[float, Any] = {}
    steps, tow = round(float(end) / STEP), net.simulation.start.net.tether_elements["tow"]

    def look(time: float) -> None:
        """At the end of a macro step."""
        shown, target = net.simulation.net, net.simulation.bodies["target"]
        left = chaser.momentum + net.momentum - THRUST * time
        numbers = chaser.turned, chaser.wheel_speed, target.velocity[2], np.linalg.norm(left)
        rows.append(Row(time, shown.tension[tow].max(), *map(float, numbers)))
        for instant in SHOWN:
            if abs(time - instant) < 0.5 * STEP:
                seen[instant] = chaser.outline, shown.position, target.position

    def before_step(_: Any, until: float) -> bool:
        chaser.control(until)
        return True

    chaser.mbs.SetPreStepUserFunction(before_step)
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.newton.relativeTolerance = 1e-10
    settings.linearSolver.solverType = exudyn.LinearSolverType.EigenSparse
    settings.solution.file.write = False
    solver = {"step": STEP, "method": "GeneralizedAlpha", "settings": settings}
    host = exunet.ExudynHost(chaser.mbs, {"hand": chaser.hand}, **solver)
    coupler = exunet.Coupler(net, host, step=STEP)
    look(0.0)
    for k in range(EVERY, steps + 1, EVERY):
        coupler.advance_to(k * STEP)
        look(k * STEP)

    print(coupler.ledger)
    last, peak = rows[-1], max(rows, key=lambda row: row.tension)
    turned = np.degrees([max(abs(row.turned) for row in rows), last.turned])
    print(f"momentum of all less the thruster's: {max(row.unbalance for row in rows):.1e} N s at most")
    print(f"largest tension of the tether: {peak.tension:.1f} N at {peak.time:.2f} s")
    print(f"the base has turned by {turned[0]:.2f} deg at most, by {turned[1]:.2f} deg at {last.time:g} s;")
    print(f"its wheel turns at {last.wheel:.1f} rad/s then, and the target goes {last.target:.3f} m/s")
    if figure:
        draw(rows, seen, net, figure)
    return rows


def draw(rows: list[Row], seen: dict[float, Any], net: exunet.NetSystem, name: str) -> None:
    """The scene from the side at some instants, and what the chaser feels."""
    page = Figure(figsize=(7.5, 8.5), layout="constrained")
    views, curves = page.subfigures(2, 1, height_ratios=(2.2, 1.0))
    panels = np.atleast_1d(views.subplots(len(seen), 1, sharex=True, sharey=True))
    for axes, (instant, (outline, position, target)) in zip(panels, seen.items(), strict=True):
        for ends in net.simulation.start.net.element_nodes:
            axes.plot(position[ends, 2], position[ends, 1], color="tab:blue", linewidth=0.8)
        axes.plot(outline[:, 2], outline[:, 1], color="black", linewidth=1.2)
        axes.plot(target[2], target[1], "o", color="tab:red", markersize=8)
        axes.set(ylabel="y [m]", title=f"{instant:g} s", xlim=(-9.0, 4.0), ylim=(-1.7, 1.2), aspect="equal")
    panels[-1].set_xlabel("z [m]")
    time = [row.time for row in rows]
    left, right = curves.subplots(1, 2)
    left.plot(time, [row.tension for row in rows])
    left.set(xlabel="time [s]", ylabel="tension of the tether [N]")
    right.plot(time, np.degrees([row.turned for row in rows]))
    right.set(xlabel="time [s]", ylabel="angle of the base [deg]")
    page.savefig(name, dpi=150)


if __name__ == "__main__":
    main(*sys.argv[1:3])
