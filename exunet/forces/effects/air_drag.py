"""Drag in still air, for tests on the ground: cross-flow on the cables, a drag coefficient on the bullets.

The cross-flow (independence) principle: a long cylinder feels the component of the flow normal to its axis,
F = rho C d L |u_n| u_n / 2 (Hoerner, "Fluid-Dynamic Drag", 1965, ch. III-8). A slack element's surface does
not shrink with the distance of its nodes, so L is its reference length; its direction is that of its nodes.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from exunet.base.arrays import Floats
from exunet.base.record import NonNegative, Positive
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect
from exunet.forces.environment import bullet_disc, widths
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.loops import Index
from exunet.forces.terms import KernelTerm

NO_LENGTH = 1e-9  # of the reference length: below it the direction of an element is round-off


class AirDrag(Effect):
    """Drag in still air: cross-flow on the cables, and on the bullets."""

    ON_THE_GROUND: ClassVar = True
    EXCLUDES: ClassVar = {
        "molecular_drag": "air_drag is for the ground, molecular_drag for orbits",
        "orbit": "there is no continuous air in orbit; use molecular_drag",
    }
    BULLET_KEYS: ClassVar = ("bullet_drag_coefficient", "bullet_area")
    ON_THE_NET_ALONE: ClassVar = True

    density: Positive = Field(description="density of the air [kg/m3]", examples=[1.225])
    drag_coefficient: NonNegative = Field(
        description="C of the cables in cross-flow, on diameter x length [-]", examples=[1.1]
    )
    bullet_drag_coefficient: NonNegative | None = Field(
        None, description="C of the bullets [-]; if and only if the net has bullets", examples=[0.47]
    )
    bullet_area: NonNegative | None = Field(
        None, description="frontal area of a bullet [m2]; if and only if the net has bullets", examples=[4e-3]
    )

    def terms(self, blocks: Blocks) -> tuple[KernelTerm, ...]:
        """Return one kernel term for the elements, one for the bullets if there are any."""
        net = blocks.net
        first, second = (3 * net.element_nodes.T).astype(Index)
        quarter = 0.25 * self.density * self.drag_coefficient * widths(net) * net.reference_length
        data = CrossFlow(first, second, quarter, (NO_LENGTH * net.reference_length) ** 2)
        kernels = [KernelTerm("elements", add_cross_flow, data, couples=net.element_nodes)]
        if len(net.bullet_nodes):
            assert self.bullet_area is not None
            assert self.bullet_drag_coefficient is not None
            factor = 0.5 * self.density * self.bullet_drag_coefficient * self.bullet_area
            nodes = (3 * net.bullet_nodes).astype(Index)
            kernels.append(KernelTerm("bullets", add_bullet_drag, BulletDrag(nodes, factor)))
        return tuple(kernels)

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[AirDrag, str]:
        """Assume air at sea level, cylinders and balls below the drag crisis (Hoerner)."""
        bullets = basis.net.bullet_nodes
        area = bullet_disc(float(basis.net.mass[bullets[0]])) if len(bullets) else None
        on_bullets = {"bullet_drag_coefficient": 0.47 if len(bullets) else None, "bullet_area": area}
        keys = AirDrag.model_validate({"density": 1.225, "drag_coefficient": 1.1, **on_bullets})
        return keys, "1.225 kg/m3, C = 1.1 on cables" + (", 0.47 on balls of aluminium" if area else "")

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the force on the nominal motion, as a rate of decay.

        Cables that bullets pull from rest gain their speed over the scene: with v growing as t, the double
        integral of v^2 is T^2 / 12 instead of T^2 / 2.
        """
        net = basis.net
        x, v = basis.middle.ravel(), basis.motion.ravel()
        parts = []
        for term in self.terms(basis.blocks):
            force = np.zeros_like(x)
            term.add(0.0, x, v, term.data, force)
            parts.append(basis.of_force(force.reshape(-1, 3)))
        others = np.setdiff1d(np.arange(net.n_nodes), net.bullet_nodes)
        at_rest = len(net.bullet_nodes) > 0 and not basis.velocity[others].any()
        lasting = math.hypot(parts[0] / 6.0 if at_rest else parts[0], *parts[1:])
        rate = lasting / basis.speed if basis.speed else 0.0
        return Estimate(
            math.hypot(*parts),
            basis.held(basis.braked(rate)),
            f"rho C A v^2 / 2m at the nominal motion of {basis.speed:.3g} m/s, "
            f"rho = {self.density:.3g} kg/m3",
        )


class CrossFlow(NamedTuple):
    """Elements in still air.

    first, second : (m,) 3 i and 3 j of the end nodes
    quarter       : (m,) rho C d L0 / 4 [kg/m]
    least         : (m,) square of the length below which an element has no direction [m2]
    """

    first: NDArray[Index]
    second: NDArray[Index]
    quarter: Floats
    least: Floats


class BulletDrag(NamedTuple):
    """bullets : (n,) 3 x node; factor : rho C A / 2 [kg/m]."""

    bullets: NDArray[Index]
    factor: float


def add_cross_flow(t: float, x: Any, v: Any, elements: Any, force: Any) -> None:
    """Half of -rho C d L0 |u_n| u_n / 2 on each end, u_n the normal part of the middle's velocity."""
    first, second, quarter, least = elements
    for e in range(quarter.size):
        i = first[e]
        j = second[e]
        dx = x[j] - x[i]
        dy = x[j + 1] - x[i + 1]
        dz = x[j + 2] - x[i + 2]
        ux = 0.5 * (v[i] + v[j])
        uy = 0.5 * (v[i + 1] + v[j + 1])
        uz = 0.5 * (v[i + 2] + v[j + 2])
        square = dx * dx + dy * dy + dz * dz
        if square > least[e]:  # nodes on one spot have no direction: the whole flow counts
            along = (ux * dx + uy * dy + uz * dz) / square
            ux -= along * dx
            uy -= along * dy
            uz -= along * dz
        factor = quarter[e] * math.sqrt(ux * ux + uy * uy + uz * uz)
        force[i] -= factor * ux
        force[i + 1] -= factor * uy
        force[i + 2] -= factor * uz
        force[j] -= factor * ux
        force[j + 1] -= factor * uy
        force[j + 2] -= factor * uz


def add_bullet_drag(t: float, x: Any, v: Any, drag: Any, force: Any) -> None:
    """-rho C A |v| v / 2 on each bullet."""
    bullets, factor = drag
    for b in range(bullets.size):
        k = bullets[b]
        speed = math.sqrt(v[k] * v[k] + v[k + 1] * v[k + 1] + v[k + 2] * v[k + 2])
        for axis in range(3):
            force[k + axis] -= factor * speed * v[k + axis]
