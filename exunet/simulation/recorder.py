"""What a run leaves behind: stored states, what they cost, and the Result that is made of them."""

from __future__ import annotations

import platform
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import exunet
from exunet.backends.exudyn.loading import exudyn_version
from exunet.backends.exudyn.stepper import Stepper
from exunet.case.stored_times import stored_times
from exunet.forces import cable
from exunet.forces.effects import switched_on
from exunet.methods.plan import Plan
from exunet.results.result import Result
from exunet.simulation.breaking import Breaks
from exunet.simulation.envelope import Envelope
from exunet.simulation.guards import off_by
from exunet.simulation.peaks import Peaks
from exunet.simulation.preparation import Start
from exunet.system import energy
from exunet.system.energy_scale import InPlay

if TYPE_CHECKING:
    from exunet.backends.compiled.loop import Loop

Floats = NDArray[np.float64]

# A state is good to go on from while its energy balance is within this part of the guard's bound: what the
# steps that went wrong have done to it is then a tenth of what may be wrong with a result.
GOOD_PART = 0.1
_COUNTS = ("steps", "rejected_steps", "right_hand_sides", "newton_iterations", "integration_seconds")


class Recorder:
    """Gathers the stored states and what the run cost, over all its attempts."""

    def __init__(self, start: Start, provenance: dict[str, Any]) -> None:
        self._start = start
        self._provenance = provenance | {
            "title": start.scene.title,
            "versions": _versions(),
            "platform": platform.platform(),
            "method": start.plan.method,
            "tolerance": start.plan.tolerance,
            "step": start.plan.step,
            "end": start.scene.time.end,
            "notes": list(start.plan.notes),
            "engine": start.scene.engine.model_dump(),
            "effects": sorted(switched_on(start.scene.effects)),
            "retries": [],
            "build_seconds": 0.0,
            **dict.fromkeys(_COUNTS, 0),
        }
        self._time: list[float] = []
        self._states: list[tuple[Floats, Floats]] = []
        self._dissipated: list[float] = []
        self.breaks: Breaks | None = None
        self.peaks = Peaks()
        self._in_play = InPlay(start.net, start.terms, start.position, start.velocity)
        self.envelope = Envelope(stored_times(start.scene.time))

    def __len__(self) -> int:
        return len(self._time)

    def built(self, items: dict[str, int], seconds: float) -> None:
        """Items that the engine holds, and the time it took to make them [s]."""
        self._provenance["items"] = items
        self._provenance["build_seconds"] += seconds

    def store(self, time: float, state: tuple[Floats, Floats], dissipated: float | None) -> None:
        """Keep the position [m] and velocity [m/s] (n_nodes, 3) of a stored time [s].

        dissipated : energy [J] taken out until then; None: `book` tells it later
        """
        self._time.append(time)
        self._states.append(state)
        if dissipated is not None:
            self._dissipated.append(dissipated)

    def book(self, time: Floats, dissipated: Floats) -> None:
        """Take the energy (k,) [J] taken out until times (k,) [s], those of stored states among them."""
        while len(self._dissipated) < len(self._time):
            row = int(np.searchsorted(time, self._time[len(self._dissipated)]))
            if row == len(time):
                break
            self._dissipated.append(float(dissipated[row]))

    def last(self) -> tuple[float, Floats, Floats, float]:
        """Time, position, velocity and dissipated energy of the last stored state."""
        return self._time[-1], *self._states[-1], self._dissipated[-1]

    def forget_after(self, time: float) -> None:
        """Drop the states after `time` [s]: guards look at batches, which may end after a stored state."""
        self._keep(self._until(time))

    def forget_off(self, part: float = 1.0) -> None:
        """Drop the first state whose energy balance is off by that part of the bound, and all after it."""
        late = np.flatnonzero(self.off_by(self.result("going back")) > part)
        self._keep(max(1, int(late[0]))) if len(late) else None

    def off_by(self, states: Result) -> Floats:
        """(n_times,) see `guards.off_by`; states as `result` gives them."""
        total = states.kinetic + states.elastic + states.potential + states.dissipated
        return off_by(total, states.provenance["energy_in_play_J"])

    def _until(self, time: float) -> int:
        return sum(stored <= time for stored in self._time)

    def _keep(self, number: int) -> None:
        del self._time[number:], self._states[number:], self._dissipated[number:]

    def integrated(self, stepper: Stepper | Loop, seconds: float) -> None:
        """Add what an attempt cost."""
        cost = (
            stepper.counts.steps,
            stepper.counts.rejected,
            stepper.right_hand_sides,
            stepper.counts.newton_iterations,
            seconds,
        )
        for name, value in zip(_COUNTS, cost, strict=True):
            self._provenance[name] += value

    def note(self, words: str) -> None:
        """Tell something that the user should know."""
        self._provenance["notes"].append(words)

    def retried(self, stopped: str, plan: Plan) -> None:
        """Tell that the run was stopped, and goes on from the last stored state with a finer plan."""
        setting = {"step": plan.step} if plan.step is not None else {"tolerance": plan.tolerance}
        self._provenance["retries"].append({"stopped": stopped, "from_time": self._time[-1], **setting})
        self._provenance |= setting
        ((name, value),) = setting.items()
        self._provenance["notes"].append(
            f"retried from t = {self._time[-1]:.6g} s with {name} {value:.3g}: {stopped.split(';')[0]}"
        )

    def result(self, verdict: str, until: float | None = None) -> Result:
        """The states so far, or those until a time [s]; complete if the verdict is "ok"."""
        net, terms = self._start.net, self._start.terms
        number = len(self) if until is None else self._until(until)
        position, velocity = self._arrays(number)
        length = cable.lengths(net, position)
        tension = cable.element_tension(net, terms.law(net), position, velocity, length)
        elastic = energy.elastic(net, terms, position)
        if self.breaks is not None:
            tension, elastic = self.breaks.corrected(self._time[:number], length, tension, elastic)
            self._provenance["broken"] = self.breaks.provenance()
        self._provenance["largest_tension"] = self.peaks.provenance()
        potential, dissipated = energy.potential(terms, position), np.array(self._dissipated[:number])
        gained = self._in_play.gained(position, velocity, potential, dissipated)[0]
        self._provenance["energy_in_play_J"] = self._in_play.start + float(gained.max())
        kinetic = energy.kinetic(net, velocity)
        largest_elastic, least_kinetic = self.envelope.around(elastic, kinetic)
        return Result(
            net=net,
            time=np.array(self._time[:number]),
            position=position,
            velocity=velocity,
            strain=cable.green_lagrange_strain(length, net.reference_length),
            tension=tension,
            kinetic=kinetic,
            elastic=elastic,
            potential=potential,
            dissipated=dissipated,
            momentum=energy.momentum(net, velocity),
            angular_momentum=energy.angular_momentum(net, position, velocity),
            complete=verdict == "ok",
            verdict=verdict,
            provenance=self._provenance,
            largest_elastic=largest_elastic,
            least_kinetic=least_kinetic,
        )

    def _arrays(self, number: int) -> tuple[Floats, Floats]:
        position, velocity = zip(*self._states[:number], strict=True)
        return np.array(position), np.array(velocity)


def _versions() -> dict[str, str]:
    return {
        "exunet": exunet.__version__,
        "exudyn": exudyn_version(),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
