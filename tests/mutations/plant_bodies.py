"""Errors in what moves rigid bodies, for the list in `plant`; each fails in rung 8, in the scene named."""

from __future__ import annotations

import dataclasses

import numpy as np
from plant import EXUDYN, PLANTED, REFERENCE, Planted, of_result, of_text, other_text, planted

from exunet.backends.compiled import integration, schemes
from exunet.backends.exudyn.items import Items
from exunet.bodies import constraint_loops, rigid
from exunet.bodies.body import RigidBody
from exunet.forces import from_outside, on_bodies, reel, reel_loops
from exunet.system import bodies, carried, drum, ejection, exchange, from_scene
from exunet.system.system import System
from reference_impl import bodies as reference_bodies
from reference_impl import fields, start, state, tethers
from reference_impl.anchors import Levers
from reference_impl.winding import Drive

SNAP, ORBIT, FREE = "snap_off_centre", "librations", "free_bodies"


def _of_text(name, scene, what, owner, function, old, new, users=()):
    of_text(name, 8, what, owner, function, old, new, scene, users=users)


def _of_step(name, what, function, old, new):
    """Enters an error in a function of the compiled loop's steps."""

    def plant(patch):
        right = getattr(schemes, function)
        wrong = other_text(schemes, function, old, new)
        steps = tuple(wrong if one is right else one for one in integration.STEPS)
        patch.setattr(integration, "STEPS", steps)

    PLANTED[name] = Planted(what, EXUDYN, 8, FREE, plant)


OWN_AXES, ARM = "a, b, c = in_body_axes(x, attached.quaternion[p], a, b, c)", "arm[1] * c - arm[2] * b"
PLACED, SPIN = "v[base] + d, v[base + 1] + e, v[base + 2] + f", " + v[s + 1] * jz - v[s + 2] * jy"
CROSS = "z[q + 2] * v[k + 2] - z[q + 3] * v[k + 1]"
KICK, HALF = "spins[number] -= back[3:]", "total -= 0.5 * ((half"
_of_text(
    "torque_sign",
    SNAP,
    "torque of attached nodes with the wrong sign",
    constraint_loops,
    "carry_forces",
    f"force[n] += {ARM}",
    f"force[n] -= {ARM}",
)
_of_text(
    "torque_in_scene_axes",
    SNAP,
    "torque on bodies in the scene's axes",
    constraint_loops,
    "carry_forces",
    OWN_AXES,
    "a, b, c = a, b, c",
)
_of_text(
    "reaction_lost",
    SNAP,
    "no force of attached nodes on their bodies",
    constraint_loops,
    "carry_forces",
    "force[base] += a\n",
    "force[base] += 0.0 * a\n",
)
_of_text(
    "attached_without_spin",
    SNAP,
    "attached nodes without omega x r",
    constraint_loops,
    "add_arm",
    PLACED,
    "v[base], v[base + 1], v[base + 2]",
)
_of_text(
    "lever_from_the_frame",
    SNAP,
    "levers from the frame's origin",
    RigidBody,
    "in_principal_axes",
    " - self.centre",
    "",
)
_of_text(
    "gradient_sign",
    ORBIT,
    "gravity gradient with the wrong sign",
    on_bodies,
    "add_field",
    "(i[2] - i[1]) * yz",
    "(i[1] - i[2]) * yz",
)
_of_text("coriolis_torque_lost", ORBIT, "no Coriolis torque about one axis", on_bodies, "add_field", SPIN, "")
_of_text(
    "gradient_potential_sign",
    ORBIT,
    "potential of attitudes with the wrong sign",
    on_bodies,
    "field_potential",
    HALF,
    HALF.replace("-=", "+="),
)
_of_text(
    "spin_not_braked",
    "braked_body",
    "damping by the mass that drives the spin",
    on_bodies,
    "add_braking",
    "axis] -= braked.turning",
    "axis] += braked.turning",
)
_of_text(
    "spin_of_the_other_axes",
    SNAP,
    "angular velocities of the file in the other axes",
    bodies,
    "_start_of",
    '== "scene"',
    '!= "scene"',
)
_of_text(
    "launch_turns_with",
    "bodies_launch",
    "a launch turns its chaser the wrong way",
    carried,
    "thrown",
    KICK,
    KICK.replace("-=", "+="),
    (from_scene,),
)
_of_text(
    "engine_inertia",
    FREE,
    "moments of inertia of two axes swapped in the engine",
    Items,
    "rigid_body",
    "[*body.inertia,",
    "[*body.inertia[1::-1], body.inertia[2],",
)
_of_text("spin_energy_lost", FREE, "no energy of rotation", rigid, "kinetic", "(moving + spinning)", "moving")
_of_step(
    "gyroscopic_sign",
    "gyroscopic torque with the wrong sign",
    "add_gyroscopic",
    "(inertia[b, 1] - inertia[b, 2])",
    "(inertia[b, 2] - inertia[b, 1])",
)
_of_step(
    "quaternion_order",
    "one part of a product of quaternions in the other order",
    "turn",
    f"z[q] * v[k] + {CROSS}",
    f"z[q] * v[k] - ({CROSS})",
)
_of_text(
    "throw_without_recoil",
    "bodies_launch",
    "energy that a throw at time 0 gives its chaser left out of the books",
    carried,
    "booked",
    " + float(next(energies) - next(energies))",
    "",
    (from_scene,),
)
_of_text(
    "line_of_angular_impulse",
    ORBIT,
    "angular impulse of an effect with the wrong sign in one part",
    from_outside,
    "count_force",
    "force[rate + 5] += x[first] * b",
    "force[rate + 5] -= x[first] * b",
)
of_result(
    "reference_gradient", 8, "torques of the field with the wrong sign", fields, "torques", np.negative, ORBIT
)


