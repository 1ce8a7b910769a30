"""The keys of [solver], which choose an integration method, and what they demand of each other."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import ConfigDict, Field

from exunet.base.errors import Fault
from exunet.base.table import Positive, Table
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


def _methods_schema() -> dict[str, Any]:
    """What `cross_checks` demands, as a JSON schema: tolerance or step, by the method ("auto" if absent)."""

    def of(*methods: str) -> dict[str, Any]:
        return {"properties": {"method": {"enum": list(methods)}}}

    fixed = [method.value for method in METHODS if not takes_tolerance(method)]
    needing = [method.value for method, facts in METHODS.items() if facts.needs_step]
    is_fixed = of(*fixed) | {"required": ["method"]}
    measures = {"properties": {"accuracy_of": {"const": "measures"}}, "required": ["accuracy_of"]}
    only = of(AUTO, *FOR_MEASURES)["properties"]
    return {
        "allOf": [
            {
                "if": measures,
                "then": {"properties": only | dict.fromkeys(("accuracy", "tolerance", "step"), False)},
            },
            {
                "if": is_fixed,
                "then": {"properties": {"tolerance": False}},
                "else": {"properties": {"step": False}},
            },
            {"if": of(*needing) | {"required": ["method"]}, "then": {"required": ["step"]}},
        ]
    }


class Solver(Table):
    """Keys of [solver]."""

    model_config = ConfigDict(json_schema_extra=_methods_schema())

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


def cross_checks(keys: Solver) -> Iterator[Fault]:
    """Tolerance and step go with the method; for measures the setting follows from the method alone."""
    method = keys.method
    if keys.accuracy_of == "measures":
        yield from _measures_checks(keys)
        return
    if keys.is_given("tolerance") and not takes_tolerance(method):
        yield Fault("tolerance", f"{method} has a fixed step: give step instead of tolerance")
    if keys.is_given("step"):
        if method == AUTO:
            yield Fault("step", "auto chooses its own step: name the fixed-step method that it is for")
        elif takes_tolerance(method):
            yield Fault("step", f"{method} chooses its own step: give accuracy or tolerance instead")
    elif not takes_tolerance(method) and METHODS[Method(method)].needs_step:
        yield Fault("step", f"{method} has no stable step of its own: give step")


def _measures_checks(keys: Solver) -> Iterator[Fault]:
    """accuracy_of = "measures" leaves no setting open."""
    method = keys.method
    if method != AUTO and method not in FOR_MEASURES:
        able = ", ".join((AUTO, *FOR_MEASURES))
        yield Fault("accuracy_of", f"no setting of {method} was measured for measures: take {able}")
    reasons = {
        "accuracy": "is that of the trajectory",
        "tolerance": 'follows from accuracy_of = "measures"',
        "step": 'follows from accuracy_of = "measures"',
    }
    for name, why in reasons.items():
        if keys.is_given(name):
            yield Fault(name, f'{why}: leave it out, or take accuracy_of = "trajectory"')
