"""All that moves, and what the forces do to it."""

from __future__ import annotations

from dataclasses import dataclass

from reference_impl.arrays import Floats


@dataclass(frozen=True, eq=False)
class Whole:
    """All that moves: N = n + b particles, nodes and then bodies, and r rigid bodies."""

    x: Floats  # (..., N, 3) [m]
    v: Floats  # (..., N, 3) [m/s]
    attitude: Floats  # R (..., r, 3, 3)
    spin: Floats  # h (..., r, 3) [kg m2/s] about the centres of mass, in the scene's axes
    wound_up: Floats | None = None  # s (..., R) [m] of the reels
    held: Floats | None = None  # k (..., R)
    packed: Floats | None = None  # (..., 1) 1 while a body holds the net, then 0; None: the time decides
    bristles: Floats | None = None  # (..., P, 3) directions of friction's bristles that slide; None: none
    drawn: Floats | None = None  # (..., c) of what closes the mouth, see `closing.Drawn`


@dataclass(frozen=True, eq=False)
class Response:
    """What the forces do: accelerations (zero without a motion of one's own), torques, power that leaves."""

    acceleration: Floats  # (N, 3) [m/s2]
    torque: Floats  # (r, 3) [N m] about the centres of mass
    power: float  # [W]
    given: Floats  # (d, 7) by driven bodies: force [N], torque about the origin [N m], power [W]
    reeling: Floats  # (2, R) of reels: ds/dt [m/s], power on their tethers [W]
    rubbing: Floats  # (2,) [W] taken where bodies are touched, by damping and by friction
    drawing: Floats  # (2,) of what closes the mouth: rate of its unknown, power of its work [W]; (0,) without
