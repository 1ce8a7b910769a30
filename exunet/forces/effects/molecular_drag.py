"""Drag in free-molecular flow: along the flow, on the mean area of tumbling cables, and on the bullets.

F = rho C A |u| u / 2 with u the velocity of the gas against the node; in free-molecular flow C is about 2 to
2.4 (Vallado, "Fundamentals of Astrodynamics and Applications", sec. 8.6.2). The cables tumble, so A is the
mean over all orientations, pi d L0 / 4, lumped to the nodes as their mass is; nodes do not shade each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from exunet.base.arrays import Floats
from exunet.base.errors import Fault
from exunet.base.record import NonNegative, Positive, Vector
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect, RestOfCase
from exunet.forces.effects.orbit import Orbit
from exunet.forces.environment import (
    HIGHEST,
    LOWEST,
    NOMINAL,
    bullet_disc,
    exponential_density,
    tumbling_areas,
)
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.terms import KernelTerm


class MolecularDrag(Effect):
    """Drag of the thin gas in orbit on tumbling cables and on bullets."""

    EXCLUDES: ClassVar = {"gravity": "uniform gravity is for the ground, free-molecular flow for orbits"}
    BULLET_KEYS: ClassVar = ("bullet_area",)
    ON_THE_NET_ALONE: ClassVar = True
    PUTS_IN: ClassVar = "the flow of gas"
    EXACTLY_ONE: ClassVar = ("density", "altitude")

    density: Positive | None = Field(None, description="density of the gas [kg/m3]", examples=[1e-12])
    altitude: float | None = Field(
        None,
        ge=LOWEST,
        le=HIGHEST,
        description="height [m] for the exponential model of the atmosphere, instead of density",
        examples=[400e3],
    )
    flow: Vector = Field(
        description="velocity of the gas in the scene's axes [m/s]", examples=[[-7500.0, 0.0, 0.0]]
    )
    drag_coefficient: NonNegative = Field(description="C [-], about 2 to 2.4", examples=[2.2])
    bullet_area: NonNegative | None = Field(
        None,
        description="area of a bullet across the flow [m2]; if and only if the net has bullets",
        examples=[4e-3],
    )

    @property
    def gas_density(self) -> float:
        """Density [kg/m3], given or of the exponential model."""
        return self.density if self.density is not None else exponential_density(self.altitude or 0.0)

    def terms(self, blocks: Blocks) -> tuple[KernelTerm, ...]:
        """Return one kernel term over all nodes."""
        factor = 0.5 * self.gas_density * self.drag_coefficient * tumbling_areas(blocks, self.bullet_area)
        flow = np.array(self.flow)
        rate = 2.0 * float(np.max(factor / blocks.mass, initial=0.0)) * math.hypot(*self.flow)
        return (KernelTerm("nodes", add_molecular_drag, Flow(factor, flow), damping_rate=rate),)

    def cross_checks(self, rest: RestOfCase) -> Iterator[Fault]:
        """Require the height of the orbit, if there is one."""
        orbit = rest.scene.effects.get(Orbit)
        height = orbit.altitude if orbit is not None else None
        if self.altitude is not None and height is not None and height != self.altitude:
            yield Fault("altitude", f"differs from that of effects.orbit, {height:g} m")

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[MolecularDrag, str] | None:
        """Assume the orbit of the case, or one at 700 km, through gas at rest; bullets as balls of aluminium.

        None below the heights for which the density is known.
        """
        bullets, orbit = basis.net.bullet_nodes, NOMINAL if basis.orbit is None else basis.orbit
        if orbit.height < LOWEST:
            return None
        area = bullet_disc(float(basis.net.mass[bullets[0]])) if len(bullets) else None
        speed = orbit.rate * orbit.radius
        keys = MolecularDrag.model_validate(
            {
                "altitude": min(orbit.height, HIGHEST),  # above, the gas is thinner still
                "flow": tuple(-speed * part for part in orbit.along_track),
                "drag_coefficient": 2.2,
                "bullet_area": area,
            }
        )
        balls = ", balls of aluminium" if area else ""
        return keys, f"{orbit.words}, {speed / 1e3:.1f} km/s, C = 2.2{balls}"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the force on nodes at rest."""
        term = self.terms(basis.blocks)[0]
        force = np.zeros(3 * basis.net.n_nodes)
        term.add(0.0, force, np.zeros_like(force), term.data, force)
        acceleration = basis.of_force(force.reshape(-1, 3))
        return Estimate(
            acceleration,
            basis.ballistic(acceleration),
            f"rho C A u^2 / 2m, rho = {self.gas_density:.3g} kg/m3, u = {math.hypot(*self.flow):.4g} m/s",
        )


class Flow(NamedTuple):
    """factor : (n_points,) rho C A / 2 [kg/m]; velocity : (3,) of the gas past the scene [m/s]."""

    factor: Floats
    velocity: Floats


def add_molecular_drag(t: float, x: Any, v: Any, gas: Any, force: Any) -> None:
    """rho C A |u| u / 2 on every node, u = flow - v."""
    factor, flow = gas
    for node in range(factor.size):
        k = 3 * node
        ux = flow[0] - v[k]
        uy = flow[1] - v[k + 1]
        uz = flow[2] - v[k + 2]
        scale = factor[node] * math.sqrt(ux * ux + uy * uy + uz * uz)
        force[k] += scale * ux
        force[k + 1] += scale * uy
        force[k + 2] += scale * uz
