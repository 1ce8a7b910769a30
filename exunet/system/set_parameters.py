"""What `do = "set"` of a script changes: inputs of forces, memories, and the energy that goes with it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.case.script import Entry
from exunet.forces.cable_term import INTACT
from exunet.forces.closing import MEMORY as LINE
from exunet.forces.closing import elastic_once_slid
from exunet.forces.contact.spheres import SphereContact
from exunet.forces.contact.threads import ThreadContact
from exunet.forces.effects.thrust import MEMORY as THRUST
from exunet.forces.effects.thrust import with_factor
from exunet.forces.reel import command_name
from exunet.forces.terms import Input, KernelTerm, Memories, copied
from exunet.forces.total import Forces
from exunet.net.closing import NAME as CLOSING
from exunet.net.drive import WITHOUT_LIMIT
from exunet.system.system import System

Floats = NDArray[np.float64]

_FRICTION = ("contact.friction", f"{CLOSING}.friction")


def input_name(parameter: str) -> str:
    """Of the input by which a script sets a coefficient of friction."""
    return f"set/{parameter}"


def inputs_of(entries: Iterable[Entry]) -> frozenset[str]:
    """The names of those that entries set."""
    return frozenset(input_name(one.on) for one in entries if one.do == "set" and one.on in _FRICTION)


def with_inputs(forces: Forces, entries: Iterable[Entry]) -> Forces:
    """The forces, of which those that entries set have inputs for that; elements that may become softer."""
    names = inputs_of(entries)
    kernels = tuple(_with_friction(term, names) for term in forces.kernels)
    softer = any(one.do == "set" and (one.on or "").endswith(".youngs_modulus") for one in entries)
    cable = replace(forces.cable, may_be_cut=True) if softer else forces.cable
    return replace(forces, kernels=kernels, cable=cable)


def _with_friction(term: KernelTerm, names: frozenset[str]) -> KernelTerm:
    data: Any = term.data
    touches = isinstance(data, ThreadContact | SphereContact)
    drawn = term.memory is not None and term.memory.name == LINE
    name = input_name(_FRICTION[0] if touches else _FRICTION[1])
    if not (touches or drawn) or name not in names:
        return term
    return replace(term, inputs=(*term.inputs, Input(name, "friction", np.array([data.friction]))))


def changed(
    system: System, parameter: str, value: float, now: tuple[float, Floats, Floats], every: Memories
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What of a `Change` a parameter's new value makes, and what is told of it.

    now : time [s], and x, v of all blocks
    """
    name, _, what = parameter.rpartition(".")
    if parameter == "thrust.factor":
        return {"others": {THRUST: with_factor(every[THRUST], value)}}, {}
    if what == "friction":
        others = {"others": {input_name(parameter): np.array([value])}}
        return _slid(system, value, now, every, others) if name == CLOSING else (others, {})
    if what == "youngs_modulus":
        elements = np.array(system.net.tether_elements[name])
        part, after = value / system.net.youngs_modulus[elements], every[INTACT].copy()
        after[elements] = np.where(after[elements] > 0.0, part, 0.0)
        return {"others": {INTACT: after}, "energy_lost": None}, {}
    return _asked(name, what, value, every[command_name(name)])


def _asked(drive: str, what: str, value: float, asked: Floats) -> tuple[dict[str, Any], dict[str, Any]]:
    """The command of a drive with another force or rate; a drive that has none goes on as it was."""
    after, has = asked.copy(), 0.0 < abs(asked[1]) < WITHOUT_LIMIT if what == "rate" else asked[3] > 0.0
    if asked[0] == 0.0 or not has:
        words = f"set {drive}.{what}, which changes nothing: what {drive} does has no {what}"
        return {}, {"event": words}
    if what == "rate":
        after[1] = np.copysign(value, asked[1])
    else:
        after[2] = value
    return {"others": {command_name(drive): after}}, {}


def _slid(
    system: System,
    friction: float,
    now: tuple[float, Floats, Floats],
    every: Memories,
    what: dict[str, Any],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A closing line that slides at once, as rings hold it less: friction takes what it stores less."""
    time, x, v = now
    moving = system.layout.unpack(x.copy(), v.copy()).completed(system.kinematics, time, every)
    x, v = system.layout.pack(moving)
    (term,) = (one for one in system.forces.kernels if one.memory is not None and one.memory.name == LINE)
    line: Any = copied(term.data_at(every)[0])
    taken = elastic_once_slid(x, line, line.friction) - elastic_once_slid(x, line, friction)
    first = int(line.state[0])  # wound up, work, what friction took, elastic energy
    x[first + 2] += taken
    x[first + 3] -= taken
    return {**what, "x": x, "v": v, "work_given": -taken}, {"energy_taken_J": taken}
