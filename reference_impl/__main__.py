"""The run that `exunet run --check` compares with: arguments and output file in README.md."""

from __future__ import annotations

import argparse
import sys
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference_impl.integration import Diverged, Trajectory
from reference_impl.read import parse_override, read
from reference_impl.scene import prepare
from reference_impl.start import with_places
from reference_impl.system import System
from reference_impl.table import Refused

DONE, REFUSED, DIVERGED = 0, 2, 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Integrates a case by DOP853 and writes its states; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m reference_impl", description="Integrates a case.")
    parser.add_argument("case", type=Path, help="case file (docs/reference/keys)")
    parser.add_argument("output", type=Path, help="archive of the states (.npz)")
    parser.add_argument(
        "--places",
        type=Path,
        metavar="FILE.npz",
        help="of a folded net: reference_position, place (n, 3) [m] of its nodes at time 0, in its axes",
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="replaces a value of the case"
    )
    try:
        return _run(parser.parse_args(arguments))
    except Refused as refused:
        _report("\n".join(refused.faults))
    except MemoryError:
        _report("the case does not fit into memory")
    return REFUSED


def _run(options: argparse.Namespace) -> int:
    case = read(options.case, dict(map(parse_override, options.set)))
    if options.places is not None:
        try:
            with np.load(options.places) as file:
                case = with_places(case, file["reference_position"], file["place"])
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise Refused(
                [f"{options.places}: reference_position and place cannot be read: {error}"]
            ) from error
    scene = prepare(case)
    sys.stdout.write("known\n")
    sys.stdout.flush()
    code = DONE
    try:
        trajectory = scene.integrate(progress=_Reports())
    except Diverged as diverged:
        trajectory, code = diverged.trajectory, DIVERGED
        _report(str(diverged))
    np.savez(options.output, **contents(scene.system, trajectory, code == DONE))  # type: ignore[arg-type]
    return code


def _report(message: str) -> None:
    for line in message.splitlines():
        sys.stderr.write(f"reference_impl: {' '.join(line.split())}\n")


class _Reports:
    """Prints the time that is reached [s], a line each, at most five times a second."""

    def __init__(self) -> None:
        self.last = time.monotonic()

    def __call__(self, reached: float, end: float) -> None:
        if time.monotonic() - self.last > 0.2 or reached == end:
            self.last = time.monotonic()
            sys.stdout.write(f"{reached:.17g}\n")
            sys.stdout.flush()


def contents(system: System, trajectory: Trajectory, complete: bool) -> dict[str, NDArray[Any]]:
    """Arrays of the output file: states, net, bodies and breaks."""
    net, bodies, states, breaks = system.net, system.bodies, trajectory.bodies, trajectory.breaks
    return {
        "complete": np.array(complete),
        "time": trajectory.t,
        "position": trajectory.x,
        "velocity": trajectory.v,
        "reference_position": net.reference_position,
        "element_nodes": net.element_nodes,
        "bullet_nodes": net.bullet_nodes,
        "fixed_nodes": net.fixed_nodes,
        "mass": net.mass,
        "reference_length": net.reference_length,
        "axial_stiffness": net.youngs_modulus * net.area,
        "body_names": np.array(bodies.names, dtype=str),
        "body_mass": bodies.mass,
        "body_inertia": bodies.inertia,
        "body_position": states.position,
        "body_velocity": states.velocity,
        "body_attitude": states.attitude,
        "body_angular_velocity": states.angular_velocity,
        "break_element": np.array([b.element for b in breaks], dtype=np.intp),
        "break_time": np.array([b.time for b in breaks], dtype=float),
    }


if __name__ == "__main__":
    sys.exit(main())
