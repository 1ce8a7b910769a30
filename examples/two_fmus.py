"""A net in one FMU, the chaser that throws it in another: python examples/two_fmus.py [END] [STEP]

The chaser of arm_throws_and_tows.py, base, two-joint arm and reaction wheel, is a separate FMU, made here
from arm_chaser.c and a model description (this takes gcc). The net, its tether and the target are the case
arm_net.toml as an FMU of exunet. Any host that speaks FMI couples them so; here it is a loop over FMPy (pip
install fmpy). The net goes first in each step, and the hand gets the mean force and torque that come out.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import exunet

HERE = Path(__file__).parent
MOTION = [f"{what}.{axis}" for what in ("position", "velocity") for axis in "xyz"]
MOTION += [f"attitude.{part}" for part in "wxyz"] + [f"angular_velocity.{axis}" for axis in "xyz"]
WRENCH = [f"{what}.{axis}" for what in ("force", "torque") for axis in "xyz"]
MOMENTUM = [f"momentum.{axis}" for axis in "xyz"]
# The variables of arm_chaser.c, in its order; all are outputs but the wrench.
CHASER = [*(f"hand.{name}" for name in MOTION + WRENCH), "turned", "wheel", *MOMENTUM, "elbow"]
THRUST = (0.0, 0.0, -40.0)  # N, on the base all the time


class Row(NamedTuple):
    """At one time [s].

    turned    : angle of the base about x [rad]
    wheel     : how fast the wheel turns in the base [rad/s]
    target    : how fast the target moves along z [m/s]
    unbalance : momentum of the chaser, less what the thruster and the net gave it [N s]
    """

    time: float
    turned: float
    wheel: float
    target: float
    unbalance: float


def make_chaser(path: Path) -> Path:
    """The chaser as an FMU: a library, and the description of its variables."""
    import fmpy

    library = path.with_suffix(".so")
    options = ["-O2", "-fPIC", "-shared", "-std=c11", "-D_DEFAULT_SOURCE"]
    subprocess.run(["gcc", *options, "-o", library, HERE / "arm_chaser.c", "-lm"], check=True)
    inputs_at_end = [
        f'<Float64 name="{name}" valueReference="{k}" '
        + (
            'causality="input" start="0"/>'
            if name.removeprefix("hand.") in WRENCH
            else 'causality="output" initial="calculated"/>'
        )
        for k, name in enumerate(CHASER, start=1)
    ]
    known = [
        f'<{kind} valueReference="{k}"/>'
        for kind in ("Output", "InitialUnknown")
        for k, name in enumerate(CHASER, start=1)
        if name.removeprefix("hand.") not in WRENCH
    ]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<fmiModelDescription fmiVersion="3.0" modelName="arm_chaser" instantiationToken="arm_chaser">',
        '<CoSimulation modelIdentifier="arm_chaser" canHandleVariableCommunicationStepSize="true"/>',
        '<ModelVariables><Float64 name="time" valueReference="0" causality="independent" '
        'variability="continuous"/>',
        *inputs_at_end,
        "</ModelVariables><ModelStructure>",
        *known,
        "</ModelStructure></fmiModelDescription>",
    ]
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("modelDescription.xml", "\n".join(lines))
        packed.write(library, f"binaries/{fmpy.platform_tuple}/arm_chaser{fmpy.sharedLibraryExtension}")
        packed.write(HERE / "arm_chaser.c", "sources/arm_chaser.c")
    return path


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

    def read(self, names: list[str]) -> list[float]:
        return list(self.fmu.getFloat64([self.references[name] for name in names]))

    def get(self, of: str, names: list[str]) -> list[float]:
        return self.read([f"{of}.{name}" for name in names])

    def set(self, of: str, names: list[str], values: list[float]) -> None:
        self.fmu.setFloat64([self.references[f"{of}.{name}"] for name in names], values)

    def step(self, begin: float, length: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=begin, communicationStepSize=length)

    def close(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()


def main(end: str = "8.0", step: str = "0.004") -> list[Row]:
    """Print the final motion of chaser and target."""
    length, number = float(step), round(float(end) / float(step))
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        net = Fmu(exunet.export_fmu(HERE / "arm_net.toml", here / "net.fmu"), here / "net")
        chaser = Fmu(make_chaser(here / "chaser.fmu"), here / "chaser")
        for k in range(number):
            net.set("ports.hand", MOTION, chaser.get("hand", MOTION))
            net.step(k * length, length)
            chaser.set("hand", WRENCH, net.get("ports.hand", WRENCH))
            chaser.step(k * length, length)
            time, (turned, wheel, *momentum) = (k + 1) * length, chaser.read(["turned", "wheel", *MOMENTUM])
            given = net.get("ports.hand", [f"impulse.{axis}" for axis in "xyz"])
            left = [p - i - time * f for p, i, f in zip(momentum, given, THRUST, strict=True)]
            (target,) = net.get("bodies.target", ["velocity.z"])
            rows.append(Row(time, turned, wheel, target, math.hypot(*left)))
        net.close()
        chaser.close()
    last, most = rows[-1], max(abs(row.turned) for row in rows)
    print(f"momentum of the chaser less what it got: {max(row.unbalance for row in rows):.1e} N s at most")
    angles = (
        f"{math.degrees(most):.2f} deg at most, by {math.degrees(last.turned):.2f} deg at {last.time:g} s"
    )
    print(f"the base has turned by {angles};")
    print(f"its wheel turns at {last.wheel:.1f} rad/s then, and the target goes {last.target:.3f} m/s")
    return rows


if __name__ == "__main__":
    main(*sys.argv[1:])
