"""`[capture]` of a case: when the target counts as captured."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Count, NonNegative, Positive, Record, Vector
from exunet.bodies.config import Bodies

CONDITIONS = ("enclosed", "relative_speed", "relative_spin", "cqi", "mcqi", "mouth", "touching")
Part = Annotated[float, Field(gt=0, le=1)]


class Capture(Record):
    """Criterion of a capture: all given conditions, of which there is at least one, hold until the end."""

    TABLE: ClassVar = "capture"
    target: str = Field(description="name of the body to capture, with a shape", examples=["target"])
    duration: NonNegative = Field(
        description="time for which all conditions hold, until the end [s]", examples=[0.5]
    )
    enclosed: Part | None = Field(
        None,
        description="condition: minimum part of the target's volume in the convex hull of the net",
        examples=[0.9],
    )
    relative_speed: Positive | None = Field(
        None,
        description="condition: maximum relative speed of the centres of mass of net and target [m/s]",
        examples=[0.05],
    )
    relative_spin: Positive | None = Field(
        None,
        description="condition: maximum difference of the angular velocities of net and target [rad/s]",
        examples=[0.1],
    )
    cqi: Positive | None = Field(None, description="condition: maximum capture quality index", examples=[0.5])
    mcqi: Positive | None = Field(
        None, description="condition: maximum modified capture quality index", examples=[0.5]
    )
    mouth: Positive | None = Field(
        None,
        description="condition: maximum diameter of the mouth, over all nodes of its rim [m]",
        examples=[0.5],
    )
    touching: Count | None = Field(
        None,
        description="condition: minimum number of elements, or nodes, in contact with the target",
        examples=[10],
    )
    length: Positive | None = Field(
        None,
        description="length L of the target in both indices [m]; default: its longest diagonal",
        examples=[2.0],
    )
    cqi_weights: Vector = Field(
        (0.1, 0.1, 0.8),
        description="weights of volume, surface and offset in the capture quality index, not all 0",
    )
    mcqi_weights: Vector = Field(
        (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0),
        description="weights of the part not enclosed, the distance and the open mouth in the "
        "modified index, not "
        "all 0",
    )

    def faults(self) -> Iterator[Fault]:
        """Require a condition, and weights that are not negative."""
        if not any(self.is_given(name) for name in CONDITIONS):
            yield Fault("", f"requires at least one condition: {', '.join(CONDITIONS)}")
        for name in ("cqi_weights", "mcqi_weights"):
            weights = getattr(self, name)
            if min(weights) < 0.0 or sum(weights) == 0.0:
                yield Fault(name, f"must not be negative, nor all 0, got {list(weights)}")


def cross_checks(
    criterion: Capture, bodies: Bodies, touched: frozenset[str], *, has_mouth: bool
) -> Iterator[Fault]:
    """touched : the bodies that threads or nodes of the scene touch; has_mouth : of the net's topology."""
    body = bodies.get(criterion.target)
    if body is None:
        known = ", ".join(bodies) or "none"
        yield Fault("target", f"unknown body {criterion.target!r} (bodies of the case: {known})")
    elif body.shape is None and not body.parts:
        yield Fault("target", f"body {criterion.target!r} does not have a shape that a net could enclose")
    if criterion.touching is not None and criterion.target not in touched:
        words = "is not among the bodies that threads or nodes touch in effects.contact"
        yield Fault("touching", f"{criterion.target!r} {words}")
    if criterion.mouth is not None and not has_mouth:
        yield Fault("mouth", "the net does not have a mouth: give net.corners")
