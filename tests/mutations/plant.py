"""Plants the errors of exunet.verification.planted, one at a time, with pytest's monkeypatch."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np

import exunet.simulation.preparation
import exunet.system.initial
import reference_impl.energy as reference_energy
import reference_impl.forces as forces
from exunet.backends.exudyn.model import Model
from exunet.forces import cable
from exunet.forces.effects import mass_damping, orbit, rayleigh_damping
from exunet.results import measures as metrics
from exunet.system import energy

march = sys.modules["reference_impl.march"]  # the package has a function of that name


def strain_without_half(patch):
    right = cable.green_lagrange_strain
    patch.setattr(cable, "green_lagrange_strain", lambda length, reference: 2.0 * right(length, reference))


def no_length_ratio(patch):
    def wrong(length, reference, stiffness, maximum=np.maximum):
        return stiffness * maximum(cable.green_lagrange_strain(length, reference), 0.0)

    patch.setattr(cable, "tension", wrong)


def engineering_strain(patch):
    patch.setattr(cable, "green_lagrange_strain", lambda length, reference: length / reference - 1.0)


def compression(patch):
    def wrong(length, reference, stiffness, maximum=np.maximum):
        return stiffness * cable.green_lagrange_strain(length, reference) * (length / reference)

    patch.setattr(cable, "tension", wrong)


def _other_net(patch, change):
    """Let exunet, and only it, work on a changed net."""
    right = exunet.simulation.preparation.weave
    patch.setattr(exunet.simulation.preparation, "weave", lambda keys: change(right(keys)))


def string_area(patch):
    _other_net(patch, lambda net: dataclasses.replace(net, area=np.full_like(net.area, net.area.min())))


def bullet_mass_lost(patch):
    def change(net):
        mass = net.mass.copy()
        mass[net.bullet_nodes] = mass[np.setdiff1d(np.arange(net.n_nodes), net.bullet_nodes)].min()
        return dataclasses.replace(net, mass=mass)

    _other_net(patch, change)


def swapped_node(patch):
    def change(net):
        nodes = net.element_nodes.copy()
        nodes[7, 1] = next(k for k in range(net.n_nodes) if k not in nodes[7])
        return dataclasses.replace(net, element_nodes=nodes)

    _other_net(patch, change)


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


def damping_wrong_sign(patch):
    _other_damping(patch, alpha=lambda alpha: -alpha)


def beta_lost(patch):
    _other_damping(patch, beta=lambda beta: 0.0)


def launch_inwards(patch):
    right = exunet.system.initial._launch_velocity
    patch.setattr(exunet.system.initial, "_launch_velocity", lambda launch, net: -right(launch, net))


def stale_length(patch):
    right = Model.cable_element

    def wrong(self, i, j, length, *rest, **named):
        return right(self, i, j, length * (1.0 + 1e-9), *rest, **named)

    patch.setattr(Model, "cable_element", wrong)


def _doubled(patch, module, name):
    right = getattr(module, name)
    patch.setattr(module, name, lambda *state: 2.0 * right(*state))


def kinetic_doubled(patch):
    _doubled(patch, energy, "kinetic")


def elastic_doubled(patch):
    _doubled(patch, energy, "elastic")


def tension_doubled(patch):
    _doubled(patch, cable, "element_tension")


def mouth_doubled(patch):
    _doubled(patch, metrics, "mouth_area")


def _other_terms(patch, effect, change):
    right = effect.terms
    patch.setattr(effect, "terms", lambda *keys: change(right(*keys)))


def coriolis_sign(patch):
    _other_terms(patch, orbit, lambda terms: dataclasses.replace(terms, gyroscopic=-terms.gyroscopic))


def mass_damping_sign(patch):
    _other_terms(patch, mass_damping, lambda terms: dataclasses.replace(terms, damping=-terms.damping))


def viscous_compression(patch):
    right = cable.viscous_tension

    def wrong(length, rate, reference, stiffness, time, maximum=np.maximum, where=np.where):
        return right(length, rate, reference, stiffness, time, lambda stress, least: stress, where)

    patch.setattr(cable, "viscous_tension", wrong)


def reference_potential_sign(patch):
    right = reference_energy.potential
    patch.setattr(reference_energy, "potential", lambda *state: -right(*state))


def reference_kinetic_doubled(patch):
    _doubled(patch, reference_energy, "kinetic")


def reference_elastic_doubled(patch):
    _doubled(patch, reference_energy, "elastic")


def reference_tension_doubled(patch):
    _doubled(patch, forces, "tension")


def reference_strain_sign(patch):
    right = forces.strain
    patch.setattr(forces, "strain", lambda system, x: np.abs(right(system, x)))


def reference_current_tangent(patch):
    right = forces._element_forces

    def wrong(system, x, v):
        push, power = right(system, x, v)
        d = forces.span(system, x)
        length = np.sqrt(forces.dot(d, d))[:, None]
        along = d / np.where(length > 0.0, length, 1.0)
        rate = forces.dot(along, forces.span(system, v))
        viscous = (system.effects.beta * system.axial_stiffness * rate)[:, None] * along
        return push + forces.gather(system, forces._drag(system, v)[0] - viscous), power

    patch.setattr(forces, "_element_forces", wrong)


def reference_no_half(patch):
    right = forces._strain
    patch.setattr(forces, "_strain", lambda system, d: 2.0 * right(system, d))


def reference_compression(patch):
    right = forces._pull

    def wrong(system, d, v):
        return system.axial_stiffness * forces._strain(system, d), right(system, d, v)[1]

    patch.setattr(forces, "_pull", wrong)


def reference_tangent_formula(patch):
    right = forces.tangent_element
    patch.setattr(
        forces, "tangent_element", lambda system, x: right(system, x) - forces.secant_element(system, x)
    )


def reference_asymmetric_secant(patch):
    right = forces.secant_element

    def wrong(system, x):
        blocks = right(system, x)
        blocks[:, 3:, :3] *= -1.0
        return blocks

    patch.setattr(forces, "secant_element", wrong)


def reference_rk4_weights(patch):
    from reference_impl.fixed import whole_steps

    def midpoint(state, step):
        def take(arrival):
            h, t, y = arrival - state.t, state.t, state.y
            k1 = state.rate(t, y)
            state.arrive(arrival, y + h * state.rate(t + 0.5 * h, y + 0.5 * h * k1))

        return lambda end: whole_steps(state, step, end, take)

    patch.setitem(march.STEPPED, "RK4", midpoint)
