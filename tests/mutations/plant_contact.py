"""Errors in contact, for the list in `plant`; each fails in rung 9, in the scene named."""

from __future__ import annotations

from plant import EXUDYN, REFERENCE, of_text, planted

from exunet.backends.exudyn.model import Model
from exunet.forces.contact import (
    blend_loops,
    bodies,
    body_loops,
    core_loops,
    damping_keys,
    frame_loops,
    friction_loops,
    grid_loops,
    law,
    mesh_threads,
    pair_loops,
    piece_loops,
    spheres,
    thread_loops,
    threads,
    together,
    touching_loops,
)
from exunet.forces.effects import contact
from reference_impl.contacts import Group

THREADS, NODES, BULLETS, TOGETHER = "threads", "nodes", "bullets", "together"
BOTH = (thread_loops, spheres)


def _of_text(name, scene, what, owner, function, old, new, users=()):
    of_text(name, 9, what, owner, function, old, new, scene, users=users)


ARM, OWN = "force[s] -= p[1] * f[2]", "d - (v[s + 1] * p[2] - v[s + 2] * p[1]),"
ON_B, HALF = "(length * sums[3], length * sums[4], length * sums[5])", "0.5 * length * sums"
DRAGGED, ELASTIC = "-stiffness * most / wanted", "elastic = c.stiffness * depth"
_of_text(
    "contact_torque_sign",
    BULLETS,
    "torque of contact with the wrong sign in one part",
    frame_loops,
    "push_point",
    ARM,
    ARM.replace("-=", "+="),
    BOTH,
)
_of_text(
    "contact_without_reaction",
    THREADS,
    "no force on the touched body",
    frame_loops,
    "push_point",
    "force[c + axis] -= d",
    "force[c + axis] -= 0.0 * d",
    BOTH,
)
_of_text(
    "contact_without_spin",
    BULLETS,
    "speed against the body's point without its rotation",
    frame_loops,
    "velocity_against_body",
    OWN,
    "d,",
    BOTH,
)
_of_text(
    "contact_shared_by_halves",
    THREADS,
    "force on a thread shared to its ends by halves",
    thread_loops,
    "push_thread",
    ON_B,
    f"({HALF}[0], {HALF}[1], {HALF}[2])",
    (threads,),
)
_of_text(
    "contact_that_pulls",
    THREADS,
    "threads that leave fast are pulled back",
    law,
    "sum_place",
    "max(1.0 + c.damping * rate, 0.0)",
    "(1.0 + c.damping * rate)",
    (touching_loops,),
)
_of_text(
    "friction_across",
    BULLETS,
    "friction against motion across the surface",
    friction_loops,
    "along_surface",
    "return a[0] - across * n[0],",
    "return a[0],",
)
_of_text(
    "friction_without_limit",
    THREADS,
    "friction that holds whatever the force across",
    friction_loops,
    "friction",
    DRAGGED,
    "-stiffness",
    BOTH,
)
_of_text(
    "friction_in_the_middle",
    THREADS,
    "friction in the middle of a thread",
    thread_loops,
    "push_thread",
    "at = sums[7] / sums[6]",
    "at = 0.5",
    (threads,),
)
_of_text(
    "one_side_of_a_box",
    BULLETS,
    "the normal of one side of a box turned round",
    core_loops,
    "box_distance",
    "k = 1.0 if z >= 0.0 else -1.0",
    "k = 1.0",
)
_of_text(
    "hertz_is_linear",
    BULLETS,
    "force of Hertz's law in proportion to the depth",
    spheres,
    "add_sphere",
    f"{ELASTIC}**c.exponent",
    ELASTIC,
)
_of_text(
    "parts_share_wrongly",
    THREADS,
    "force in a seam of parts shared by another power",
    blend_loops,
    "deeper",
    "after = (own / both) ** 7",
    "after = (own / both) ** 8",
    (touching_loops,),
)
_of_text(
    "bullets_are_nodes_too",
    NODES,
    "bullets that touch as nodes besides",
    spheres,
    "nodes_of",
    "np.setdiff1d(np.arange(net.n_net_nodes), net.bullet_nodes)",
    "np.arange(net.n_net_nodes)",
    (contact,),
)
_of_text(
    "general_contact_in_series",
    NODES,
    "stiffness of the engine's contact halved by two springs in series",
    Model,
    "sphere_contact",
    "2.0 * stiffness",
    "stiffness",
)


