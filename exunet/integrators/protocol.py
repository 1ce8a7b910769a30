"""Protocol of a stepper, which takes a system through time and knows no observer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from exunet.base.arrays import Floats
from exunet.bodies.port import Piece
from exunet.forces.terms import Change, DiscreteStates, Seen
from exunet.model.states import States
from exunet.model.system import State

Arrays = Mapping[str, NDArray[Any]]


class Extremes(NamedTuple):
    """The largest and least values of steps, for steppers that do not return each.

    energies    : (2,) largest elastic and least kinetic energy [J] of the steps of a call
    largest     : (n_groups, 3) the largest tension [N] of each group of elements (`Net.spans`), when [s], and
                  in which element (-1: none pulled), of earlier steps too
    of_elements : (n_elements,) the largest tension of each element [N], likewise; empty unless requested
    """

    energies: Floats
    largest: Floats
    of_elements: Floats


class Steps(NamedTuple):
    """Accepted steps of a call of `Stepper.step`; the next call may overwrite the arrays.

    states   : at the ends of the steps that are returned
    extremes : of all steps; None: all are returned
    watched  : what conditions look at of every step; None: `until_true` was called at the end of each
    """

    states: States
    extremes: Extremes | None = None
    watched: Seen | None = None


@dataclass
class StepCounts:
    """Costs of an integration: accepted and rejected steps, Newton iterations, right-hand sides."""

    steps: int = 0
    rejected: int = 0
    newton_iterations: int = 0
    right_hand_sides: int = 0

    def __add__(self, other: StepCounts) -> StepCounts:
        mine, others = asdict(self), asdict(other)
        return StepCounts(**{name: count + others[name] for name, count in mine.items()})


class IntegrationFailed(Exception):
    """The stepper gave up; its own words.

    steps : those accepted before, of the same call
    """

    def __init__(self, words: str, steps: Steps | None = None) -> None:
        super().__init__(words)
        self.steps = steps


class StepsCollapsed(IntegrationFailed):
    """No step is small enough for the tolerance; a tighter one cannot help."""


class Stepper(Protocol):
    """Takes a system through time. Made at a state, ready to continue from it."""

    @property
    def time(self) -> float:
        """Time reached [s]."""

    @property
    def counts(self) -> StepCounts: ...

    @property
    def can_restart(self) -> bool:
        """True if a run from saved arrays repeats to the last bit what followed when they were saved."""

    @property
    def items(self) -> dict[str, int]:
        """Items of the engine by kind; none for the compiled loop."""

    @property
    def discrete(self) -> dict[str, Floats]:
        """All discrete states at the time reached; the next step may change the arrays."""

    @property
    def kept(self) -> dict[str, Floats]:
        """Copies of the discrete states that steps change."""

    def flat(self) -> tuple[Floats, Floats]:
        """The state reached as x and v, see `exunet.forces.blocks`."""

    def step(
        self, times: Sequence[float], most: int | None = None, until_true: Callable[[], bool] | None = None
    ) -> Steps:
        """Integrate to the last of the times [s] exactly, or end early at the end of a step.

        Parameters
        ----------
        times : sequence of float
            One time, or several for a compiled stepper that returns the states at these alone.
        most : int, optional
            Number of steps, where conditions are watched, or one without a condition. A limit for the
            compiled loop alone, which may return earlier.
        until_true : callable, optional
            Test at the end of each accepted step, where the step ends the call; the compiled loop knows by
            its kernel.

        Raises
        ------
        IntegrationFailed
            With the steps before.
        KeyboardInterrupt
            On Ctrl-C.
        """

    def change(self, change: Change, discrete: DiscreteStates) -> None:
        """Let an event act: its state, and all discrete states after it."""

    def state(self) -> State:
        """The state reached, as copies."""

    def view(self) -> State:
        """The state reached; its arrays may be those that the next step changes."""

    def set_external_force(self, force: Floats) -> None:
        """Set external forces (n_points, 3) [N] on the points, constant from now on."""

    def set_inputs(self, inputs: Arrays) -> None:
        """Set values (m,) of inputs by name, from now on."""

    def steer(self, port: str, piece: Piece) -> None:
        """Let a port go along a piece, which begins where it is at the time reached.

        Raises InputError if the stepper has no ports, or none of this name.
        """

    def steered(self, port: str) -> Piece:
        """The last piece that a port was given; raises InputError as `steer`."""

    def save(self) -> dict[str, NDArray[Any]]:
        """All that the next step depends on, as copies."""

    def load(self, arrays: Arrays, rejected: int | None = None) -> None:
        """Go back to what `save` gave in the same scene and plan; what follows is bitwise the same.

        rejected : number of rejected steps from now on, where the last step is taken back to repeat it
        """
