"""Short runs of a scene before the run, that show which fixed step it needs.

Velocity Verlet for metrics. Its energy error in snaps decides. It goes with the square of the step, and does
not last where threads are damped: what it adds to the fast modes is dissipated soon. So the net of a scene is
run from its just taut configuration, every node with as much kinetic energy, in NumPy: all threads snap, and
the energy error and the dissipated energy of some ten periods of the fastest mode set the step. Of a large
net the part around its fastest element is run: snaps are local, and energies are compared within the part.

RK44 of scenes with bodies. A fifth of the stable step keeps a net within the guards, 5 % of the energy
that can deform it, but not its energy balance: at each snap the force has a kink, and RK44 loses its order.
Frequencies do not give the number and strength of snaps: of the shipped scenes some need no smaller step for
1e-5, one a sixty-fourth. So the scene is run in the compiled loop, with half the step each time, until the
energy balance holds.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from exunet.base.arrays import Floats, Ints
from exunet.base.errors import RunStopped
from exunet.forces.cable import AxialLaw, elastic_energy, element_tension, lengths, spans
from exunet.integrators.compiled.loop import CompiledStepper, loop_kernel
from exunet.integrators.protocol import IntegrationFailed
from exunet.kernels.compile import numba_installed
from exunet.kernels.kernel import Kernel
from exunet.methods.method import METHODS, Method, Plan
from exunet.model.limits import SAFETY, largest_damping_rate, largest_frequency, stable_step
from exunet.model.system import State, System
from exunet.net.arrays import Net
from exunet.scene.scene import Scene
from exunet.simulation.block import Observed
from exunet.simulation.guards import LEAST_ENERGY, Guards
from exunet.simulation.integrate import Integration
from exunet.simulation.observers import Observer, Observers

# Largest part of the stable step for metrics. Undamped, the paper's net has energy errors of 0.003, 0.023 and
# 0.049 at 0.1, 0.2 and 0.3 of its stable step (to 2 s), of 0.005, 0.008 and 0.031 with meshes of 0.5 m. A net
# of 10 m with material damping has 0.004, 0.002, 0.005 and 0.013 at 0.2, 0.3, 0.4 and 0.5.
LARGEST_PART = 0.4
LARGEST_NET = 5000  # elements, up to which the whole net is run: 500 steps take some 3 s
RADIANS, STEPS = 50.0, 500  # of the short run: angle of the fastest mode, and steps at most
SLOW = 1e-4  # largest speed of the short run over that of waves in threads: strains stay small
# Energy error (rms, of the kinetic energy at the start) of the short run that is allowed without damping, and
# for each part of that energy that is dissipated in it.
ALLOWED, OF_DISSIPATED = 1e-3, 0.05


def part_of_stable_step(system: System) -> float:
    """Return the part of the stable step of VelocityVerlet for metrics, from a short run of the net.

    Between `SAFETY`, that undamped nets need, and `LARGEST_PART`; to two digits, so that round-off does not
    change it.
    """
    count, linear = system.net.n_net_elements, system.forces.linear
    if not count or not (1.0 / system.inert_mass[: system.net.n_nodes]).any():
        return SAFETY  # tethers do not have a reference configuration
    net, law, nodes = system.net, system.forces.cable.law, np.arange(system.net.n_nodes)
    if count > LARGEST_NET:
        net, law, nodes = _around_fastest_element(system)
        count = len(net.element_nodes)
    mass = system.inert_mass[nodes, None]
    inverse = 1.0 / mass  # zero of what is held
    of_net = np.where(np.arange(len(net.element_nodes)) < count, law.stiffness, 0.0)
    elastic, moving = replace(law, stiffness=of_net, relaxation_time=None), np.where(inverse, mass, 0.0)
    own = (3 * nodes[:, None] + np.arange(3)).ravel()
    viscosity = None if linear is None or linear.damping is None else linear.damping[own][:, own]
    i, j = net.element_nodes[:count].T

    def forces(x: Floats, v: Floats) -> tuple[Floats, float]:
        """Forces [N], and the power of damping [W]."""
        length, along, parting = lengths(net, x), spans(net, x)[:count], spans(net, v)[:count]
        pull = element_tension(net, law, x, v, length)[:count] / length[:count]
        viscous = pull - element_tension(net, elastic, x, v, length)[:count] / length[:count]
        force = np.zeros_like(x)
        for axis, part in enumerate((pull[:, None] * along).T):
            force[:, axis] = np.bincount(i, part, len(x)) - np.bincount(j, part, len(x))
        drag = np.zeros_like(v) if viscosity is None else (viscosity @ v.ravel()).reshape(v.shape)
        return force - drag, float(viscous @ np.einsum("ea,ea->e", along, parting) + np.sum(v * drag))

    def energy(x: Floats, v: Floats) -> float:
        return float(0.5 * np.sum(moving * v**2) + elastic_energy(elastic, lengths(net, x)))

    frequency, axes = largest_frequency(system), system.blocks.poses.net
    step = SAFETY * stable_step(Method.VELOCITY_VERLET, frequency, largest_damping_rate(system))
    x = net.reference_position @ axes.T
    golden = (own + 1.0).reshape(x.shape) * 0.5 * (3.0 - math.sqrt(5.0))
    v = np.sin(2.0 * math.pi * golden) @ axes.T * np.sqrt(inverse)
    waves = math.sqrt(float(np.median(law.stiffness[:count] * law.natural_length[:count])) / moving.mean())
    v *= SLOW * waves / np.abs(v).max()
    first, dissipated, errors = energy(x, v), 0.0, []
    force, power = forces(x, v)
    for _ in range(min(STEPS, math.ceil(RADIANS / (frequency * step)))):
        half = v + 0.5 * step * inverse * force
        x = x + step * half
        force, _ = forces(x, half)
        v = half + 0.5 * step * inverse * force
        _, after = forces(x, v)
        dissipated += 0.5 * step * (power + after)
        power = after
        errors.append((energy(x, v) + dissipated) / first - 1.0)
    error = math.sqrt(np.mean(np.square(errors)))
    part = SAFETY * math.sqrt((ALLOWED + OF_DISSIPATED * max(0.0, dissipated / first)) / max(error, 1e-12))
    return round(min(LARGEST_PART, max(SAFETY, part)), 2) if math.isfinite(part) else SAFETY


def _around_fastest_element(system: System) -> tuple[Net, AxialLaw, Ints]:
    """Return the `LARGEST_NET` elements nearest to that with the highest frequency, their law and nodes."""
    net, law = system.net, system.forces.cable.law
    pairs = net.element_nodes[: net.n_net_elements]
    rate = law.stiffness[: len(pairs)] / law.natural_length[: len(pairs)]
    fastest = np.argmax(rate * (1.0 / system.inert_mass)[pairs].max(axis=1))
    middle = net.reference_position[pairs].mean(axis=1)
    away = np.linalg.norm(middle - middle[fastest], axis=1)
    elements = np.sort(np.argsort(away, kind="stable")[:LARGEST_NET])
    nodes, numbers = np.unique(pairs[elements], return_inverse=True)
    part = replace(
        net,
        element_nodes=numbers.reshape(-1, 2),
        reference_position=net.reference_position[nodes],
        tethers=(),
    )
    return part, law.of_elements(elements), nodes


# Evaluations of elements that pilot runs may take, some seconds.
MOST = 2e8
BOOK = 1e-5  # largest error of the energy book at the stored times, over the energy scale
MARGIN = 2.0  # for Exudyn, whose errors are those of the compiled loop until round-off has moved the snaps
_CALL = 21.0  # elements that take as long as the rest of a right-hand side


def with_step(scene: Scene, system: System, state: State, plan: Plan) -> Plan:
    """Return the plan with the longest of its step, a half, a quarter ... that keeps the energy balance.

    plan : of RK44, with the step from the frequencies of the scene
    """
    assert plan.step is not None
    if why := step_pilot_excluded(scene):
        words = f"energy balance of this step within the bound of the guards only: {why}"
        return replace(plan, notes=(*plan.notes, words))
    times, kernel = scene.time.stored_times, loop_kernel(system)
    step, found, tried = plan.step, math.inf, 0.0
    while found > BOOK / MARGIN:
        steps = float(np.ceil(np.diff(times) / step - 1e-9).sum())
        tried += METHODS[plan.method].compiled_stages * steps * (system.net.n_elements + _CALL)
        if tried > MOST:
            words = f"energy balance to {BOOK:g} not ensured: pilot runs took too long"
            if math.isfinite(found):
                words += f"; with steps of {2.0 * step:.4g} s its error was {found:.1g}"
            return replace(plan, step=min(2.0 * step, plan.step), notes=(*plan.notes, words))
        found = _error(replace(plan, step=step), system, state, times, kernel)
        step *= 0.5
    taken = 2.0 * step  # of the last run
    part = "that" if taken == plan.step else f"1/{plan.step / taken:g} of that, {taken:.4g} s,"
    words = f"{part} keeps the energy balance to {BOOK:g}: {found:.1g} in a compiled pilot run"
    return replace(plan, step=taken, notes=(*plan.notes, words))


def step_pilot_excluded(scene: Scene) -> str:
    """Return why pilot runs are excluded; "" if they are not."""
    if not numba_installed():
        return "Numba is not installed"
    if any(effect.COLLIDES for effect in scene.effects.on.values()):
        return "with contact, pilot runs would take too long"
    return ""


def _error(plan: Plan, system: System, state: State, times: Floats, kernel: Kernel) -> float:
    """Run a pilot; return the largest error of its energy balance over the scale, infinite if it stopped."""
    balance = _Balance(system, state)

    def make(state: State, plan: Plan) -> CompiledStepper:
        return CompiledStepper(system, state, plan, kernel)

    run = Integration(plan, make, Observers(system, state, {"balance": balance}))
    try:
        run.go(times[1:].tolist(), run.settle)
    except (RunStopped, IntegrationFailed):
        return math.inf
    return balance.error


class _Balance(Observer):
    """Observer of a pilot run; sees the last state of each block.

    off : largest error of the energy balance so far [J]
    """

    def __init__(self, system: System, state: State) -> None:
        self._guards = Guards(system, state)
        self._left = system.lost_at_start + float(system.given_work(state.first_order))
        self.off = 0.0

    @property
    def error(self) -> float:
        """Largest error over the energy scale; round-off counts as 0 where nothing can deform."""
        if scale := self._guards.scale:
            return self.off / scale
        return 0.0 if self.off <= LEAST_ENERGY else math.inf

    def observe(self, steps: Observed) -> None:
        now = steps.states[-1:]
        assert now.taken is not None  # the compiled loop sums it
        look = self._guards.look(now, self._left + now.taken - now.given_work)
        self._guards.gained = look.gained[:, 0]
        off = float(abs(look.balance[0] + look.of_bodies[0]))
        if off <= look.round_off[0]:
            return
        self.off = max(self.off, off) if math.isfinite(off) else math.inf
