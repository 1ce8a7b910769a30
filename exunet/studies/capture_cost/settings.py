"""The settings of a capture that are compared: steps or tolerances, stiffness of contact, divisions, forms.

Each differs from the case in one thing. A step follows what makes the motion faster: with contact that is
stiffer by a factor it is as much shorter, since its damping bounds the step by its rate; with shorter
elements it stays the same part of the stable step. All runs are of equal steps or of a tolerance, as the
case's, in the compiled loop, but for the two forms of Exudyn's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

from exunet.base.errors import CaseError
from exunet.case.casefile import Case, parse_case
from exunet.codegen.compile import require_numba
from exunet.methods.method import Form
from exunet.methods.plan import Plan
from exunet.net.base import ThrownNetTable
from exunet.simulation.preparation import Start, in_the_compiled_loop, prepare_case
from exunet.system.stability import largest_damping_rate, largest_frequency, stable_step

_STEPS = {4.0: "step x 4", 2.0: "step x 2", 1.0: "step x 1", 0.5: "step x 1/2", 0.25: "step x 1/4"}
_TOLERANCES = {
    10.0: "tolerance x 10",
    1.0: "tolerance x 1",
    0.1: "tolerance x 1/10",
    0.01: "tolerance x 1/100",
}
_STIFFNESSES = {0.5: "contact x 1/2", 2.0: "contact x 2"}
_DIVISIONS = 2
MOST_SETTINGS = len(_STEPS) + len(_STIFFNESSES) + 1  # of a case, that have moved starts
_NEXT = 1.6  # a run of DOPRI5 at a tenth of the tolerance costs at most this much more
_CONTACT = ("stiffness", "node_stiffness", "bullet_stiffness", "body_stiffness", "modulus")
_NO_RETRY = "retry=0"  # a setting that fails is not continued with another one


class Knob(StrEnum):
    """What a setting changes."""

    SIZE = "step or tolerance"
    STIFFNESS = "stiffness of contact"
    DIVISIONS = "divisions"
    FORM = "form"


@dataclass(frozen=True)
class CaptureSetting:
    """One way to run a capture.

    knob     : what it changes
    name     : in words
    changes  : "key=value" that make it of the case, but for the solver and the form
    solver   : keys of [solver] as they stand in a table
    size     : its step [s] or tolerance [m, m/s]
    work     : about how many times the work of the case as it is
    form     : in which it runs
    refused  : why it cannot be run; "": it can
    """

    knob: Knob
    name: str
    solver: str = ""
    size: float = 0.0
    work: float = 1.0
    changes: tuple[str, ...] = ()
    form: Form = Form.COMPILED
    refused: str = field(default="", compare=False)

    @property
    def alone(self) -> bool:
        """True of a form of Exudyn's: it runs once, from the start as it is, and is not recommended."""
        return self.form != Form.COMPILED

    @property
    def overrides(self) -> tuple[str, ...]:
        """Values of `--set` that run it."""
        engine = ",".join(f'{key}="{value}"' for key, value in _keys(self.form).items())
        return (*self.changes, f"solver={{{self.solver}}}", f"engine={{{engine}}}")

    def start(self, case: Case) -> Start:
        """The case at its start with this setting; raises CaseError where it cannot have it."""
        *changes, solver, engine = self.overrides
        once = solver.removesuffix("}") + f",{_NO_RETRY}}}"
        return prepare_case(changed(case, *changes, once, engine))


def _keys(form: Form) -> dict[str, str]:
    """Of [engine]; the compiled loop has one form of the net and of contact."""
    return {"loop": "compiled"} if form == Form.COMPILED else {"loop": "exudyn", "net": form.value}


def changed(case: Case, *changes: str) -> Case:
    """The case with further overrides."""
    return parse_case(case.text, case.path, (*case.overrides, *changes))


def stiffer(case: Case, factor: float) -> tuple[str, ...]:
    """Overrides that make contact stiffer by a factor; () without contact."""
    contact = getattr(case.scene.effects, "contact", None)
    keys = {name: getattr(contact, name, None) for name in _CONTACT}
    return tuple(
        f"effects.contact.{name}={value * factor!r}" for name, value in keys.items() if value is not None
    )


