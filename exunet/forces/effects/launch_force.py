"""Launch by force over a stroke, by springs or gas, with the reaction on the chaser.

A spring that is F0 at the start pushes with F(s) = F0 (1 - s / stroke) along the barrel, s the path along it
since the start, until s reaches the stroke; gas that expands adiabatically with F0 (V / (V + s))^gamma, V its
dead volume over the bore's area. The barrels do not hold the bullets sideways. The force is that of a
potential U(s), F = -dU/ds.

The chaser is a rigid body. Bullet b at x_b has gone the path s = a . R^T (x_b - x_c) - s_0 along its barrel:
R turns the body's principal axes into the scene's, a is the barrel's axis in the former, x_c the centre of
mass, and s_0 makes s zero at the start. With r = x_b - x_c and n = R a, a virtual displacement that turns the
body by dtheta changes n by dtheta x n, and so the path by

    ds = n . (dx_b - dx_c) + dtheta . (n x r).

The virtual work F ds (Goldstein, Poole, Safko, "Classical Mechanics", 3rd ed., sec. 1.4; Lanczos, "The
Variational Principles of Mechanics", ch. III) is that of

    the force F n on the bullet, the force -F n on the body, and on it the torque F n x r = r x (-F n):

the reaction acts on the body at the bullet's place. Both forces lie on one line, so energy, momentum and
angular momentum are kept, wherever the bullet is beside its barrel and however the body turns. Barrels do not
hold bullets sideways: nothing pushes across the axis.

A bullet whose path has reached the stroke has left its barrel, and is not pushed again, wherever the barrel
turns to. U is zero from there on, so leaving costs no energy.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from exunet.base.arrays import Floats, Ints
from exunet.base.errors import Fault
from exunet.base.record import Positive
from exunet.forces.blocks import Blocks
from exunet.forces.effect import Effect, RestOfCase, existing_body
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.forces.loops import Index, in_body_axes, in_scene_axes
from exunet.forces.terms import Change, DiscreteState, DiscreteStates, KernelTerm, Switch
from exunet.net.arrays import Net


class LaunchLaw(NamedTuple):
    """Force law of the launch.

    force, stroke : F0 [N], path on which it acts [m]
    dead_length, exponent : of gas V, the volume behind the bullet over the bore's area [m], and gamma of the
                    adiabatic expansion; 0.0 of springs
    """

    force: float
    stroke: float
    dead_length: float = 0.0
    exponent: float = 0.0


class LaunchForce(Effect):
    """Springs or gas push the bullets out of barrels; a chaser takes the reaction."""

    NEEDS_BULLETS: ClassVar = True
    REPLACES_LAUNCH: ClassVar = True
    INTERNAL: ClassVar = True

    force: Positive = Field(description="F0, force on each bullet at the start [N]", examples=[60.0])
    stroke: Positive = Field(description="path along the barrel over which it acts [m]", examples=[0.1])
    spread_angle: float = Field(
        ge=0.0,
        le=math.pi / 2,
        description="between barrels and +z, the direction of the launch [rad]",
        examples=[0.6],
    )
    body: str = Field(description="name of the rigid body that the barrels are fixed to", examples=["chaser"])

    @property
    def law(self) -> LaunchLaw:
        """Force law of the launch."""
        return LaunchLaw(self.force, self.stroke)

    @property
    def work(self) -> float:
        """Work done on one bullet and the chaser over the whole stroke [J]."""
        return energy_of(0.0, self.law)

    def terms(self, blocks: Blocks) -> tuple[KernelTerm, ...]:
        """Return one conservative term over the bullets and the chaser; the stroke counts from the start."""
        return (launch_term(blocks, self.body, self.barrels(blocks.net), self.law),)

    def barrels(self, net: Net) -> np.ndarray:
        """Return (n_bullets, 3) unit vectors: spread_angle from +z towards the bullet's reference."""
        outward = net.reference_position[net.bullet_nodes]
        outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
        return math.sin(self.spread_angle) * outward + math.cos(self.spread_angle) * np.array([0.0, 0.0, 1.0])

    def cross_checks(self, rest: RestOfCase) -> Iterator[Fault]:
        """Require that the body exists."""
        yield from existing_body("body", self.body, rest)

    @classmethod
    def nominal(cls, basis: EstimateBasis) -> tuple[LaunchForce, str] | None:
        """Assume springs that give the bullets the speed they have, over 0.05 m."""
        bullets = basis.net.bullet_nodes
        if not len(bullets):
            return None
        velocity = basis.velocity[bullets[0]]
        speed = float(np.linalg.norm(velocity))
        if speed == 0.0:
            return None
        stroke = 0.05
        keys = SpringLaunchForce.model_validate(
            {
                "kind": "spring",
                "force": float(basis.net.mass[bullets[0]]) * speed**2 / stroke,
                "stroke": stroke,
                "spread_angle": math.acos(min(1.0, max(0.0, float(velocity[2]) / speed))),
                "body": "chaser",
            }
        )
        return keys, f"springs of 0.05 m that give {speed:.3g} m/s"

    def magnitude(self, basis: EstimateBasis) -> Estimate:
        """Estimate the flight of bullets at the speed that the work gives; as fast already: the lag.

        Without the stroke they would start at full speed; with constant force they lag behind by one stroke.
        """
        net = basis.net
        bullets = net.bullet_nodes
        mass = float(net.mass[bullets].mean())
        speed = math.sqrt(2.0 * self.work / mass)
        thrown = np.zeros((net.n_nodes, 3))
        thrown[bullets, 0] = 1.0
        part = basis.rms(thrown)
        moves = float(np.linalg.norm(basis.velocity[bullets], axis=1).mean()) > 0.0
        way = self.stroke if moves else speed * basis.duration
        words = "lag of a stroke behind an instant launch" if moves else "flight of the bullets"
        words += f" at sqrt(2 W / m) = {speed:.3g} m/s"
        return Estimate(self.force / mass * part, way * part, words)