FELT, LENGTH = "(tension * stretch - 0.5 * outlet.stiffness * strain * strain)", "tension * stretch"
_of_text(
    "reel_energy_of_length",
    "reel_rate",
    "a drum that does not feel the energy in the length that comes in",
    reel_loops,
    "pulls",
    FELT,
    LENGTH,
    (reel, drum),
)
_of_text(
    "reel_takes_up",
    "reel_force",
    "a drive that pays out where its force is missing",
    reel_loops,
    "winding_rate",
    "gives * (force - pull)",
    "gives * (pull - force)",
    (reel,),
)
_of_text(
    "exchange_moment",
    "reel_nodes",
    "moment of nodes that come onto a drum with the wrong sign",
    exchange,
    "exchanged",
    "arriving = np.cross",
    "arriving = -np.cross",
    (drum, ejection),
)
_of_text(
    "guide_of_a_drum",
    "led_winch",
    "what a guide gives with nodes that its body's drum takes with the wrong sign",
    exchange,
    "_given",
    "+= numbers",
    "-= numbers",
)


@planted(8, "a drive with twice its damping", REFERENCE, "reel_force")
def reference_drive(patch):
    right = Drive._wish

    def wrong(drive, order, pull):
        return right(dataclasses.replace(drive, damping=2.0 * drive.damping), order, pull)

    patch.setattr(Drive, "_wish", wrong)


@planted(8, "all ends of tethers on bodies numbered before all inner nodes", REFERENCE, "two_tethers")
def reference_ends_first(patch):
    def wrong(woven, tied_to, pieces):
        return np.arange(woven + len(tied_to) + (pieces - 1).sum())

    patch.setattr(tethers, "_tether_by_tether", wrong)


@planted(8, "mass of attached nodes left out of their bodies", case=SNAP)
def carried_mass_lost(patch):
    right = bodies.make_body
    patch.setattr(bodies, "make_body", lambda name, keys, carried=(): right(name, keys, []))


@planted(8, "a body of given motion with the centre of mass of its nodes and itself", case="whirled")
def guided_centre(patch):
    def wrong(name, keys, net, points):
        carried = [bodies.point_mass(net.mass[one.node], one.point) for one in points]
        return bodies.make_body(name, keys, carried)

    patch.setattr(bodies, "_loaded", wrong)


@planted(8, "moments of inertia of two axes swapped in the compiled loop", case=FREE)
def loop_inertia(patch):
    right = System.body_inertia.func
    patch.setattr(System, "body_inertia", property(lambda system: right(system)[:, [1, 0, 2]]))


@planted(8, "no parallel-axis term for attached nodes", REFERENCE, SNAP)
def reference_steiner_lost(patch):
    right = start.loaded
    patch.setattr(
        start, "loaded", lambda body, *more: dataclasses.replace(right(body, *more), inertia=body.inertia)
    )


@planted(8, "attitudes turned by angular velocities in the bodies' axes", REFERENCE, FREE)
def reference_frame_of_omega(patch):
    def wrong(attitude, spin, mobility):
        own = reference_bodies.own_turning(attitude, spin, mobility)
        return reference_bodies.skew(own) @ attitude

    patch.setattr(state, "attitude_rate", wrong)


@planted(8, "torque about the centre with force and lever exchanged", REFERENCE, SNAP)
def reference_torque_sign(patch):
    right = Levers.wrench

    def wrong(self, push, lever):
        force, torque = right(self, push, lever)
        return force, -torque

    patch.setattr(Levers, "wrench", wrong)


@planted(8, "attached nodes at rest relative to the centre", REFERENCE, SNAP)
def reference_attached_without_spin(patch):
    patch.setattr(Levers, "velocities", lambda self, velocity, turning, lever: velocity[..., self.body, :])
