"""Rung 10: what closes the mouth of a net in both codes, at random states and over whole runs.

The reference was written from the page of the case format alone: one energy of way and length, of which
forces, tension and the work of the winch are derivatives; its own way round the net's edge
(`reference_impl.closing`, `rim`). A line with friction is not in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from exunet.forces.terms import copied
from exunet.model.system import State
from exunet.net.closing import NAME
from exunet.studies.both_codes import BothCodes, read_both
from exunet.verification.balances import OWN, THEIRS, changes, energies
from exunet.verification.bodies import STATES, motions
from exunet.verification.check import Check, difference, shipped, worst_of
from exunet.verification.horizon import ROUND_OFF, best_plan, growth
from exunet.verification.states import KINDS, measures, random_instants
from exunet.verification.tolerances import (
    CLOSED_ENERGY,
    CLOSED_RUN,
    CLOSED_WORK,
    CLOSING,
    CLOSING_COUNT,
    DISSIPATED,
)
from exunet.verification.topology import topology
from reference_impl import closing as theirs_of
from reference_impl.energy import of_closing

CLOSING_CASES = "verification/closing"  # below cases/
SEED = 20261124
INSTANTS = 12  # of a run, evenly spaced up to the horizon
QUANTITIES = {
    "rate of what is wound up, or of the part left": "m/s or 1/s",
    "power of what closes": "W",
    "power taken by viscous stress": "W",
    "energy stored": "J",
}


def closing_cases(named: Sequence[BothCodes]) -> list[BothCodes]:
    """The named cases, and the shipped ones that are not among them."""
    there = {case.path.resolve() for case in named}
    others = (path for path in shipped(CLOSING_CASES).values() if path.resolve() not in there)
    return [*named, *map(read_both, others)]


def at_states(case: BothCodes, states_of_a_kind: int = STATES) -> Iterator[Check]:
    """Masses; accelerations in every form, energies and momenta; what drives the line, takes and stores."""
    yield from topology(case)
    yield from motions(case, states_of_a_kind)
    yield from measures(case, states_of_a_kind)
    yield from laws(case, states_of_a_kind)


def laws(case: BothCodes, states_of_a_kind: int = STATES) -> Iterator[Check]:
    """`QUANTITIES`, as the law is written and in the reference, each of the kind that differs most.

    exunet's functions are called as they are; every form makes its own from their text.
    """
    random, count = np.random.default_rng(SEED), states_of_a_kind * len(KINDS)
    found: dict[str, list[Check]] = {name: [] for name in QUANTITIES}
    taut = 0
    for kind in KINDS:
        states = list(random_instants(case.start, kind, states_of_a_kind, random))
        ours = np.array([_of_exunet(case, state) for state in states])
        theirs = np.array([_of_reference(case, state) for state in states])
        taut += int(np.count_nonzero(theirs[:, -1] > 0.0))
        for k, (name, unit) in enumerate(QUANTITIES.items()):
            a, b = ours[:, k], theirs[:, k]
            found[name].append(difference(kind, a, b, CLOSING, ("state",), unit))
    for name, checks in found.items():
        yield worst_of(f"{name}, {count} random states", checks)
    yield Check("states in which nothing pulls", float(taut == 0), CLOSING_COUNT, f"{taut} of {count} pull")


def _of_exunet(case: BothCodes, state: State) -> list[float]:
    """`QUANTITIES`."""
    system = case.start.system
    (term,) = (
        term
        for term in system.forces.kernels
        if term.memory is not None and term.memory.name.startswith(f"{NAME}/")
    )
    assert term.memory is not None and term.memory.data is not None  # noqa: PT018
    data = copied(term.memory.data(state.memory[term.memory.name]))  # which has work space
    x, v = system.layout.pack(state.moving)
    force = np.zeros(system.blocks.n_force)
    term.add(state.time, x, v, data, force)
    assert term.potential is not None
    stored = float(term.potential(x, data))
    first = system.blocks.rate(f"{NAME}/{'part' if system.line is None else 'wound_up'}")
    taken = 0.0 if term.power is None else float(term.power(state.time, x, v, data))
    if any(item.name == f"{NAME}/viscosity" for item in system.blocks.states):
        taken = float(force[system.blocks.rate(f"{NAME}/viscosity")])
    return [float(force[first]), float(force[first + 1]), taken, stored]


def _of_reference(case: BothCodes, state: State) -> list[float]:
    """`QUANTITIES`."""
    system, theirs = case.theirs.system, case.theirs_at(state.moving)
    drawn = case.drawn_in_reference(state.first_order)
    closing, amount = system.closing, float(drawn.amount[0])
    assert closing is not None
    stored = float(of_closing(system, theirs.x, drawn)[1])
    order = theirs_of.order_at(closing, state.time)
    if isinstance(closing, theirs_of.Line):
        pulled = theirs_of.pull(system, closing, order, theirs.x, theirs.v, amount)
        return [pulled.rate, pulled.power, pulled.taken, stored]
    threads = theirs_of.shrink(system, closing, order, theirs.x, theirs.v, amount)
    rate = -closing.rate if threads.rate.any() else 0.0
    return [rate, float(threads.power.sum()), threads.taken, stored]


def over_a_run(case: BothCodes) -> Iterator[Check]:
    """Places, what is wound up, its work, energies and what left, at times up to the horizon of rung 7.

    exunet's quickest form with its best method, and the reference with its own.
    """
    grown = growth(case, amplitudes=(ROUND_OFF,))
    end = min(grown.horizon, float(grown.time[-1]))
    times = np.linspace(0.0, end, INSTANTS + 1)
    ours = case.fastest().run_exunet(times, best_plan(case, OWN[1]), booked=True)
    rtol, atol = THEIRS[0]
    theirs = case.run_reference(times, rtol=rtol, atol=atol)
    until = f"to t = {end:.3g} s"
    a, b, points = ours.position, theirs.position, ("instant", "point", "xyz")
    yield difference(f"places {until}", a, b, CLOSED_RUN, points, "m", scale=case.size)
    what, unit = ("part left", "") if case.start.system.line is None else ("length wound up", "m")
    one, other, axes = ours.drawn, theirs.drawn, ("instant", "line")
    yield difference(f"{what} {until}", one.amount, other.amount, CLOSED_RUN, axes, unit)
    yield difference(f"work of what closes {until}", one.work, other.work, CLOSED_WORK, axes, "J")
    moving = energies(case, theirs, CLOSED_ENERGY).scale
    if ours.dissipated is not None and theirs.dissipated is not None:
        left = ours.dissipated, theirs.dissipated
        yield difference(f"energy that left {until}", *left, DISSIPATED, ("instant",), "J", scale=moving)
    # Viscous work is summed by Simpson's rule in exunet (see `BOOKED`): what left is compared, just above.
    codes = [("reference", theirs)]
    if not case.start.system.forces.cable.viscous:
        codes.append(("exunet", ours))
    for code, motion in codes:
        yield from changes([energies(case, motion, CLOSED_ENERGY)], times, code)