@planted(9, "damping by the formula for restitutions near 1", EXUDYN, BULLETS)
def damping_near_one(patch):
    patch.setattr(damping_keys, "damping_of", lambda restitution, speed: 1.5 * (1.0 - restitution) / speed)


@planted(9, "contact of twice the stiffness", REFERENCE, THREADS)
def reference_contact_doubled(patch):
    right = Group.push
    patch.setattr(Group, "push", lambda self, p: 2.0 * right(self, p))


@planted(9, "energy of contact without its power", REFERENCE, BULLETS)
def reference_contact_energy(patch):
    patch.setattr(Group, "stored", lambda self, p: self.factor * p ** (self.power + 1.0))


_of_text(
    "threads_together_without_reaction",
    TOGETHER,
    "force of threads that touch on one of both alone",
    together,
    "add_pair",
    "force[q + axis] -= on_q",
    "force[q + axis] -= 0.0 * on_q",
)
_of_text(
    "lever_along_the_other_thread",
    TOGETHER,
    "force of threads that touch shared to the ends of one by the middle of the chord",
    pair_loops,
    "press_at",
    "at * push + each * weight * (across[axis] * m_1 - e[axis] * m_2)",
    "at * push",
)
_of_text(
    "threads_together_pull",
    TOGETHER,
    "threads that part fast pull each other back",
    together,
    "add_pair",
    "max(1.0 + c.damping * rate, 0.0)",
    "(1.0 + c.damping * rate)",
)


def _of_bodies(name, what, owner, function, old, new, test):
    of_text(name, None, what, owner, function, old, new, f"test_bodies_at_states:test_{test}")


_of_bodies(
    "bodies_torque_about_the_other",
    "torque on the pressing body about the touched one's centre",
    body_loops,
    "hand_on",
    "(total[3] - d, total[4] - e, total[5] - g)",
    "(total[3], total[4], total[5])",
    "forces_follow_from_the_energy_and_change_no_momentum",
)
_of_bodies(
    "bodies_rub_at_the_core",
    "friction of bodies at the core instead of the surface",
    body_loops,
    "rub",
    "(p[0] - inwards * n[0], p[1] - inwards * n[1], p[2] - inwards * n[2])",
    "p",
    "friction_acts_where_the_surfaces_are",
)
_of_bodies(
    "bodies_without_the_touched_spin",
    "speed against the touched body without its rotation",
    body_loops,
    "move_against",
    "spin[axis] - v[c.spin + axis]",
    "spin[axis]",
    "friction_and_damping_change_no_momentum_and_are_booked",
)
_of_bodies(
    "bodies_one_curvature",
    "Hertz's law of two balls with the radius of one",
    bodies,
    "_springs",
    "(1.0 / other if own > 0.0 and other > 0.0 else 0.0)",
    "0.0",
    "two_balls_press_with_the_overlap",
)


def _of_meshes(name, what, owner, function, old, new, where, rubbing, users=()):
    test = "test_meshes_at_states:test_forces_on_a_mesh_change_no_momentum_and_their_work_is_booked"
    of_text(name, None, what, owner, function, old, new, test, users=users, arguments=(where, rubbing))


_of_meshes(
    "meshes_bend_less",
    "slope of the distance between grid points that is not that of the distance",
    grid_loops,
    "slopes_at",
    "-5.0 * t + 4.5 * u",
    "-5.0 * t + 4.0 * u",
    "over an edge",
    False,
)
_of_meshes(
    "threads_on_meshes_shared_by_halves",
    "force on a thread that touches a mesh shared to its ends by halves",
    piece_loops,
    "touch_pieces",
    "own *= s",
    "own *= 0.5",
    "on a face",
    False,
    (mesh_threads,),
)
_of_meshes(
    "threads_on_meshes_turn_unseen",
    "damping on a mesh by the speed of one end of a thread",
    piece_loops,
    "touch_pieces",
    "q * (o[1] + s * u[1])",
    "q * o[1]",
    "in a corner",
    True,
    (mesh_threads,),
)
