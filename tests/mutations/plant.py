"""Errors that the quick ladder, or a quick test, must catch; each is planted with pytest's monkeypatch."""

from __future__ import annotations

import dataclasses
import inspect
import linecache
import sys
import textwrap
from collections.abc import Callable

import numpy as np

import reference_impl.energy as reference_energy
import reference_impl.forces as forces
import reference_impl.internal as internal
import reference_impl.stiffness as stiffness
from exunet.backends.compiled import integration as compiled
from exunet.backends.compiled import schemes
from exunet.backends.exudyn.model import Model
from exunet.forces import cable, cable_term, surface
from exunet.forces.effects import (
    air_drag,
    bending,
    launch_force,
    mass_damping,
    molecular_drag,
    orbit,
    rayleigh_damping,
    solar_pressure,
)
from exunet.results import measures as metrics
from exunet.simulation.peaks import Peaks
from exunet.system import from_scene, initial
from exunet.system.energy_scale import EnergyScale
from exunet.system.states import States
from reference_impl.fixed import Classical

integration = sys.modules["reference_impl.integration"]  # the package has a function of that name

EXUDYN, REFERENCE = "Exudyn's net", "reference"


@dataclasses.dataclass(frozen=True)
class Planted:
    """An error: what is wrong, in which code, the rung that fails first, and the case that shows it.

    Without a rung a test fails: `case` is module:function, which is called with `arguments`.
    """

    what: str
    code: str
    rung: int | None
    case: str
    plant: Callable
    arguments: tuple = ()


PLANTED: dict[str, Planted] = {}


def planted(rung, what, code=EXUDYN, case="planar_deployment"):
    """Enters the decorated function, which plants an error, into the list."""

    def enter(plant):
        PLANTED[plant.__name__] = Planted(what, code, rung, case, plant)
        return plant

    return enter


@planted(2, "length ratio L/L0 missing in the tension")
def no_length_ratio(patch):
    def wrong(length, reference, stiffness, maximum=np.maximum):
        return stiffness * maximum(cable.green_lagrange_strain(length, reference), 0.0)

    patch.setattr(cable, "tension", wrong)


@planted(2, "engineering strain in place of Green-Lagrange")
def engineering_strain(patch):
    patch.setattr(cable, "green_lagrange_strain", lambda length, reference: length / reference - 1.0)


@planted(2, "slack cables push")
def compression(patch):
    def wrong(length, reference, stiffness, maximum=np.maximum):
        return stiffness * cable.green_lagrange_strain(length, reference) * (length / reference)

    patch.setattr(cable, "tension", wrong)


def _other_net(patch, change):
    """Let exunet, and only it, work on a changed net."""
    right = from_scene.weave
    patch.setattr(from_scene, "weave", lambda keys: change(right(keys)))


@planted(1, "strings with the area of the net's cable")
def string_area(patch):
    _other_net(patch, lambda net: dataclasses.replace(net, area=np.full_like(net.area, net.area.min())))


@planted(1, "bullet masses left out")
def bullet_mass_lost(patch):
    def change(net):
        mass = net.mass.copy()
        mass[net.bullet_nodes] = mass[np.setdiff1d(np.arange(net.n_nodes), net.bullet_nodes)].min()
        return dataclasses.replace(net, mass=mass)

    _other_net(patch, change)


@planted(1, "one element joined to the wrong node")
def swapped_node(patch):
    def change(net):
        nodes = net.element_nodes.copy()
        nodes[7, 1] = next(k for k in range(net.n_nodes) if k not in nodes[7])
        return dataclasses.replace(net, element_nodes=nodes)

    _other_net(patch, change)


@planted(1, "whole element mass at each of its ends")
def lumping_whole(patch):
    def change(net):
        whole = np.bincount(
            net.element_nodes.ravel(),
            np.repeat(net.density * net.area * net.reference_length, 2),
            minlength=net.n_nodes,
        )
        return dataclasses.replace(net, mass=net.mass + 0.5 * whole)

    _other_net(patch, change)


def _other_damping(patch, **changes):
    right = rayleigh_damping.terms

    def wrong(keys, *rest):
        return right(keys.model_copy(update={k: f(getattr(keys, k)) for k, f in changes.items()}), *rest)

    patch.setattr(rayleigh_damping, "terms", wrong)


@planted(2, "alpha with the wrong sign")
def damping_wrong_sign(patch):
    _other_damping(patch, alpha=lambda alpha: -alpha)


@planted(2, "beta T left out of the damping")
def beta_lost(patch):
    _other_damping(patch, beta=lambda beta: 0.0)


@planted(2, "elements slightly too long in the engine alone")
def stale_length(patch):
    right = Model.cable_element

    def wrong(self, element, i, j, length, *rest, **named):
        return right(self, element, i, j, length * (1.0 + 1e-9), *rest, **named)

    patch.setattr(Model, "cable_element", wrong)


