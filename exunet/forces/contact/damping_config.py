"""Keys of the damping of a contact: given, or by the restitution at an impact speed."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import NonNegative, Positive, Record
from exunet.forces.contact.law import LEAST_RESTITUTION, damping_of


class ImpactDampingConfig(Record):
    """Hunt and Crossley's damping."""

    restitution: float | None = Field(
        None,
        ge=LEAST_RESTITUTION,
        le=1.0,
        description="e, speed after over speed before an impact at impact_speed [-]",
        examples=[0.5],
    )
    impact_speed: Positive | None = Field(None, description="v0 [m/s]; for restitution", examples=[1.0])
    damping: NonNegative | None = Field(
        None, description="a in F(p)(1 + a p') [s/m]; instead of restitution", examples=[0.5]
    )

    @property
    def a(self) -> float:
        """Of Hunt and Crossley's law [s/m]."""
        if self.damping is not None:
            return self.damping
        assert self.restitution is not None
        assert self.impact_speed is not None
        return damping_of(self.restitution, self.impact_speed)

    def faults(self) -> Iterator[Fault]:
        """Require damping, or restitution at an impact speed."""
        bounces = self.restitution is not None, self.impact_speed is not None
        if (self.damping is not None) == any(bounces):
            yield Fault("", "requires either restitution with impact_speed, or damping")
        elif any(bounces) and not all(bounces):
            yield Fault("", "requires restitution and impact_speed together")
