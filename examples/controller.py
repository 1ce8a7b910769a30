"""A controller in the loop, set back together with the simulation: python examples/controller.py [CASE]

A chaser holds place and attitude while a target drifts away, until the slack tether between them snaps taut
and pulls beside the chaser's centre of mass. CASE has a free body "chaser" and runs in the compiled loop.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import exunet

PERIOD, SNAPS, END = 0.01, 0.8, 6.0  # s
PLACE = 400.0, 400.0, 20.0  # N/m, N s/m, N/(m s)
ATTITUDE = 150.0, 75.0  # N m/rad, N m s/rad
MOST = np.array([100.0, 100.0, 100.0, 40.0, 40.0, 40.0])  # N, N m


@dataclass
class Controller:
    """Holds a body where it is: PID in place, PD in attitude.

    body   : its row among the rigid bodies
    place  : (3,) to be held [m]
    turned : to be held
    missed : (3,) integral of the distance from the place [m s]; the only state of the controller
    """

    body: int
    place: np.ndarray
    turned: Rotation
    missed: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(cls, simulation: exunet.Simulation, name: str) -> Controller:
        row, bodies = simulation.start.system.blocks.rigid.index(name), simulation.view.bodies
        turned = Rotation.from_quat(bodies.attitude[row], scalar_first=True)
        return cls(row, bodies.position[row].copy(), turned)

    def wrench(self, simulation: exunet.Simulation) -> np.ndarray:
        """(6,) force [N] and torque [N m] for the next period, from a look at the state without copies."""
        bodies, row = simulation.view.bodies, self.body
        off = bodies.position[row] - self.place
        self.missed = self.missed + PERIOD * off
        force = PLACE[0] * off + PLACE[1] * bodies.velocity[row] + PLACE[2] * self.missed
        now = Rotation.from_quat(bodies.attitude[row], scalar_first=True)
        angle = (now * self.turned.inv()).as_rotvec()  # as the force and the torque in the scene's axes
        torque = ATTITUDE[0] * angle + ATTITUDE[1] * now.apply(bodies.angular_velocity[row])
        return np.clip(np.concatenate([-force, -torque]), -MOST, MOST)


class Found(NamedTuple):
    """farthest : of the chaser from its place [m]; at_end: its distance at the end [m]
    restored, reset : True if the way from the snapshot, and that from the start, are the same to the last bit
    forgotten       : how far the chaser ends away if the controller's state is not set back [m]
    """

    farthest: float
    at_end: float
    restored: bool
    reset: bool
    forgotten: float


def to_end(simulation: exunet.Simulation, controller: Controller, until: float = END) -> np.ndarray:
    """Control the chaser; (k, 3) its places after each period [m]."""
    places = []
    while simulation.time < until - 0.5 * PERIOD:
        simulation.set_input("wrench/chaser", controller.wrench(simulation))
        simulation.advance(PERIOD)
        places.append(simulation.view.bodies.position[controller.body].copy())
    return np.array(places)


CASE = str(Path(__file__).parents[1] / "cases" / "bodies" / "snap.toml")


def main(case: str = CASE) -> Found:
    """Prints and returns what the controller reaches, and that the same way can be gone again."""
    changes = ["engine.backend=compiled", "effects.material_damping.relaxation_time=1e-3"]
    simulation = exunet.Simulation(case, changes, wrenches=("chaser",))
    controller = Controller.of(simulation, "chaser")
    before = to_end(simulation, controller, SNAPS)
    here, missed = (
        simulation.snapshot(),
        controller.missed,
    )  # both: the simulation does not know the controller
    after = to_end(simulation, controller)
    away = np.linalg.norm(np.concatenate([before, after]) - controller.place, axis=1)

    simulation.restore(here)
    forgotten = float(np.linalg.norm(to_end(simulation, controller)[-1] - after[-1]))
    simulation.restore(here)
    controller.missed = missed
    restored = np.array_equal(to_end(simulation, controller), after)

    simulation.reset()
    again = to_end(simulation, Controller.of(simulation, "chaser"))
    reset = np.array_equal(again, np.concatenate([before, after]))

    found = Found(float(away.max()), float(away[-1]), restored, reset, forgotten)
    print(
        f"the snap pulls the chaser {found.farthest:.3f} m away; at {END:g} s it is {found.at_end:.3f} m away"
    )
    print(f"from the snapshot of {SNAPS:g} s, in the snap, to the end again: same bits: {restored}")
    print(f"from the start, after reset: same bits: {reset}")
    print(f"with a controller that was not set back it ends {1e3 * forgotten:.1f} mm elsewhere")
    return found


if __name__ == "__main__":
    main(*sys.argv[1:2])