@planted(2, "factor 1/2 missing in the kinetic energy")
def kinetic_doubled(patch):
    right = States.kinetic.func
    patch.setattr(States, "kinetic", property(lambda states: 2.0 * right(states)))


@planted(2, "viscous stress that pushes", case="material_damping")
def viscous_compression(patch):
    right = cable.viscous_tension

    def wrong(length, rate, reference, stiffness, time, maximum=np.maximum, where=np.where):
        return right(length, rate, reference, stiffness, time, lambda stress, least: stress, where)

    patch.setattr(cable, "viscous_tension", wrong)


@planted(2, "T at the current state in the damping", REFERENCE)
def reference_current_tangent(patch):
    right = internal._element_forces

    def wrong(system, x, v, mode, *reels):
        push, power = right(system, x, v, mode, *reels)
        d = internal.span(system, x)
        length = np.sqrt(internal.dot(d, d))[:, None]
        along = d / np.where(length > 0.0, length, 1.0)
        rate = internal.dot(along, internal.span(system, v))
        viscous = (system.effects.beta * system.axial_stiffness * rate)[:, None] * along
        return push + internal.gather(system, internal._drag(system, v)[0] - viscous), power

    patch.setattr(internal, "_element_forces", wrong)


@planted(2, "slack cables push", REFERENCE)
def reference_compression(patch):
    right = internal._pull

    def wrong(system, d, *rest):
        return system.axial_stiffness * internal.strain_of(system, d), right(system, d, *rest)[1]

    patch.setattr(internal, "_pull", wrong)


@planted(3, "geometric part missing in the tangent stiffness", REFERENCE)
def reference_tangent_formula(patch):
    right = stiffness.tangent_element
    patch.setattr(
        stiffness, "tangent_element", lambda system, x: right(system, x) - stiffness.secant_element(system, x)
    )


@planted(3, "sign error in one block of Delta, eq. (4)", REFERENCE)
def reference_asymmetric_secant(patch):
    right = stiffness.secant_element

    def wrong(system, x):
        blocks = right(system, x)
        blocks[:, 3:, :3] *= -1.0
        return blocks

    patch.setattr(stiffness, "secant_element", wrong)


@planted(4, "weights of RK4 of the midpoint method", REFERENCE)
def reference_rk4_weights(patch):
    class Midpoint(Classical):
        def take(self, arrival):
            run = self.run
            h, t, y = arrival - run.t, run.t, run.y
            k1 = run.rate(t, y)
            run.arrive(arrival, y + h * run.rate(t + 0.5 * h, y + 0.5 * h * k1))

    patch.setitem(integration.STEPPED, "RK4", Midpoint)


def _twice(value):
    return 2.0 * value


def of_result(name, rung, what, module, function, change=_twice, case="planar_deployment"):
    """Enters an error that changes nothing but what one function returns."""

    def plant(patch):
        right = getattr(module, function)
        patch.setattr(module, function, lambda *given: change(right(*given)))

    PLANTED[name] = Planted(what, REFERENCE if name.startswith("reference") else EXUDYN, rung, case, plant)


def _negated(name):
    return lambda terms: tuple(dataclasses.replace(term, **{name: -getattr(term, name)}) for term in terms)


NO_HALF, TENSIONS = "factor 1/2 missing in the", "stored tensions twice as large"
CORIOLIS, PUSHES = "Coriolis force with the wrong sign", "mass damping that pushes on"
OTHER_SIGN, POSITIVE = "potential with the wrong sign", "stored strains of slack cables positive"
of_result("strain_without_half", 2, f"{NO_HALF} Green-Lagrange strain", cable, "green_lagrange_strain")
of_result("launch_inwards", 1, "bullets launched inwards", initial, "_launch_velocity", np.negative)
of_result("elastic_doubled", 2, f"{NO_HALF} elastic energy", cable, "elastic_energy")
of_result("tension_doubled", 2, TENSIONS, cable, "element_tension")
of_result("mouth_doubled", 6, f"{NO_HALF} area of the mouth", metrics, "mouth_area")
of_result("coriolis_sign", 2, CORIOLIS, orbit, "terms", _negated("gyroscopic"), "orbit")
of_result("mass_damping_sign", 2, PUSHES, mass_damping, "terms", _negated("damping"), "mass_damping")
of_result("reference_no_half", 2, f"{NO_HALF} Green-Lagrange strain", internal, "strain_of")
of_result("reference_kinetic_doubled", 2, f"{NO_HALF} kinetic energy", reference_energy, "kinetic")
of_result("reference_elastic_doubled", 2, f"{NO_HALF} elastic energy", reference_energy, "elastic")
of_result("reference_tension_doubled", 2, TENSIONS, forces, "tension")
of_result("reference_strain_sign", 2, POSITIVE, forces, "strain", np.abs)
of_result("reference_potential_sign", 2, OTHER_SIGN, reference_energy, "potential", np.negative, "orbit")


