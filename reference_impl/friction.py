"""Forces along the surface of bodies that are touched, and what they remember.

"regularised": T = -mu N w_t/sqrt(w_t^2 + v_s^2).  "sticking": a bristle from a point b of the body to a point
s_m of the line, T* = -k_t z with z = u + theta w_t; all in the body's axes.

A line that has not yet been seen to touch has T = T* with u = 0 within the circle |T| <= mu N, else T*
brought back to it.  Otherwise the law is the limit of that of the case format for short steps, in two smooth
pieces.  While a line sticks (HELD), T = T* with the memory as it is.  While it slides, T = -mu N e, e the
direction of z, which is of the length R = mu N/k_t and is dragged along:

    z' = W - lambda e,  |z| = R:   e' = (W - (e.W) e)/R,   lambda = e.W - R',   W = w_t + theta w_t'

(plasticity with the circle as its yield surface; Simo & Hughes, Computational Inelasticity, ch. 2).  e is
one more unknown, and s_m is s_c.  It sticks again when lambda falls to zero; then b is where z says.  As R
goes to zero, e follows W at once; its delay R/|W| is lengthened by DELAY, so that steps need not vanish too.
w_t' and R' are differences along the motion, at three instants after the present one, because before it the
line may not have touched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reference_impl.arrays import Floats, Ints, dot
from reference_impl.contacts import Group, Pressed
from reference_impl.effects.contact import Contact
from reference_impl.rounded import signed

APART, HELD, SLIDING = range(3)
DELAY = 2e-6  # [s]
LOOK_AHEAD = 3e-8  # [s] between the instants of the differences
SLOPE = np.array([-5.0, 8.0, -3.0]) / (2.0 * LOOK_AHEAD)  # of a parabola through instants 1, 2, 3, at 0


@dataclass(frozen=True, eq=False)
class Memory:
    """What friction remembers of P pairs."""

    law: Ints  # (P,)
    s: Floats  # s_m (P,)
    b: Floats  # (P, 3) [m] from the centre of mass, in the body's axes

    def of(self, group: Group, rows: Ints) -> Memory:
        """That of lines of a group."""
        chosen = group.first + rows
        return Memory(self.law[chosen], self.s[chosen], self.b[chosen])

    def put(
        self, group: Group, rows: Ints, law: int, s: Floats | None = None, b: Floats | None = None
    ) -> None:
        """Changes that of lines of a group."""
        chosen = group.first + rows
        self.law[chosen] = law
        if s is not None:
            self.s[chosen] = s
        if b is not None:
            self.b[chosen] = b

    def copy(self) -> Memory:
        """One that can be changed."""
        return Memory(self.law.copy(), self.s.copy(), self.b.copy())


def nothing(pairs: int) -> Memory:
    """No pair touches."""
    return Memory(np.zeros(pairs, dtype=np.intp), np.zeros(pairs), np.zeros((pairs, 3)))


@dataclass(frozen=True, eq=False)
class Dragged:
    """Forces along the surface on the t lines that touch."""

    force: Floats  # T (t, 3) [N] in the body's axes
    s: Floats  # (t,) where it acts
    taken: Floats  # -T.w (t,) [W]


def across(m: Floats, a: Floats) -> Floats:
    """The parts of vectors a (t, 3) across unit vectors m (t, 3)."""
    return np.asarray(a - dot(m, a)[:, None] * m)


def _size(a: Floats) -> Floats:
    return np.sqrt(dot(a, a))


def _over(a: Floats, size: Floats) -> Floats:
    """a/size (t, 3), zero where the size is."""
    return np.asarray(a / np.where(size > 0.0, size, np.inf)[:, None])


@dataclass(frozen=True, eq=False)
class Bristles:
    """The bristles of the t lines of a group that touch."""

    lines: Group  # (t,)
    found: Pressed
    memory: Memory  # (t,)
    x: Floats  # (n, 3)
    w: Floats  # (n, 3)
    limit: Floats  # mu N (t,)

    def stretched(self) -> Floats:
        """z (t, 3) of what is remembered [m]; u is zero where nothing is."""
        m, fresh = self.found.direction, self.memory.law == APART
        u = across(m, self.lines.at(self.memory.s, self.x) - self.memory.b)
        moving = across(m, self.lines.at(np.where(fresh, self.found.s, self.memory.s), self.w))
        return np.asarray(np.where(fresh[:, None], 0.0, u) + self.lines.lag[:, None] * moving)

    def slip(self) -> Floats:
        """w_t (t, 3) [m/s] at s_c."""
        return across(self.found.direction, self.lines.at(self.found.s, self.w))

    def anchored(self, z: Floats) -> Floats:
        """b (t, 3) for which z [m] is the bristle at s_c."""
        u = z - self.lines.lag[:, None] * self.slip()
        return np.asarray(self.lines.at(self.found.s, self.x) - u)

    def excess(self) -> Floats:
        """|T*| - mu N (t,) [N]."""
        return np.asarray(self.lines.stiffness * _size(self.stretched()) - self.limit)

    def depth(self) -> Floats:
        """Depth (t,) [m] at s_m, below zero where that is apart."""
        return signed(self.lines.parts, self.lines.radius, self.lines.at(self.memory.s, self.x))

    @property
    def reach(self) -> Floats:
        """R = mu N/k_t (t,) [m]."""
        return np.asarray(self.limit / self.lines.stiffness)


def bristles(law: Contact, group: Group, found: Pressed, memory: Memory, x: Floats, w: Floats) -> Bristles:
    """Those of the lines found touching."""
    lines = group.some(found.row)
    return Bristles(lines, found, memory.of(group, found.row), x, w, law.friction * found.normal)


def drag(
    law: Contact,
    group: Group,
    found: Pressed,
    memory: Memory | None,
    e: Floats,
    x: Floats,
    w: Floats,
) -> Dragged:
    """T on the lines found touching; e (P, 3) directions of those that slide."""
    lines, m, s = group.some(found.row), found.direction, found.s
    limit = law.friction * found.normal
    if memory is None:
        assert law.slip_speed is not None
        slip = across(m, lines.at(s, w))
        force = -_over(limit[:, None] * slip, np.sqrt(dot(slip, slip) + law.slip_speed**2))
        return Dragged(force, s, -dot(force, slip))
    these = bristles(law, group, found, memory, x, w)
    kind = these.memory.law
    spring = -lines.stiffness[:, None] * these.stretched()
    size = _size(spring)
    held = kind == HELD
    capped = np.where((size > limit)[:, None], _over(limit[:, None] * spring, size), spring)
    along = across(m, e[group.first + found.row])
    sliding = -_over(limit[:, None] * along, _size(along))
    force = np.select([(kind == HELD)[:, None], (kind == SLIDING)[:, None]], [spring, sliding], capped)
    force = np.where(found.normal[:, None] > 0.0, force, 0.0)
    s = np.where(held, these.memory.s, s)
    return Dragged(force, s, -dot(force, lines.at(s, w)))
