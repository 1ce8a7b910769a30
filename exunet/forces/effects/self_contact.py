"""Contact of the threads of a net with each other, without friction.

Penalty, integrated over where threads touch, with Hunt and Crossley's damping; see
`exunet.forces.contact.segment_segment`, and for the equations docs/explanation/theory_contact.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive
from exunet.forces.blocks import Blocks, FirstOrder
from exunet.forces.contact.law import ImpactDampingConfig
from exunet.forces.contact.self_contact import NAME, threads_together
from exunet.forces.effect import Effect, RestOfCase
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.terms import KernelTerm
from exunet.net.arrays import Floats, Net


class SelfContact(Effect, ImpactDampingConfig):
    """Threads of the net touch each other."""

    EXCLUDES: ClassVar = {"breaking": "the line between the ends of a broken element would still touch"}
    INTERNAL: ClassVar = True
    COLLIDES: ClassVar = True

    stiffness: Positive = Field(
        description="K, force per length of threads side by side and per depth [N/m2]", examples=[2e4]
    )
    radius: Positive | None = Field(
        None,
        description="radius of all threads in this contact [m], at least their own, which is the default",
        examples=[0.005],
    )

    def cross_checks(self, rest: RestOfCase) -> Iterator[Fault]:
        """Require a radius that is not below that of the threads."""
        net, radius = rest.scene.net, self.radius
        if radius is None:
            return
        for words, cable in (("net.cable", net.cable), ("net.strings", getattr(net, "strings", None))):
            own = 0.0 if cable is None else math.sqrt(cable.cross_section / math.pi)
            if radius < (1.0 - 1e-12) * own:  # the square root rounds
                yield Fault("radius", f"must be at least that of {words}, {own:.6g} m, got {radius:g}")

    def first_order_states(self) -> tuple[FirstOrder, ...]:
        """Return the energy that damping has taken [J]."""
        return (FirstOrder(f"{NAME}/damping", (0.0,), "J", gives=-1.0),)

    def terms(self, blocks: Blocks) -> tuple[KernelTerm, ...]:
        """Return one term for all elements of the net and its strings; none for a single one."""
        if blocks.net.n_net_elements < 2:
            return ()
        return (threads_together(blocks, self.radii(blocks.net), self.stiffness, self.a),)

    def radii(self, net: Net) -> Floats:
        """Return the radius of the elements of the net and its strings, (m,) [m]."""
        if self.radius is not None:
            return np.full(net.n_net_elements, self.radius)
        return np.asarray(np.sqrt(net.area[: net.n_net_elements] / math.pi))

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[SelfContact, str]:
        """Assume threads as thick as they are; what they exchange hardly depends on the stiffness."""
        keys = SelfContact.model_validate({"stiffness": 1e5, "damping": 0.0})
        return keys, "threads of their own radius, without damping"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate meetings of threads once the net has opened and springs back, as lines in flight.

        A line of length l that moves at the speed v across itself sweeps the area (pi/4) l v; lines of the
        length lambda per volume, in all directions, cross an area lambda / 2 times. Each meeting changes the
        speed of a node by about v. Before the net has opened, its threads move apart.
        """
        net = basis.net
        if net.n_net_elements < 2:
            return Estimate(0.0, 0.0, "the net has no two threads that could touch")
        mass = np.where(basis.free, net.mass, 0.0)
        own = basis.velocity - (mass @ basis.velocity) / mass.sum() if mass.any() else 0.0 * basis.velocity
        speed = basis.rms(np.where(basis.free[:, None], own, 0.0))
        opens = basis.opening_time if math.isfinite(basis.opening_time) else 0.0
        lasts = max(0.0, basis.duration - opens)
        length = net.reference_length[: net.n_net_elements]
        rate = math.pi / 8.0 * float(length.mean()) * speed * float(length.sum()) / basis.size**3
        meetings = rate * lasts
        moved = min(meetings, 1.0) * speed * 0.5 * lasts
        words = f"{meetings:.2g} meetings of an element at {speed:.3g} m/s in the {lasts:.3g} s after opening"
        acceleration = speed * math.sqrt(self.stiffness * float(length.sum() / max(mass.sum(), 1e-300)))
        return Estimate(acceleration, basis.held(moved), words)
