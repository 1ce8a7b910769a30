"""The keys of [solver], which choose an integration method.

Apart from the methods, whose names the command needs before any library is imported.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive, Record
from exunet.methods.method import METHODS, Kind, Method

AUTO: Literal["auto"] = "auto"
SHORTEST_STEP = 1e-12  # [s]
# Error of the bullets' velocities that a named adaptive method aims at, if the case has none.
ACCURACY = 1e-2


if TYPE_CHECKING:
    MethodKey = Method | Literal["auto"]
else:  # made from the enum, which a type checker cannot follow
    MethodKey = Literal[(AUTO, *Method)]


def takes_tolerance(method: Method | Literal["auto"]) -> bool:
    """True for methods that choose their own steps, and for "auto", which chooses such a method."""
    return method == AUTO or METHODS[Method(method)].kind == Kind.ADAPTIVE


class Solver(Record):
    """Integration method and accuracy of exunet. The reference ignores this table."""

    TABLE: ClassVar = "solver"
    method: MethodKey = Field(
        AUTO,
        description="integration method; auto: DOPRI5 for a given accuracy or tolerance, else VelocityVerlet "
        "with a step for metrics",
    )
    accuracy: Positive | None = Field(
        None,
        le=1.0,
        description="error of the bullets' velocities before the horizon of predictability that is aimed at, "
        "relative to the launch speed; sets an adaptive tolerance; absent: auto integrates for metrics",
        examples=[1e-2],
    )
    tolerance: Positive | None = Field(
        None,
        description="absolute tolerance of an adaptive method [m, m/s]; absent: from accuracy",
        examples=[1e-6],
    )
    step: Annotated[float, Field(ge=SHORTEST_STEP)] | None = Field(
        None,
        description="step of a fixed-step method [s]; absent: from the stable step",
        examples=[1e-5],
    )
    force: bool = Field(
        False, description="run even with a step above the stable one, which is refused otherwise"
    )
    retry: int = Field(
        2,
        ge=0,
        le=20,
        description="how often a run that fails because of its steps continues from its last good state with "
        "finer ones",
    )

    @property
    def for_metrics(self) -> bool:
        """True if the case requests neither a method nor an accuracy."""
        return self.method == AUTO and self.accuracy is None and self.tolerance is None

    def faults(self) -> Iterator[Fault]:
        """Require accuracy, tolerance or step as the method takes it."""
        method = self.method
        if self.tolerance is not None and not takes_tolerance(method):
            yield Fault("tolerance", f"{method} has a fixed step: give step instead of tolerance")
        if self.step is not None:
            if method == AUTO:
                yield Fault("step", "auto chooses its own step: name the fixed-step method that it is for")
            elif takes_tolerance(method):
                yield Fault("step", f"{method} chooses its own step: give accuracy or tolerance instead")
        elif not takes_tolerance(method) and METHODS[Method(method)].needs_step:
            yield Fault("step", f"{method} does not have a stable step of its own: give step")
