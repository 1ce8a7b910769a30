"""Errors in what closes a mouth, for the list in `plant`; each fails in rung 10, in the scene named."""

from __future__ import annotations

from plant import EXUDYN, PLANTED, REFERENCE, Planted, of_text, other_text

import reference_impl.closing as reference_closing
from exunet.forces import closing, closing_loops, perimeter
from exunet.net import closing as closing_net
from exunet.system import from_scene
from reference_impl import forces as reference_forces

LOOP, OPEN, EDGE = "loop", "open_line", "perimeter"


def _of_loops(name, scene, what, function, old, new):
    def plant(patch):
        wrong = other_text(closing_loops, function, old, new)
        for one in (closing_loops, closing):
            if hasattr(one, function):
                patch.setattr(one, function, wrong)
        for helpers in ("LAID", "SMOOTH"):  # of which kernels are made
            every = getattr(closing, helpers)
            patch.setattr(
                closing, helpers, tuple(wrong if one.__name__ == function else one for one in every)
            )

    PLANTED[name] = Planted(what, EXUDYN, 10, scene, plant)


_of_loops(
    "line_tension_jumps_at_a_ring",
    LOOP,
    "the tension of a frictionless line falls by a part from piece to piece",
    "pull_nodes",
    "one = tension * pull[k]",
    "one = tension * (1.0 - 1e-6 * k) * pull[k]",
)
_of_loops(
    "line_winch_work_sign",
    LOOP,
    "work of the winch with the wrong sign",
    "add_line",
    "force[k + 1] += felt * w",
    "force[k + 1] -= felt * w",
)
_of_loops(
    "line_does_not_get_shorter",
    LOOP,
    "the line keeps its length, whatever the winch winds up",
    "line_strain",
    "natural = line.whole - line.ratio * x[line.state[0]]",
    "natural = line.whole",
)
_of_loops(
    "line_viscous_without_winch",
    OPEN,
    "viscous stress without the rate at which the winch shortens the line",
    "line_pulls",
    "parting = (growth_of_way(v, line) + stretch * line.ratio * w) / natural",
    "parting = growth_of_way(v, line) / natural",
)
_of_loops(
    "line_straight_through_rings",
    OPEN,
    "the way of rings that meet without the turn round them",
    "lay_line",
    "ring * (0.375 + u * u * (0.75 - 0.125 * u * u)) if u < 1.0 else d",
    "d",
)
of_text(
    "line_lock_forgotten",
    10,
    "the last command of a winch, to lock, does not come in force",
    closing.Drawstring,
    "data",
    "line.drives[int(memory[0])]",
    "line.drives[min(int(memory[0]), len(line.drives) - 2)]",
    LOOP,
)
of_text(
    "line_mass_of_pieces_at_one_end",
    10,
    "the mass of each piece of a line at its first end",
    closing_net,
    "with_mass_of",
    "for ends in (path[:-1], path[1:]):",
    "for ends in (path[:-1], path[:-1]):",
    OPEN,
    users=(from_scene,),
)
of_text(
    "edge_work_of_the_tension_alone",
    10,
    "work that shortens an edge without what the threads store",
    perimeter,
    "add_threads",
    "tension * length / natural - 0.5 * threads.stiffness[e] * strain * strain",
    "tension * length / natural",
    EDGE,
)


def _in_reference(name, scene, what, function, old, new, users=()):
    def plant(patch):
        wrong = other_text(reference_closing, function, old, new)
        for one in (reference_closing, *users):
            patch.setattr(one, function, wrong)

    PLANTED[name] = Planted(what, REFERENCE, 10, scene, plant)


_in_reference(
    "reference_line_slope",
    OPEN,
    "the pull of rings that meet as if they did not",
    "pull",
    "0.5 * (3.0 - squared / line.diameter**2) / line.diameter",
    "1.0 / np.sqrt(np.maximum(squared, 1e-300))",
    (reference_forces,),
)
_in_reference(
    "reference_ends_of_open_lines",
    OPEN,
    "an open line does not come back to its first ring",
    "course",
    "again = rings[:1] if isinstance(line.rings, str) else rings[:0]",
    "again = rings[:0]",
)
