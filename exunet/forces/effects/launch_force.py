"""Launch by force over a stroke, by springs or gas, with the reaction on the chaser.

A spring that is F0 at the start pushes with F(s) = F0 (1 - s / stroke) along the barrel, s the way along it
since the start, until s reaches the stroke; gas that expands adiabatically with F0 (V / (V + s))^gamma, V its
dead volume over the bore's area. The barrels do not hold the bullets sideways.

The chaser is a rigid body, in whose frame the barrels are fixed (`exunet.forces.barrels`), or a point mass at
the origin. Then the barrels' axes a_b stay as they are, s = (x_b - x_c) . a_b - s_0, and the chaser gets
-F(s) a_b. The force is that of a potential, so energy and linear momentum are kept. The forces on bullet and
chaser do not lie on one line: their torque is for the attitude of a body, which a point mass does not have,
so the angular momentum about the origin is not kept while the bullets are in the barrels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from exunet.base.errors import Fault
from exunet.base.record import Positive, Record
from exunet.forces.barrels import BarrelLaw, gas_energy, gas_force, push_term, spring_energy, spring_force
from exunet.forces.blocks import Blocks, PointMass
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.loops import Index
from exunet.forces.requirements import RestOfCase, existing_body
from exunet.forces.terms import KernelTerm
from exunet.net.arrays import Net

Floats = NDArray[np.float64]

NEEDS_BULLETS = True
REPLACES_LAUNCH = True
NOT_CARRIED = {"chaser_mass": "a chaser at the origin: give body instead"}


class LaunchForceConfig(Record):
    """Springs or gas push the bullets out of barrels; a chaser takes the reaction."""

    EXACTLY_ONE: ClassVar = ("chaser_mass", "body")

    kind: Literal["spring", "gas"] = Field(description="drive: F0 (1 - s / stroke), or adiabatic gas")
    force: Positive = Field(description="F0, force on each bullet at the start [N]", examples=[60.0])
    stroke: Positive = Field(description="path along the barrel over which it acts [m]", examples=[0.1])
    spread_angle: float = Field(
        ge=0.0,
        le=math.pi / 2,
        description="between barrels and +z, the direction of the launch [rad]",
        examples=[0.6],
    )
    chaser_mass: Positive | None = Field(
        None,
        description="mass of a chaser that is a point mass at the origin [kg]; not with [initial.frame]",
        examples=[500.0],
    )
    body: str | None = Field(
        None,
        description="instead of chaser_mass: name of the rigid body that the barrels are fixed to",
        examples=["chaser"],
    )
    dead_length: Positive | None = Field(
        None,
        description='V, gas volume at the start over the bore\'s area [m]; for "gas" only',
        examples=[0.1],
    )
    exponent: float | None = Field(
        None, gt=1.0, description='gamma of the adiabatic expansion [-]; for "gas" only', examples=[1.4]
    )

    def faults(self) -> Iterator[Fault]:
        """Require the keys of gas if and only if it is gas that pushes."""
        for name in ("dead_length", "exponent"):
            if self.kind == "gas" and not self.is_given(name):
                yield Fault("", f'kind = "gas" requires {name}')
            if self.kind == "spring" and self.is_given(name):
                yield Fault(name, 'is for kind = "gas" only')

    @property
    def work(self) -> float:
        """Done on one bullet and the chaser over the whole stroke [J]."""
        if self.kind == "spring":
            return 0.5 * self.force * self.stroke
        assert self.dead_length is not None
        assert self.exponent is not None
        less = self.exponent - 1.0
        return self.force * self.dead_length / less * (1.0 - (1.0 + self.stroke / self.dead_length) ** -less)


def point_masses(keys: LaunchForceConfig) -> tuple[PointMass, ...]:
    """The chaser, at the origin; none if it is a rigid body."""
    return () if keys.chaser_mass is None else (PointMass("chaser", keys.chaser_mass),)


def internal(keys: LaunchForceConfig) -> bool:
    """True of barrels on a body; the forces on bullets and a point mass are not on one line."""
    return keys.body is not None


def terms(keys: LaunchForceConfig, blocks: Blocks) -> tuple[KernelTerm, ...]:
    """One conservative term over the bullets and the chaser; the stroke counts from the start."""
    return _from_point(keys, blocks) if keys.body is None else _from_body(keys, blocks, keys.body)


def _from_point(keys: LaunchForceConfig, blocks: Blocks) -> tuple[KernelTerm, ...]:
    net, chaser = blocks.net, blocks.body["chaser"]
    nodes = (3 * net.bullet_nodes).astype(Index)
    axes = barrels(keys, net)
    start = np.einsum("ba,ba->b", blocks.position[net.bullet_nodes] - blocks.position[chaser], axes)
    spring = Spring(nodes, 3 * chaser, axes, start, keys.force, keys.stroke)
    couples = np.stack([net.bullet_nodes, np.full(len(nodes), chaser)], axis=1)
    both = (travelled, push_apart)
    if keys.kind == "spring":
        potential, helpers = spring_launch_potential, (*both, spring_force, spring_energy)
        return (KernelTerm(_PUSHED, add_spring_launch, spring, potential, helpers, couples),)
    gas = Gas(*spring, *_of_gas(keys))
    by_gas = (*both, gas_force, gas_energy)
    return (KernelTerm(_PUSHED, add_gas_launch, gas, gas_launch_potential, by_gas, couples),)


def _from_body(keys: LaunchForceConfig, blocks: Blocks, body: str) -> tuple[KernelTerm, ...]:
    law = BarrelLaw(keys.force, keys.stroke, *(_of_gas(keys) if keys.kind == "gas" else ()))
    return (push_term(blocks, body, barrels(keys, blocks.net), law),)


def _of_gas(keys: LaunchForceConfig) -> tuple[float, float]:
    assert keys.dead_length is not None
    assert keys.exponent is not None
    return keys.dead_length, keys.exponent


_PUSHED = "bullets and chaser"


def barrels(keys: LaunchForceConfig, net: Net) -> np.ndarray:
    """(n_bullets, 3) unit vectors: spread_angle from +z towards each bullet's reference position."""
    outward = net.reference_position[net.bullet_nodes]
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    return math.sin(keys.spread_angle) * outward + math.cos(keys.spread_angle) * np.array([0.0, 0.0, 1.0])