def following(factor: float) -> float:
    """By which a step is multiplied where contact is stiffer by a factor."""
    return 1.0 / max(factor, 1.0)


def divided(case: Case, factor: int) -> tuple[str, ...]:
    """Overrides that divide the sides of the meshes, and strings, into more elements."""
    net = case.scene.net
    found = [f"net.divisions={factor * net.divisions}"]
    if isinstance(net, ThrownNetTable) and net.strings is not None:
        found.append(f"net.strings.divisions={factor * net.strings.divisions}")
    return tuple(found)


def settings_of(case: Case) -> list[CaptureSetting]:
    """Those of a case, the case as it is among them (`the_case`); raises MissingExtra without Numba."""
    require_numba("the study of a capture")
    start = in_the_compiled_loop(prepare_case(case))
    plan, contact = start.plan, bool(stiffer(case, 1.0))
    found = _sizes(start)
    for factor, name in _STIFFNESSES.items() if contact else ():
        size, work = _sized(plan, 1.0 if plan.step is None else following(factor))
        found.append(
            CaptureSetting(Knob.STIFFNESS, name, solver(plan, size), size, work, stiffer(case, factor))
        )
    found.append(_with_divisions(case, start))
    size, _ = _sized(plan, 1.0)
    found += [
        CaptureSetting(Knob.FORM, form.value, solver(plan, size), size, 1.0, (), form)
        for form in (Form.FUSED, Form.CONNECTORS)
    ]
    return found


def the_case(settings: list[CaptureSetting]) -> CaptureSetting:
    """The one that has the numbers of the case, in the compiled loop."""
    return next(one for one in settings if one.knob == Knob.SIZE and one.work == 1.0)


def _sizes(start: Start) -> list[CaptureSetting]:
    """Steps up to the stable one, or tolerances, the coarsest first."""
    plan, found = start.plan, list[CaptureSetting]()
    for factor, name in (_STEPS if plan.step is not None else _TOLERANCES).items():
        if plan.step is None or factor <= 1.0 or factor * plan.step <= stable_of(start):
            size, work = _sized(plan, factor)
            found.append(CaptureSetting(Knob.SIZE, name, solver(plan, size), size, work))
    return found


def _with_divisions(case: Case, start: Start) -> CaptureSetting:
    """The net of shorter elements, with the same part of its stable step."""
    plan, changes, name = start.plan, divided(case, _DIVISIONS), f"divisions x {_DIVISIONS}"
    try:
        free = changed(case, *changes, f'solver={{method="{plan.method}"}}', 'engine={loop="compiled"}')
        other = prepare_case(free)
    except CaseError as error:
        return CaptureSetting(Knob.DIVISIONS, name, refused=_first_line(error))
    ratio = 1.0 if plan.step is None else min(1.0, stable_of(other) / stable_of(start))
    size, work = _sized(plan, ratio)
    more = other.net.n_elements / max(1, start.net.n_elements)
    work *= more if plan.step is not None else more**2  # whose steps follow by themselves
    return CaptureSetting(Knob.DIVISIONS, name, solver(plan, size), size, work, changes)


def _first_line(error: Exception) -> str:
    return str(error).split("\n", maxsplit=1)[0]


def stable_of(start: Start) -> float:
    """Stable step [s] of the scene by its method."""
    system = start.system
    return stable_step(start.plan.method, largest_frequency(system), largest_damping_rate(system))


def _sized(plan: Plan, factor: float) -> tuple[float, float]:
    """Step or tolerance times a factor, and the work of a run with it over that of the case's."""
    if plan.step is not None:
        return factor * plan.step, 1.0 / factor
    assert plan.tolerance is not None
    return factor * plan.tolerance, float(_NEXT ** -math.log10(factor))


def solver(plan: Plan, size: float) -> str:
    """Keys of [solver] for the method of a plan with a step or tolerance."""
    key = "tolerance" if plan.step is None else "step"
    return f'method="{plan.method}",{key}={size!r}'