class SpringLaunchForce(LaunchForce):
    """Springs push the bullets."""

    kind: Literal["spring"] = Field(description="springs, F0 (1 - s / stroke)")


class GasLaunchForce(LaunchForce):
    """Gas pushes the bullets."""

    kind: Literal["gas"] = Field(description="gas that expands adiabatically")
    dead_length: Positive = Field(
        description="V, gas volume at the start over the bore's area [m]", examples=[0.1]
    )
    exponent: float = Field(gt=1.0, description="gamma of the adiabatic expansion [-]", examples=[1.4])

    @property
    def law(self) -> LaunchLaw:
        """Force law of the launch."""
        return LaunchLaw(self.force, self.stroke, self.dead_length, self.exponent)


AnyLaunchForce = Annotated[SpringLaunchForce | GasLaunchForce, Field(discriminator="kind")]


class Barrels(NamedTuple):
    """Barrels on a body, and what pushes in them.

    bullets  : (n,) 3 x node of each bullet
    inside   : (n,) 1.0 for bullets in their barrels, 0.0 for those that have left
    axes     : (n, 3) unit vectors of the barrels, in principal axes
    start    : (n,) where along its barrel each bullet starts, from the centre of mass [m]
    centre, attitude, spin : where the entries of the body begin, see `exunet.forces.blocks`
    """

    bullets: NDArray[Index]
    inside: Floats
    axes: Floats
    start: Floats
    centre: int
    attitude: int
    spin: int
    law: LaunchLaw


def _with_inside(data: Barrels, inside: Floats) -> Barrels:
    return data._replace(inside=inside)


def launch_term(blocks: Blocks, body: str, axes: Floats, law: LaunchLaw) -> KernelTerm:
    """Return the term that launches all bullets out of barrels on a body.

    axes : (n, 3) unit vectors of the barrels at the start, in the net's axes
    """
    number, bullets = blocks.rigid.index(body), blocks.net.bullet_nodes
    turn = blocks.poses.turn[number]
    own = axes @ blocks.poses.net.T @ turn
    arms = (blocks.position[bullets] - blocks.poses.centre[number]) @ turn
    inside, start = np.ones(len(bullets)), np.einsum("ba,ba->b", arms, own)
    places = blocks.centre(body), blocks.attitude(body), blocks.spin(body)
    data = Barrels((3 * bullets).astype(Index), inside, own, start, *places, law)

    return KernelTerm(
        f"bullets and {body}",
        add_launch_of_body,
        data,
        launch_of_body_potential,
        (in_body_axes, in_scene_axes, way_in_barrel, apply_from_body, *_LAWS),
        bodies=(body,) if body in blocks.free_bodies else (),
        discrete=DiscreteState("launch_force/inside", inside, partial(_with_inside, data)),
        switch=Muzzles(data),
        event=beyond_muzzle,
        internal=True,
    )


def spring_force(s: float, law: Any) -> float:
    """F0 (1 - s / stroke) [N]."""
    return law.force * (1.0 - s / law.stroke)


def spring_energy(s: float, law: Any) -> float:
    """F0 (stroke - s)^2 / (2 stroke) [J]: the work that a spring has still to do."""
    left = law.stroke - s
    return law.force * left * left / (2.0 * law.stroke)


