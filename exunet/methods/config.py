"""The keys of [solver], which choose an integration method."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive, Record
from exunet.methods.method import METHODS, Kind, Method

AUTO: Literal["auto"] = "auto"
SHORTEST_STEP = 1e-12  # [s]
# Methods whose settings for accuracy_of = "measures" were measured (benchmarks/measures.md).
FOR_MEASURES = (Method.VELOCITY_VERLET, Method.DOPRI5)

if TYPE_CHECKING:
    MethodKey = Method | Literal["auto"]
else:  # made from the enum, which a type checker cannot follow
    MethodKey = Literal[(AUTO, *Method)]


def takes_tolerance(method: Method | Literal["auto"]) -> bool:
    """True for methods that choose their own steps, and for "auto", which chooses such a method."""
    return method == AUTO or METHODS[Method(method)].kind == Kind.ADAPTIVE


class Solver(Record):
    """Integration method and accuracy of exunet. The reference ignores this table."""

    method: MethodKey = Field(
        AUTO, description="integration method; auto: the one that was measured as cheapest at the accuracy"
    )
    accuracy: Positive = Field(
        1e-4,
        le=1.0,
        description="error of the bullets' speeds aimed at, relative to the launch speed; sets an adaptive "
        "tolerance; single nodes may be off by far more in a snap",
    )
    accuracy_of: Literal["trajectory", "measures"] = Field(
        "trajectory",
        description="what is to be accurate: the trajectory, of the bullets, to `accuracy`; or the measures "
        "of deployment only, whose medians are shifted by less than a third of their spread, at less cost",
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

    def faults(self) -> Iterator[Fault]:
        """Require tolerance or step as the method takes it; measures leave no setting open."""
        method = self.method
        if self.accuracy_of == "measures":
            yield from self._faults_of_measures()
            return
        if self.tolerance is not None and not takes_tolerance(method):
            yield Fault("tolerance", f"{method} has a fixed step: give step instead of tolerance")
        if self.step is not None:
            if method == AUTO:
                yield Fault("step", "auto chooses its own step: name the fixed-step method that it is for")
            elif takes_tolerance(method):
                yield Fault("step", f"{method} chooses its own step: give accuracy or tolerance instead")
        elif not takes_tolerance(method) and METHODS[Method(method)].needs_step:
            yield Fault("step", f"{method} does not have a stable step of its own: give step")

    def _faults_of_measures(self) -> Iterator[Fault]:
        if self.method != AUTO and self.method not in FOR_MEASURES:
            able = ", ".join((AUTO, *FOR_MEASURES))
            yield Fault("accuracy_of", f"no setting of {self.method} was measured for measures: use {able}")
        for name in ("accuracy", "tolerance", "step"):
            if self.is_given(name):
                words = 'accuracy_of = "measures" excludes this key: remove it, or use "trajectory"'
                yield Fault(name, words)
