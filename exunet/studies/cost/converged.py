"""A converged solution that proves itself: two methods, each at two tolerances, and a moved start."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import reference_impl as reference
from exunet.base.errors import Interrupted, RunStopped
from exunet.results.measures import Deployment, deployment_of
from exunet.studies.cost.measure import launch_speed, shown_nodes
from exunet.studies.cost.runners import Subject, trajectory
from exunet.studies.cost.settings import Setting

Floats = NDArray[np.float64]

OWN = (1e-10, 1e-11)  # tolerances of DOPRI5, relative to the launch speed; below, round-off takes over
THEIRS = (1e-11, 1e-12)  # rtol of the reference's DOP853
INSTANTS = 100  # stored times, at which the horizon is looked for and beyond which deployment is measured
PUSH = 1e-12  # [m], of each coordinate of the moved start
SEED = 20210616
VISIBLE = 1e-2  # a solution less certain than this predicts no speed


@dataclass(frozen=True)
class Converged:
    """The solution that all others are measured against; errors are relative to the launch speed.

    speeds      : (k,) speeds at the end [m/s]
    uncertainty : largest difference of a speed at the end between any two of the solutions
    sensitivity : the change of a speed at the end when every coordinate of the start moves by up to PUSH
    horizon     : [s] the solutions differ by more than VISIBLE from here on; None: not before the end
    words       : how it was computed, with the differences
    deployments : measures of all the solutions, that of the moved start last; empty without a mouth
    seconds     : wall time that it took [s]
    """

    speeds: Floats
    uncertainty: float
    sensitivity: float
    horizon: float | None
    words: tuple[str, ...]
    deployments: tuple[Deployment, ...] = ()
    seconds: float = 0.0

    @property
    def predicts(self) -> bool:
        """False beyond the horizon of predictability."""
        return self.uncertainty <= VISIBLE


def converge(subject: Subject, *, compiled: bool) -> Converged:
    """The solution at the subject's end; raises RunStopped if not even a tight tolerance reaches it."""
    began = clock.perf_counter()
    times = tuple(np.linspace(0.0, subject.end, INSTANTS + 1).tolist())
    fine = subject.at(times)
    own = [Setting("compiled loop" if compiled else "connectors", "DOPRI5", tolerance=t) for t in OWN]
    settings = list(own)
    if subject.pair is not None:
        settings += [Setting("reference", "DOP853", tolerance=t) for t in THEIRS]
    elif compiled:
        settings += [Setting("connectors", "DOPRI5", tolerance=OWN[-1])]
    found = [_solution(fine, setting) for setting in settings]
    speeds = np.array([one for one, _ in found])  # (settings, t, k)
    spread = np.ptp(speeds, axis=0).max(axis=-1) / launch_speed(subject.start)  # (t,)
    random = np.random.default_rng(SEED)
    push = random.uniform(-PUSH, PUSH, subject.start.position.shape)
    push[subject.start.net.fixed_nodes] = 0.0
    moved, its_deployment = _solution(replace(fine, moved=push), own[-1])
    sensitivity = float(np.abs(moved[-1] - speeds[len(own) - 1, -1]).max()) / launch_speed(subject.start)
    # The last agreement before the differences stay: single passes are instants inside a snap.
    within = np.flatnonzero(spread <= VISIBLE)
    beyond = int(within[-1]) + 1
    horizon = times[beyond] if beyond < len(times) else None
    words = _words(settings, speeds[:, -1], launch_speed(subject.start), float(spread[-1]), sensitivity)
    deployments = tuple(one for one in (*(one for _, one in found), its_deployment) if one is not None)
    return Converged(
        speeds[len(own) - 1, -1], float(spread[-1]), sensitivity, horizon, words, deployments,
        clock.perf_counter() - began,
    )  # fmt: skip


def _solution(subject: Subject, setting: Setting) -> tuple[Floats, Deployment | None]:
    """(t, k) speeds [m/s] at the stored times, measures of deployment."""
    try:
        position, velocity = trajectory(subject, setting)
    except reference.Interrupted:
        raise KeyboardInterrupt from None
    except Interrupted:
        raise KeyboardInterrupt from None
    except reference.Diverged as error:
        raise RunStopped(f"no converged solution: the reference {error}") from error
    speeds = np.asarray(np.linalg.norm(velocity[:, shown_nodes(subject.start)], axis=-1))
    return speeds, deployment_of(subject.start.net, np.array(subject.times), position)


def _words(
    settings: list[Setting], speeds: Floats, scale: float, spread: float, sensitivity: float
) -> tuple[str, ...]:
    rows = []
    for k in range(0, len(settings) - 1, 2):
        gap = float(np.abs(speeds[k] - speeds[k + 1]).max()) / scale
        pair = settings[k : k + 2]
        rows.append(f"{pair[0].name}, {pair[0].value} and {pair[1].value}: speeds differ by {gap:.1e}")
    if len({setting.code for setting in settings}) > 1:
        rows.append(f"both codes: speeds differ by {spread:.1e} at most")
    else:
        rows.append("the reference does not know this scene: one code only")
    rows.append(f"start moved by {PUSH:.0e} m: speeds change by {sensitivity:.1e}")
    return tuple(rows)