def gas_force(s: float, law: Any) -> float:
    """F0 (V / (V + s))^gamma [N]; F0 behind the start."""
    ratio = law.dead_length / (law.dead_length + max(s, 0.0))
    return law.force * ratio**law.exponent


def gas_energy(s: float, law: Any) -> float:
    """The work that the gas in a barrel has still to do [J]."""
    dead, less = law.dead_length, law.exponent - 1.0
    inside = (dead / (dead + max(s, 0.0))) ** less - (dead / (dead + law.stroke)) ** less
    return law.force * (dead / less * inside - min(s, 0.0))


def force_of(s: float, law: Any) -> float:
    """Return the force [N] at a path s [m]."""
    return gas_force(s, law) if law.exponent > 0.0 else spring_force(s, law)


def energy_of(s: float, law: Any) -> float:
    """Return the work that is still to do at a path s [m] within the stroke [J]."""
    return gas_energy(s, law) if law.exponent > 0.0 else spring_energy(s, law)


_LAWS = (spring_force, spring_energy, gas_force, gas_energy, force_of, energy_of)


@dataclass(frozen=True, eq=False)
class Muzzles(Switch):
    """Bullets leave their barrels."""

    barrels: Barrels

    def in_steps(self, discrete: Floats) -> bool:
        """Until all have left."""
        return bool(discrete.any())

    def crossed(self, time: float, x: Floats, v: Floats, discrete: Floats) -> Ints:
        """Bullets in their barrels whose way is not below the stroke."""
        inside = np.flatnonzero(discrete).tolist()
        out = [b for b in inside if way_in_barrel(x, b, self.barrels) >= self.barrels.law.stroke]
        return np.array(out, dtype=np.int64)

    def change(
        self, time: float, x: Floats, v: Floats, discrete: Floats, items: Ints, every: DiscreteStates
    ) -> Change:
        """They are not pushed again."""
        inside = discrete.copy()
        inside[items] = 0.0
        return Change(inside)


# Scalar loops, in the subset of Python that Numba compiles.


def way_in_barrel(x: Any, b: int, barrels: Any) -> float:
    """Way s [m] of bullet b along its barrel since the start."""
    k, c = barrels.bullets[b], barrels.centre
    d, e, f = in_body_axes(x, barrels.attitude, x[k] - x[c], x[k + 1] - x[c + 1], x[k + 2] - x[c + 2])
    return barrels.axes[b, 0] * d + barrels.axes[b, 1] * e + barrels.axes[b, 2] * f - barrels.start[b]


def beyond_muzzle(t: float, x: Any, v: Any, barrels: Any) -> float:
    """Way [m] beyond the end of the stroke, the largest of the bullets in their barrels."""
    beyond = -np.inf
    for b in range(barrels.bullets.size):
        if barrels.inside[b] > 0.0:
            beyond = max(beyond, way_in_barrel(x, b, barrels) - barrels.law.stroke)
    return beyond


def apply_from_body(x: Any, b: int, thrust: float, barrels: Any, force: Any) -> None:
    """A force [N] on bullet b along its barrel, and the reaction on the body at the bullet's place."""
    k, c, n, q = barrels.bullets[b], barrels.centre, barrels.spin, barrels.attitude
    i, j, m = thrust * barrels.axes[b, 0], thrust * barrels.axes[b, 1], thrust * barrels.axes[b, 2]
    d, e, f = in_body_axes(x, q, x[k] - x[c], x[k + 1] - x[c + 1], x[k + 2] - x[c + 2])
    force[n] += j * f - m * e
    force[n + 1] += m * d - i * f
    force[n + 2] += i * e - j * d
    d, e, f = in_scene_axes(x, q, i, j, m)
    force[k] += d
    force[k + 1] += e
    force[k + 2] += f
    force[c] -= d
    force[c + 1] -= e
    force[c + 2] -= f


def add_launch_of_body(t: float, x: Any, v: Any, barrels: Any, force: Any) -> None:
    """F(s) along each barrel while its bullet has not left it."""
    for b in range(barrels.bullets.size):
        if barrels.inside[b] > 0.0:
            s = way_in_barrel(x, b, barrels)
            if s < barrels.law.stroke:
                apply_from_body(x, b, force_of(s, barrels.law), barrels, force)


def launch_of_body_potential(x: Any, barrels: Any) -> float:
    """U(s) of each bullet in its barrel."""
    total = 0.0
    for b in range(barrels.bullets.size):
        if barrels.inside[b] > 0.0:
            s = way_in_barrel(x, b, barrels)
            if s < barrels.law.stroke:
                total += energy_of(s, barrels.law)
    return total