class Spring(NamedTuple):
    """Springs in their barrels.

    bullets : (n,) 3 x node of each bullet
    chaser  : 3 x the chaser's point
    axes    : (n, 3) unit vectors of the barrels
    start   : (n,) where along its barrel each bullet starts, from the chaser's point [m]
    force   : F0 at the start [N]
    stroke  : way on which it acts [m]
    """

    bullets: NDArray[Index]
    chaser: int
    axes: Floats
    start: Floats
    force: float
    stroke: float


class Gas(NamedTuple):
    """The same with gas: dead_length V of the volume behind the bullet [m], adiabatic exponent."""

    bullets: NDArray[Index]
    chaser: int
    axes: Floats
    start: Floats
    force: float
    stroke: float
    dead_length: float
    exponent: float


def travelled(x: Any, b: int, barrels: Any) -> float:
    """Way s [m] of bullet b along its barrel since the start; barrels : `Spring` or `Gas`."""
    k, c = barrels.bullets[b], barrels.chaser
    s = -barrels.start[b]
    for axis in range(3):
        s += (x[k + axis] - x[c + axis]) * barrels.axes[b, axis]
    return s


def push_apart(b: int, push: float, barrels: Any, force: Any) -> None:
    """A force [N] on bullet b along its barrel, and its reaction on the chaser."""
    k, c = barrels.bullets[b], barrels.chaser
    for axis in range(3):
        force[k + axis] += push * barrels.axes[b, axis]
        force[c + axis] -= push * barrels.axes[b, axis]


def add_spring_launch(t: float, x: Any, v: Any, springs: Any, force: Any) -> None:
    """The force of a spring along each barrel while s < stroke."""
    for b in range(springs.bullets.size):
        s = travelled(x, b, springs)
        if s < springs.stroke:
            push_apart(b, spring_force(s, springs), springs, force)


def spring_launch_potential(x: Any, springs: Any) -> float:
    """The energy of the springs of all bullets in their barrels."""
    total = 0.0
    for b in range(springs.bullets.size):
        s = travelled(x, b, springs)
        if s < springs.stroke:
            total += spring_energy(s, springs)
    return total


def add_gas_launch(t: float, x: Any, v: Any, gas: Any, force: Any) -> None:
    """The force of the gas along each barrel while s < stroke."""
    for b in range(gas.bullets.size):
        s = travelled(x, b, gas)
        if s < gas.stroke:
            push_apart(b, gas_force(s, gas), gas, force)


def gas_launch_potential(x: Any, gas: Any) -> float:
    """The energy of the gas behind all bullets in their barrels."""
    total = 0.0
    for b in range(gas.bullets.size):
        s = travelled(x, b, gas)
        if s < gas.stroke:
            total += gas_energy(s, gas)
    return total


def cross_checks(keys: LaunchForceConfig, rest: RestOfCase) -> Iterator[Fault]:
    """Require that the body exists."""
    yield from existing_body("body", keys.body, rest)


def nominal(basis: EstimateBasis) -> tuple[LaunchForceConfig, str] | None:
    """Springs that give the bullets the speed they have, over 0.05 m, from a chaser of 500 kg."""
    bullets = basis.net.bullet_nodes
    if not len(bullets):
        return None
    velocity = basis.velocity[bullets[0]]
    speed = float(np.linalg.norm(velocity))
    if speed == 0.0:
        return None
    stroke = 0.05
    keys = LaunchForceConfig.model_validate(
        {
            "kind": "spring",
            "force": float(basis.net.mass[bullets[0]]) * speed**2 / stroke,
            "stroke": stroke,
            "spread_angle": math.acos(min(1.0, max(0.0, float(velocity[2]) / speed))),
            "chaser_mass": 500.0,
        }
    )
    return keys, f"springs of 0.05 m that give {speed:.3g} m/s, a chaser of 500 kg"


def magnitude(keys: LaunchForceConfig, basis: EstimateBasis) -> Estimate:
    """The bullets' flight at the speed that the work gives them; as fast already: the way they lag behind.

    Without the stroke they would start at full speed; with constant force they lag behind by one stroke.
    """
    net = basis.net
    bullets = net.bullet_nodes
    mass = float(net.mass[bullets].mean())
    speed = math.sqrt(2.0 * keys.work / mass)
    thrown = np.zeros((net.n_nodes, 3))
    thrown[bullets, 0] = 1.0
    part = basis.rms(thrown)
    moves = float(np.linalg.norm(basis.velocity[bullets], axis=1).mean()) > 0.0
    way = keys.stroke if moves else speed * basis.duration
    words = "lag of a stroke behind an instant launch" if moves else "flight of the bullets"
    return Estimate(
        keys.force / mass * part,
        way * part,
        f"{words} at sqrt(2 W / m) = {speed:.3g} m/s",
    )
