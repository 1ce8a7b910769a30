"""`[verdict]` of a case: when the target counts as captured."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import ConfigDict, Field

from exunet.base.errors import Fault
from exunet.base.table import Count, NonNegative, Positive, Table, Vector
from exunet.bodies.keys import Bodies

CONDITIONS = ("enclosed", "relative_speed", "relative_spin", "cqi", "mcqi", "mouth", "touching")
Part = Annotated[float, Field(gt=0, le=1)]


class Verdict(Table):
    """The rule of a capture: all conditions that are given hold for some time, until the end."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": [name]} for name in CONDITIONS]})

    target: str = Field(description="name of the body that is to be captured", examples=["chaser"])
    duration: NonNegative = Field(
        description="for how long the conditions hold, until the end [s]", examples=[0.5]
    )
    enclosed: Part | None = Field(
        None, description="least part of the target's volume in the convex hull of the net", examples=[0.9]
    )
    relative_speed: Positive | None = Field(
        None, description="largest, of the centres of mass of net and target [m/s]", examples=[0.05]
    )
    relative_spin: Positive | None = Field(
        None, description="largest difference of the angular velocities of net and target [rad/s]"
    )
    cqi: Positive | None = Field(None, description="largest capture quality index")
    mcqi: Positive | None = Field(None, description="largest modified capture quality index")
    mouth: Positive | None = Field(
        None, description="largest diameter of the net's mouth, of all nodes of its rim [m]"
    )
    touching: Count | None = Field(
        None, description="least number of elements, or nodes, that touch the target"
    )
    length: Positive | None = Field(
        None, description="of the target, in the two indices [m]; default: of its longest diagonal"
    )
    cqi_weights: Vector = Field(
        (0.1, 0.1, 0.8), description="of volume, surface and offset in the capture quality index"
    )
    mcqi_weights: Vector = Field(
        (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0),
        description="of the part not enclosed, the distance and the open mouth in the modified index",
    )


def cross_checks(
    verdict: Verdict | None, bodies: Bodies, touched: frozenset[str], *, has_mouth: bool
) -> Iterator[Fault]:
    """touched : the bodies that threads or nodes of the scene touch; has_mouth : of the net's topology."""
    if verdict is None:
        return
    body = bodies.get(verdict.target)
    if verdict.target not in bodies:
        known = ", ".join(bodies) or "none"
        yield Fault("verdict.target", f"there is no body {verdict.target!r} (bodies of the case: {known})")
    elif body is not None and body.shape is None and not body.parts:
        yield Fault("verdict.target", f"body {verdict.target!r} has no shape, so nothing can enclose it")
    if not any(verdict.is_given(name) for name in CONDITIONS):
        yield Fault("verdict", f"needs at least one condition: {', '.join(CONDITIONS)}")
    if verdict.is_given("touching") and verdict.target not in touched:
        words = (
            f"effects.contact does not name {verdict.target!r} among the bodies that threads or nodes touch"
        )
        yield Fault("verdict.touching", words)
    if verdict.is_given("mouth") and not has_mouth:
        yield Fault("verdict.mouth", "a net of listed elements has no mouth that could be narrow")
    for name in ("cqi_weights", "mcqi_weights"):
        weights = getattr(verdict, name)
        if min(weights) < 0.0 or sum(weights) == 0.0:
            yield Fault(f"verdict.{name}", f"must not be negative, nor all 0, got {list(weights)}")
