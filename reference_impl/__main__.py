"""Command line: `python -m reference_impl CASE -o out.npz`; exit codes and the file's content: README.md."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from reference_impl.archive import contents, save
from reference_impl.arrays import Floats
from reference_impl.case import Refused
from reference_impl.fold import with_places
from reference_impl.integration import (
    METHODS,
    STEPPED,
    Diverged,
    Interrupted,
    Pierced,
    Progress,
    Scheme,
    Trajectory,
    integrate,
    unsupported,
)
from reference_impl.internal import greatest_frequency
from reference_impl.read import parse_override, read
from reference_impl.scene import prepare
from reference_impl.system import System

ARITHMETIC: dict[str, dict[str, bool]] = {
    "plain": {},
    "symmetric": {"symmetric": True},
    "assembled": {"assembled": True},
}
DONE, REFUSED, DIVERGED, INTERRUPTED = 0, 2, 3, 130


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        raise Refused([message])


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="python -m reference_impl", description="Integrates the cable net of a case file.")
    parser.add_argument("case", type=Path, help="case file (docs/keys.md)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.npz")
    parser.add_argument("--method", choices=METHODS, default="DOP853")
    parser.add_argument("--rtol", type=_positive, help="relative tolerance of DOP853 (1e-10) or RK45 (1e-3)")
    parser.add_argument("--atol", type=_positive, help="absolute tolerance [m, m/s]: DOP853 1e-12, RK45 1e-6")
    parser.add_argument("--step", type=_positive, help="step of RK4, Verlet or EM [s]")
    parser.add_argument("--arithmetic", choices=ARITHMETIC, help="default: plain; assembled for RK45")
    parser.add_argument(
        "--symmetric",
        dest="arithmetic",
        action="store_const",
        const="symmetric",
        help="the same as --arithmetic symmetric: keep mirror symmetries to the last bit",
    )
    parser.add_argument(
        "--places",
        type=Path,
        metavar="FILE.npz",
        help="of a folded net's nodes at time 0: arrays reference_position and place (n, 3) [m], in its axes",
    )
    parser.add_argument(
        "--progress", action="store_true", help="print the time that is reached [s] now and then, a line each"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="replaces a value of the case"
    )
    return parser


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number greater than 0")
    return value


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    try:
        return _run(_parser().parse_args(arguments))
    except Refused as refused:
        for fault in refused.faults:
            _say(fault)
        return REFUSED
    except MemoryError:
        _say("the case does not fit into memory: fewer elements or stored times")
        return REFUSED
    except KeyboardInterrupt:
        _say("interrupted before anything was stored; nothing written")
        return INTERRUPTED


def _say(message: str) -> None:
    sys.stderr.write("reference_impl: " + " ".join(message.split()) + "\n")


def _run(options: argparse.Namespace) -> int:
    _check(options)
    overrides = dict(parse_override(text) for text in options.set)
    # RK45 is here to do what the paper did, with the matrices of eq. (16) as printed
    arithmetic = options.arithmetic or ("assembled" if options.method == "RK45" else "plain")
    case = read(options.case, overrides)
    if options.places is not None:
        case = with_places(case, *_places(options.places))
    scene = prepare(case, **ARITHMETIC[arithmetic])
    system = scene.system
    if options.method == "EM" and (reason := unsupported(system)):
        raise Refused([f"--method EM: reference_impl does not do it with {reason}"])
    rtol, atol = Scheme(options.method, options.rtol, options.atol, options.step).tolerances
    provenance: dict[str, Any] = {
        "program": "reference_impl",
        "case": scene.case.source,
        "overrides": overrides,
        "method": options.method,
        "rtol": rtol,
        "atol": atol,
        "step": options.step,
        "symmetric": system.symmetric,
        "assembled": system.assembled,
    }
    begin, code, note = time.perf_counter(), DONE, ""
    trajectory: Trajectory
    try:
        trajectory = integrate(
            system,
            scene.x0,
            scene.v0,
            scene.case.times,
            method=options.method,
            rtol=rtol,
            atol=atol,
            step=options.step,
            bodies=scene.bodies0,
            **({"progress": _told_now_and_then()} if options.progress else {}),
        )
    except Pierced as pierced:
        trajectory, code = pierced.trajectory, DIVERGED
        note = f"{pierced}. {_harder(system, options)}"
    except Diverged as diverged:
        i, j = system.net.element_nodes[diverged.element] if diverged.element >= 0 else (-1, -1)
        trajectory, code = diverged.trajectory, DIVERGED
        note = f"{diverged}, nodes {i} and {j}. {_advice(system, options)}"
    except Interrupted as interrupted:
        trajectory, code, note = interrupted.trajectory, INTERRUPTED, "interrupted."
    provenance["wall_s"] = time.perf_counter() - begin
    try:
        save(options.output, contents(system, trajectory, code == DONE, provenance))
    except OSError as error:
        raise Refused([f"{options.output}: {error.strerror or error}"]) from error
    if note:
        _say(f"{note} {options.output} holds the {len(trajectory.t)} states up to t = {trajectory.t[-1]:g} s")
    return code


def _told_now_and_then() -> Progress:
    """Prints the time at most five times a second."""
    told = time.monotonic()

    def tell(reached: float, end: float) -> None:
        nonlocal told
        if time.monotonic() - told > 0.2 or reached == end:
            told = time.monotonic()
            sys.stdout.write(f"{reached:.17g}\n")
            sys.stdout.flush()

    return tell


def _places(path: Path) -> tuple[Floats, Floats]:
    try:
        with np.load(path) as file:
            return file["reference_position"], file["place"]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise Refused([f"{path}: no archive of reference_position and place: {error}"]) from error


def _check(options: argparse.Namespace) -> None:
    """Refuses contradicting options, and an output that cannot be written, before any work is done."""
    faults = []
    stepped = options.method in STEPPED
    if stepped != (options.step is not None):
        faults.append(f"--step goes with --method {', '.join(STEPPED)}, and these need it")
    if stepped and (options.rtol or options.atol):
        faults.append(f"--rtol and --atol mean nothing to --method {options.method}")
    parent = options.output.parent
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        faults.append(f"{options.output}: no directory {parent} to write to")
    elif options.output.is_dir():
        faults.append(f"{options.output}: is a directory")
    if faults:
        raise Refused(faults)


def _advice(system: System, options: argparse.Namespace) -> str:
    """What to do about a divergence."""
    if options.method == "EM":
        return f"Try --step {options.step / 10.0:.2g}."
    if options.method in STEPPED:
        return f"Try --step {1.0 / max(greatest_frequency(system), 1e-300):.2g} or less."
    return "Try smaller --rtol and --atol, and look for a light node or a stiff element there."


def _harder(system: System, options: argparse.Namespace) -> str:
    """What to do about contact that is too soft."""
    contact = system.effects.contact
    assert contact is not None
    keys = ("modulus",) if contact.law == "hertz" else ("stiffness", "node_stiffness", "bullet_stiffness")
    given = [f"effects.contact.{key}" for key in keys if getattr(contact, key) is not None]
    shorter = f", or --step {options.step / 10.0:.2g}" if options.method in STEPPED else ""
    return f"Try a greater {' and '.join(given)}, or a larger edge_radius of that body{shorter}."


if __name__ == "__main__":
    sys.exit(main())
