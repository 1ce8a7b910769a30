"""A converged solution that proves itself: two methods, each at two tolerances, and a moved start."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, replace

import numpy as np

from exunet.methods.method import Form, Method
from exunet.results.measures import Deployment, deployment_of
from exunet.studies.both_codes import Floats
from exunet.studies.cost.runners import Subject, trajectory
from exunet.studies.cost.settings import ReferenceMethod, Setting, own_form
from exunet.studies.neighbours import MOVE, nearby_start

OWN = (1e-10, 1e-11)  # tolerances of DOPRI5, relative to the launch speed; below, round-off takes over
THEIRS = (1e-11, 1e-12)  # rtol of the reference's DOP853
INSTANTS = 100  # stored times, at which the horizon is looked for and after which deployment is measured
VISIBLE = 1e-2  # a solution less certain than this predicts no speed


@dataclass(frozen=True)
class Converged:
    """The solution that all others are measured against; errors are relative to the launch speed.

    speeds      : (k,) speeds at the end [m/s], then what counts of point masses and bodies, see `tracked`
    uncertainty : largest difference of one of these between any two of the solutions
    sensitivity : the change of a speed at the end when the start is moved, see `moved`
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
        """False after the horizon of predictability."""
        return self.uncertainty <= VISIBLE


def converge(subject: Subject, *, compiled: bool) -> Converged:
    """The solution at the subject's end; raises RunStopped if not even a tight tolerance reaches it."""
    began = clock.perf_counter()
    times = tuple(np.linspace(0.0, subject.end, INSTANTS + 1).tolist())
    fine, scale = subject.at(times), subject.speed
    own = [Setting(own_form(compiled=compiled), Method.DOPRI5, tolerance=t) for t in OWN]
    others: list[Setting] = []
    if subject.both is not None:
        others = [Setting(None, ReferenceMethod.DOP853, tolerance=t) for t in THEIRS]
    elif compiled:
        others = [Setting(Form.CONNECTORS, Method.DOPRI5, tolerance=OWN[-1])]
    settings = [*own, *others]
    runs = [_solution(fine, setting) for setting in settings]
    runs.append(_solution(replace(fine, start=nearby_start(fine.start)), own[-1]))
    *found, nearby = (speeds for speeds, _ in runs)
    best, ends = found[len(own) - 1][-1], [speeds[-1] / scale for speeds in found]
    sensitivity = float(np.abs(nearby[-1] - best).max()) / scale
    spread = np.ptp(found, axis=0).max(axis=-1) / scale  # (t,)
    # The last agreement before the differences stay: single passes are instants inside a snap.
    lost = int(np.flatnonzero(spread <= VISIBLE)[-1]) + 1
    words = []
    for k in range(1, len(settings), 2):
        gap = float(np.abs(ends[k - 1] - ends[k]).max())
        words.append(f"{settings[k - 1]} and {settings[k].value}: speeds differ by {gap:.1e}")
    of = "without the reference" if subject.both is None else "both codes"
    words.append(f"{of}: speeds differ by {spread[-1]:.1e} at most")
    moved = f"{MOVE * subject.start.net.size:.0e} m"
    words.append(f"start moved by {moved}: speeds change by {sensitivity:.1e}")
    return Converged(
        best,
        uncertainty=float(spread[-1]),
        sensitivity=sensitivity,
        horizon=times[lost] if lost < len(times) else None,
        words=tuple(words),
        deployments=tuple(opening for _, opening in runs if opening is not None),
        seconds=clock.perf_counter() - began,
    )


def _solution(subject: Subject, setting: Setting) -> tuple[Floats, Deployment | None]:
    """(t, k) what counts [m/s] at the stored times, see `tracked`; measures of deployment."""
    net, found = subject.start.net, trajectory(subject, setting)
    return found.tracked, deployment_of(net, found.time, found.position)
