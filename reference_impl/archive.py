"""The result file: a NumPy archive whose arrays are listed in README.md."""

from __future__ import annotations

import json
import os
import platform
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from reference_impl import energy
from reference_impl.closing import Line
from reference_impl.elements import strain, tension
from reference_impl.run import Trajectory
from reference_impl.system import System

FORMAT = 1


def contents(
    system: System, trajectory: Trajectory, complete: bool, provenance: dict[str, Any]
) -> dict[str, NDArray[Any]]:
    """The arrays of a result file; `provenance` is completed by costs and versions."""
    net, x, v = system.net, trajectory.x, trajectory.v
    facts = {
        **provenance,
        "n_rhs": trajectory.n_rhs,
        "n_steps": trajectory.n_steps,
        "n_rejected": trajectory.n_rejected,
        "n_newton": trajectory.n_newton,
        "n_halvings": trajectory.n_halvings,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    bodies, breaks, reels = trajectory.bodies, trajectory.breaks, trajectory.reels
    closing, drawn = system.closing, trajectory.drawn
    lengths = energy.lengths(system, reels, drawn)
    line = drawn.amount.shape[-1] if isinstance(closing, Line) else 0
    with np.errstate(over="ignore", invalid="ignore"):  # the last states of a diverging run may be huge
        books = energy.books(system, trajectory)
        return {
            "format": np.array(FORMAT),
            "complete": np.array(complete),
            "provenance": np.array(json.dumps(facts, default=str)),
            "t": trajectory.t,
            "position": x,
            "velocity": v,
            "reference_position": net.reference_position,
            "element_nodes": net.element_nodes,
            "reference_length": net.reference_length,
            "area": net.area,
            "youngs_modulus": net.youngs_modulus,
            "density": net.density,
            "mass": net.mass,
            "bullet_nodes": net.bullet_nodes,
            "fixed_nodes": net.fixed_nodes,
            "strain": strain(system, x, lengths),
            "tension": tension(system, x, trajectory.intact, lengths),
            "kinetic": books.kinetic,
            "elastic": books.elastic,
            "potential": books.potential,
            "dissipated": books.dissipated,
            "momentum": books.momentum,
            "angular_momentum": books.angular_momentum,
            "body_names": np.array(system.bodies.names, dtype=str),
            "body_mass": system.bodies.mass,
            "body_inertia": np.diagonal(system.bodies.inertia, axis1=1, axis2=2),
            "body_products_of_inertia": system.bodies.inertia[:, [0, 0, 1], [1, 2, 2]],
            "body_centre_of_mass": system.bodies.centre_of_mass,
            "body_position": bodies.position,
            "body_velocity": bodies.velocity,
            "body_attitude": bodies.attitude,
            "body_angular_velocity": bodies.angular_velocity,
            "body_impulse": trajectory.given.impulse,
            "body_angular_impulse": trajectory.given.angular_impulse,
            "body_work": trajectory.given.work,
            "reel_names": np.array(() if system.reels is None else system.reels.names, dtype=str),
            "reel_wound_up": reels.wound_up,
            "reel_held": reels.held.astype(np.intp),
            "reel_work": reels.work,
            "closing_wound_up": drawn.amount[:, :line],
            "closing_part": drawn.amount[:, line:],
            "closing_work": drawn.work,
            "closing_tension": np.empty((len(x), 0))
            if not isinstance(closing, Line)
            else closing.tension(x, drawn.amount, system.free_strain)[:, None],
            "intact": trajectory.intact,
            "contact_damping": trajectory.rubbing[:, 0],
            "contact_friction": trajectory.rubbing[:, 1],
            "contact_depth": energy.depth(system, trajectory),
            "break_element": np.array([b.element for b in breaks], dtype=np.intp),
            "break_time": np.array([b.time for b in breaks], dtype=float),
            "break_energy": np.array([b.energy for b in breaks], dtype=float),
        }


def save(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Writes the archive whole or not at all: to a temporary neighbour first, then renamed."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name + ".", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]  # the stub takes the names for options
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
