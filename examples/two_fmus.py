"""A chaser in one FMU, the tether and its target in another: python examples/two_fmus.py [CASE] [END] [STEP]

Any host that speaks FMI couples them so; here it is a loop over FMPy (pip install fmpy). The net goes first
in each step, and the chaser gets the mean force and torque that come out of it.
"""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import exunet

MOTION = [f"{what}.{axis}" for what in ("position", "velocity") for axis in "xyz"]
MOTION += [f"attitude.{part}" for part in "wxyz"] + [f"angular_velocity.{axis}" for axis in "xyz"]
WRENCH = [f"{what}.{axis}" for what in ("force", "torque") for axis in "xyz"]


class Fmu:
    """An FMU that FMPy has loaded, with its variables by name."""

    def __init__(self, path: Path, folder: Path) -> None:
        import fmpy

        folder = Path(fmpy.extract(str(path), str(folder)))
        description = fmpy.read_model_description(str(folder))
        self.fmu: Any = fmpy.instantiate_fmu(str(folder), description, "CoSimulation")
        self.references = {one.name: one.valueReference for one in description.modelVariables}
        self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()

    def get(self, of: str, names: list[str]) -> list[float]:
        return list(self.fmu.getFloat64([self.references[f"{of}.{name}"] for name in names]))

    def set(self, of: str, names: list[str], values: list[float]) -> None:
        self.fmu.setFloat64([self.references[f"{of}.{name}"] for name in names], values)

    def step(self, begin: float, length: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=begin, communicationStepSize=length)

    def close(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()


def main(case: str = "cases/bodies/tow.toml", end: str = "8.0", step: str = "0.01") -> tuple[float, float]:
    """Prints and returns how far the chaser is from where one system has it at `end` [m], and what of its
    momentum the tether has not given [N s].
    """
    of_net = ["bodies.chaser.motion=port"]
    carried = exunet.NetSystem(case, of_net).carried_mass("chaser")
    mass = exunet.load(case).scene.bodies["chaser"].mass or 0.0
    alone = ["tethers=", "bodies.target=", f"bodies.chaser.mass={mass + carried}"]
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        net = Fmu(exunet.export_fmu(case, here / "net.fmu", of_net), here / "net")
        chaser = Fmu(exunet.export_fmu(case, here / "chaser.fmu", alone), here / "chaser")
        start = chaser.get("bodies.chaser", MOTION)[3:6]
        length, number = float(step), round(float(end) / float(step))
        for k in range(number):
            net.set("ports.chaser", MOTION, chaser.get("bodies.chaser", MOTION))
            net.step(k * length, length)
            chaser.set("bodies.chaser", WRENCH, net.get("ports.chaser", WRENCH))
            chaser.step(k * length, length)
        motion = chaser.get("bodies.chaser", MOTION)
        impulse = net.get("ports.chaser", [f"impulse.{axis}" for axis in "xyz"])
        net.close()
        chaser.close()
    whole = exunet.Simulation(case)
    whole.advance_to(number * length)
    apart = math.dist(motion[:3], whole.bodies["chaser"].position)
    gained = [(mass + carried) * (after - before) for before, after in zip(start, motion[3:6], strict=True)]
    missing = math.dist(gained, impulse)
    given = f"{math.hypot(*impulse):.4f} N s, to {missing:.0e} what it has gained"
    print(f"at {number * length:g} s the tether has given the chaser {given}")
    print(f"the chaser is {apart:.2e} m from where it is with all bodies in one system")
    return apart, missing


if __name__ == "__main__":
    main(*sys.argv[1:])
