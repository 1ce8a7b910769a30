"""What every integrator offers and reports; its user need not know which one it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.bodies.port import Piece
from exunet.forces.terms import Change
from exunet.model.states import States
from exunet.model.system import Moving, State

Arrays = Mapping[str, NDArray[Any]]


class Largest(NamedTuple):
    """A largest tension so far [N], when [s], in which element (-1: none pulled)."""

    tension: float
    time: float
    element: int


class Extremes(NamedTuple):
    """The largest and least values of all steps of one `advance`, for integrators that do not hand over each.

    elastic, kinetic : largest elastic and least kinetic energy [J]
    largest          : the largest tension of each group of elements (`Net.spans`)
    of_elements      : (n_elements,) of each element [N], of steps before too; for observers that ask for it
    """

    elastic: float
    kinetic: float
    largest: tuple[Largest, ...]
    of_elements: Floats


class Observer(Protocol):
    """Who looks at a run; an exception that it raises comes out of `Integrator.advance` unchanged.

    asks_for_elements : it wants to know the largest tension of each element
    """

    asks_for_elements: bool

    def take(self, states: States) -> None:
        """States of accepted steps, later than `advance` has gone there but before the end of the run.

        The first is the last of those before.
        """

    def between(self, until: float, extremes: Extremes) -> None:
        """What the steps to `until` [s] reached between the states of batches."""

    def changed(self, time: float, memory: str, change: Change) -> None:
        """An event has changed a memory; no batch has states from before and after it."""

    def ends(self, time: float) -> None:
        """An event ends the run at a time [s], whose state is to be stored."""

    def remembered(self, time: float, memory: Arrays) -> None:
        """The memories (copies) that steps change themselves, at the end [s] of an `advance`.

        Raises RunStopped where they say that something went wrong; the integrator then hands over the states
        that it has, before it lets that pass.
        """


@dataclass
class StepCounts:
    """What an integration cost: accepted and rejected steps, Newton iterations, right-hand sides."""

    steps: int = 0
    rejected: int = 0
    newton_iterations: int = 0
    right_hand_sides: int = 0

    def __add__(self, other: StepCounts) -> StepCounts:
        mine, others = asdict(self), asdict(other)
        return StepCounts(**{name: count + others[name] for name, count in mine.items()})


class IntegrationFailed(Exception):
    """The integrator gave up; its own words."""


class StepsCollapsed(IntegrationFailed):
    """No step is small enough for the tolerance; a tighter one cannot help."""


class Integrator(Protocol):
    """Advances a system in time. Made at a state, ready to continue from it."""

    @property
    def time(self) -> float:
        """Time reached [s]."""

    @property
    def counts(self) -> StepCounts: ...

    @property
    def can_restart(self) -> bool:
        """True if a run from a snapshot repeats to the last bit what followed when it was taken."""

    @property
    def items(self) -> dict[str, int]:
        """Items of the engine by kind; none for the compiled loop."""

    @property
    def stopped(self) -> bool:
        """True once an event has ended the run, at the time reached."""

    def advance(self, until: float) -> None:
        """Integrate to `until` [s] exactly; events on the way change the memory, and one may end the run.

        Raises IntegrationFailed, what the observer raises, or KeyboardInterrupt on Ctrl-C.
        """

    def flush(self) -> None:
        """Let the observer see the states that it has not seen."""

    def state(self) -> State:
        """The state reached, as copies."""

    def push(self, force: Floats) -> None:
        """Forces (n_points, 3) [N] from outside on the points, constant from now on."""

    def set_inputs(self, inputs: Arrays) -> None:
        """Values (m,) of inputs by name, from now on."""

    def steer(self, port: str, piece: Piece) -> None:
        """Let a port go along a piece, which begins where it is at the time reached.

        Raises InputError if the integrator has no ports, or none of this name.
        """

    def steered(self, port: str) -> Piece:
        """The last piece that a port was given; raises InputError as `steer`."""

    def view(self) -> State:
        """The state reached; its arrays may be those that the next step changes."""

    def moving(self) -> Moving:
        """As `view`, without time and memories."""

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """All that the next step depends on, as copies, and the states that are not flushed yet."""

    def restore(self, arrays: Arrays) -> None:
        """Go back to a snapshot of the same scene and plan; what follows is bitwise the same."""