def other_text(owner, name, old, new):
    """The function of a module or class with a piece of its text replaced; kernels are made from texts."""
    module = sys.modules[getattr(owner, "__module__", owner.__name__)]
    text = textwrap.dedent(inspect.getsource(getattr(owner, name)))
    assert text.count(old) == 1
    wrong = text.replace(old, new)
    path = f"<{name} with an error>"
    linecache.cache[path] = (len(wrong), None, wrong.splitlines(keepends=True), path)
    space = dict(vars(module))
    exec(compile(wrong, path, "exec"), space)
    return space[name]


def of_text(name, rung, what, owner, function, old, new, case, *, users=(), arguments=()):
    """Enters an error in the text of a function, which `users` have imported."""

    def plant(patch):
        wrong = other_text(owner, function, old, new)
        for one in (owner, *users):
            patch.setattr(one, function, wrong)

    PLANTED[name] = Planted(what, EXUDYN, rung, case, plant, arguments)


SINE, COSINE = "math.sin(keys.spread_angle)", "math.cos(keys.spread_angle)"
SWAPPED = f"{COSINE} * outward + {SINE} * np.array"
DRAG_OF_BULLETS, AREAS = "0.5 * keys.density * keys.bullet_drag_coefficient", "areas[net.bullet_nodes] +="
of_text("barrels_swapped", 2, "sine and cosine of the barrels swapped", launch_force, "barrels",
         f"{SINE} * outward + {COSINE} * np.array", SWAPPED, "launch_spring")  # fmt: skip
of_text("air_drag_sign", 2, "air drag across the axis with the wrong sign", air_drag, "add_cross_flow",
         "force[i + 1] -= factor * uy", "force[i + 1] += factor * uy", "air_drag")  # fmt: skip
of_text("bullet_drag_doubled", 2, "factor 1/2 missing in the drag of bullets", air_drag, "terms",
         DRAG_OF_BULLETS, DRAG_OF_BULLETS.replace("0.5 * ", ""), "air_drag")  # fmt: skip
of_text("bullets_as_cables", 2, "bullets with the drag coefficient of cables", air_drag, "terms",
         DRAG_OF_BULLETS, DRAG_OF_BULLETS.replace("bullet_drag", "drag"), "air_drag")  # fmt: skip
of_text("bullet_area_dropped", 2, "no area of bullets in gas and light", surface,
         "tumbling_areas", AREAS, f"{AREAS} 0.0 *", "two_body",
         users=(molecular_drag, solar_pressure))  # fmt: skip
of_text("one_length_in_bending", 2, "one of two lengths at a joint", bending, "springs",
         "length.mean(axis=1)", "length[:, 0]", "bending_thread")  # fmt: skip
of_text("strings_bend_with_cables", 2, "strings of equal section bend with cables", bending, "_in_the_net",
         "net.is_string[e] == net.is_string[f] and ", "", "bending")  # fmt: skip
of_text("break_at_whole_strain", 4, "free strain ignored at a break", cable_term, "breaking_lengths",
         "free = 0.0 if changes.free_strain is None else changes.free_strain", "free = 0.0",
         "breaking")  # fmt: skip
of_text("peak_one_step_off", None, "the largest tension at the time of the state before", Peaks, "look",
         "float(time[state])", "float(time[state - 1])",
         "test_peaks:test_keeps_the_largest_and_forgets_the_later_ones")  # fmt: skip
of_text("potential_from_zero", None, "a potential at the start counts as gained", EnergyScale, "gained",
         "states.potential - self._potential", "states.potential",
         "test_guards:test_a_potential_at_the_start_does_not_count_in_the_energy_scale")  # fmt: skip


@planted(4, "a stage of the compiled loop at the time of the step's start", case="launch_gas")
def stage_time(patch):
    right = schemes.runge_kutta_4_step
    old = "stage(t + 0.5 * h, h, s.x1, s.v3"
    wrong = other_text(schemes, right.__name__, old, old.replace("t + 0.5 * h", "t", 1))
    steps = tuple(wrong if one is right else one for one in compiled.STEPS)
    patch.setattr(compiled, "STEPS", steps)


def _with_bodies(patch):
    right = metrics.centre_of_mass

    def wrong(result):
        mass = result.net.mass.sum()
        total = mass + sum(body.mass for body in result.bodies.values())
        beside = sum(body.mass * body.position for body in result.bodies.values())
        return (mass * right(result) + beside) / total

    patch.setattr(metrics, "centre_of_mass", wrong)
    patch.setattr(sys.modules["test_effects"], "centre_of_mass", wrong)


OF_LAUNCH = "test_effects:test_a_launch_by_force_keeps_momentum_and_does_its_work"
PLANTED["chaser_in_the_centre"] = Planted(
    "the chaser counts in the net's centre of mass", EXUDYN, None, OF_LAUNCH, _with_bodies,
    ({"kind": "spring", "force": 9.0, "stroke": 0.05, "spread_angle": 0.2, "chaser_mass": 5.0}, "connectors"),
)  # fmt: skip
