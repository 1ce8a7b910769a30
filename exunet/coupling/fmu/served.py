"""The net of one instance of an FMU: built from values, stepped, kept and restored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from exunet.base.errors import ExunetError, InputError
from exunet.base.files import pack_arrays, unpack_arrays
from exunet.bodies.port import FrameState, frames_of
from exunet.bodies.rigid import make_body
from exunet.bodies.rotations import rotation_matrix
from exunet.coupling.fmu.description import Content
from exunet.coupling.fmu.parameters import Parameters
from exunet.coupling.fmu.signals import (
    AT_END,
    LONGEST,
    NetInstant,
    Signals,
    free_bodies_of,
    ports_of,
)
from exunet.coupling.fmu.variables import Variable
from exunet.coupling.net_system import NetSystem, PortLoad
from exunet.coupling.prediction import CONTRACTING, STABLE, LongestStep, Predictor
from exunet.scene.casefile import Case
from exunet.simulation.simulation import cannot_restart
from exunet.simulation.snapshot import Snapshot

Floats = NDArray[np.float64]
KIND, FORMAT = "exunet FMU state", 1

# How far the communication point that a host names may be from the end of the last step, in parts of the
# step, and in units of the last place: sums of steps have round-off.
_SAME_TIME, _ROUND_OFF = 1e-6, 16
# A step that ends so near to a stored time of the case, in parts of the step, ends there: hosts that count
# time differently get the same bits so, where a snapping net would make 1e-9 m of round-off within a second.
_STORED = 1e-9


class StepDiscarded(ExunetError):
    """A step that was not taken: the net is where it was, and a shorter one may do."""


class FmuModel:
    """The variables of a case, and how their values become a net.

    variables : parameters, the switch of ports, inputs, outputs
    """

    def __init__(self, case: Case) -> None:
        self.parameters = Parameters(case.scene)
        self.ports, self._bodies = ports_of(case.scene), free_bodies_of(case.scene)
        self._scene = case.scene
        own = [*self.parameters.variables, *([AT_END, LONGEST] if self.ports else [])]
        self._settings = tuple(own)
        self._centres = {
            name: np.array(make_body(name, self._scene.bodies[name]).centre) for name in self.ports
        }
        self.n_parameters = len(self.parameters.variables)
        self.first_input = len(own)

    def net(self, case: Case) -> NetSystem:
        """A net of the case."""
        return NetSystem(case, wrenches=self._bodies)

    def variables(self, signals: Signals) -> tuple[Variable, ...]:
        """All."""
        return (*self._settings, *signals.inputs, *signals.outputs)

    def overrides(self, values: Floats, starts: Floats) -> list[str]:
        """What values replace in the case: parameters, and states of ports that are not those of the case.

        starts : the values of all variables in the case as it stands
        """
        found = self.parameters.overrides(values[: self.n_parameters].tolist())
        now, then = (frames_of(self.ports, all_of[self.first_input :]) for all_of in (values, starts))
        for name, state in now.items():
            if state != then[name]:
                found += self._start_of_port(name, FrameState.of(state, f"start of port {name}"))
        return found

    def _start_of_port(self, name: str, told: FrameState) -> list[str]:
        turn, spin = rotation_matrix(np.array(told.attitude)), np.array(told.angular_velocity)
        speed = told.velocity + turn @ np.cross(spin, self._centres[name])  # the case has that of the centre
        keys, of = self._scene.bodies[name], f"bodies.{name}"
        return [f"{of}.{key}=" for key in ("axis", "angle") if getattr(keys, key) is not None] + [
            f"{of}.position={list(told.position)}",
            f"{of}.velocity={speed.tolist()}",
            f"{of}.attitude={list(told.attitude)}",
            f"{of}.angular_velocity={list(told.angular_velocity)}",
            f"{of}.angular_velocity_frame=body",
        ]


class _Kept(NamedTuple):
    """A state that the host keeps.

    snapshot : None before there is a net
    before   : what the predictor of the ports' motions remembers, see `Predictor.numbers`
    """

    overrides: tuple[str, ...]
    snapshot: Snapshot | None
    before: Floats


class Served:
    """What a worker does for one instance.

    folder : "resources" of the FMU
    Values are (n,) of all variables, in their order. Raises InputError, CaseError, RunStopped, StepDiscarded.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.content = Content.read(folder)
        case = self.content.load(folder, [])
        self._model = FmuModel(case)
        self._starts, self._times = np.array(self.content.starts), case.scene.time.stored_times
        self._net: NetSystem | None = None
        self._signals: Signals | None = None
        self._overrides: tuple[str, ...] = ()
        self._predictor = Predictor()
        self._largest: Mapping[bool, LongestStep] = {}  # by whether inputs tell the end of a step
        self._kept: dict[int, _Kept] = {}
        self._numbers = count(1)

    def build(self, values: Floats) -> Floats:
        """A net at time 0 for these values; returns them with the outputs."""
        self._make(tuple(self._model.overrides(values, self._starts)))
        return self._with_outputs(values, {})

    def step(self, begin: float, end: float, values: Floats) -> Floats:
        """Go through a communication step [s]; returns the values with the outputs at its end.

        A step that a guard stops raises RunStopped; the net is then where the step began.
        """
        net, signals = self._built()
        near = _SAME_TIME * (end - begin) + _ROUND_OFF * math.ulp(net.time)
        if begin - net.time < -near:
            raise InputError(
                f"doStep: the host goes back in time, to {begin:.9g} s, but the net is at {net.time:.9g} s: "
                f"{self._way_back(net)}"
            )
        if begin - net.time > near:
            raise InputError(
                f"doStep: begins at {begin:.9g} s, but the net is at {net.time:.9g} s: a step from there to "
                f"{begin:.9g} s comes first"
            )
        model, end = self._model, self._or_stored(end, end - begin)
        inputs = values[model.first_input : model.first_input + len(signals.inputs)]
        start, at_end = net.time, True
        if model.ports:
            at_end, longest = bool(values[model.n_parameters]), float(values[model.n_parameters + 1])
            self._refuse_long(end - start, at_end=at_end, longest=longest)
        now = net.checked("step", signals.frames(inputs))
        told, may_jump = now, False
        if not at_end:
            may_jump = self._predicts_from(start, now)
            told = self._predictor.told(start, end, now)
        signals.let_wrenches_act(net, inputs.tolist())
        frames = frames_of(net.ports, told)
        loads = net.follow(end, told).of(net.ports) if may_jump else net.step(end, frames)
        net.finish()
        if net.recoils(start, end):  # a jump, which does not go on
            self._predictor.forget()
        else:
            self._predictor.keep(start, now)
        return self._with_outputs(values, loads)

    @staticmethod
    def _way_back(net: NetSystem) -> str:
        """What a host is to do that wants an earlier time."""
        reset = "reset the FMU, which begins at 0 s again"
        if net.simulation.can_restart:
            return f"restore an FMU state that was kept by then, or {reset}"
        return f"{reset}; it has no states to restore, since {cannot_restart(net.simulation.plan.method)}"

    def _predicts_from(self, start: float, now: Floats) -> bool:
        """True if states that are predicted from inputs (n, 13) at a time [s] may be a jump of the net's.

        Raises InputError if the inputs are one.
        """
        net, _ = self._built()
        if self._predictor.before is None:  # at the start, where the net is; or after a throw, which jumps
            return start > net.simulation.start.state.time
        time, before = self._predictor.before
        net.refuse_jump("step: port", (time, start), (before, now))
        return True

    def _refuse_long(self, step: float, *, at_end: bool, longest: float) -> None:
        by_ports = self._largest[at_end]
        if step > longest * (1.0 + 1e-9) if longest else not by_ports.allows(step):
            largest = longest or by_ports.now
            of = "ports.longest_step" if longest else "the largest stable one for the ports"
            raise StepDiscarded(
                f"doStep: a communication step of {step:.4g} s is longer than {of}, {largest:.4g} s: take "
                "shorter steps, or set ports.longest_step [s]"
            )

    def _or_stored(self, end: float, step: float) -> float:
        """The stored time of the case that the end of a step [s] is but for round-off, else the end."""
        after = int(self._times.searchsorted(end))
        near = _STORED * step + _ROUND_OFF * math.ulp(end)
        for time in self._times[max(0, after - 1) : after + 1].tolist():
            if abs(time - end) <= near:
                return float(time)
        return end

    def keep(self) -> int:
        """Keep the state as it is; returns its number."""
        number = next(self._numbers)
        snapshot = None if self._net is None else self._net.snapshot()
        self._kept[number] = _Kept(self._overrides, snapshot, self._predictor.numbers())
        return number

    def restore(self, number: int) -> None:
        """Go to a state that was kept."""
        kept = self._own(number)
        if kept.snapshot is None:
            return  # the host will build anew
        if self._net is None or kept.overrides != self._overrides:
            self._make(kept.overrides)
        self._built()[0].restore(kept.snapshot)
        self._predictor = Predictor.of_numbers(kept.before)

    def free(self, number: int) -> None:
        """Forget a state that was kept."""
        self._kept.pop(number, None)

    def pack(self, number: int, values: Floats) -> bytes:
        """A state that was kept, with numbers of the host's side (n,), as bytes."""
        kept = self._own(number)
        of_net = b"" if kept.snapshot is None else kept.snapshot.as_bytes()
        header = {"token": self.content.token, "overrides": list(kept.overrides)}
        net = np.frombuffer(of_net, dtype=np.uint8)
        return pack_arrays(KIND, FORMAT, header, {"values": values, "before": kept.before, "net": net})

    def unpack(self, content: bytes, size: int) -> tuple[int, Floats]:
        """Keep a state that `pack` gave, of this FMU; returns its number and the host's numbers (size,)."""
        header, arrays = unpack_arrays(content, KIND, FORMAT)
        overrides, values = header.get("overrides"), arrays.get("values", np.zeros(0))
        if header.get("token") != self.content.token:
            raise InputError("the FMU state is of another FMU, or of this one from another export")
        if (
            not isinstance(overrides, list)
            or not all(isinstance(override, str) for override in overrides)
            or values.dtype != np.float64
            or values.shape != (size,)
            or not {"net", "before"} <= arrays.keys()
            or not Predictor.takes(self._model.ports, arrays["before"])
        ):
            raise InputError("the FMU state is damaged: it has not what a state has")
        of_net = arrays["net"].tobytes()
        number = next(self._numbers)
        snapshot = Snapshot.of_bytes(of_net) if of_net else None
        self._kept[number] = _Kept(tuple(overrides), snapshot, arrays["before"])
        return number, values

    def _own(self, number: int) -> _Kept:
        if number not in self._kept:
            raise InputError(f"there is no FMU state {number} in this instance: it was freed")
        return self._kept[number]

    def _built(self) -> tuple[NetSystem, Signals]:
        if self._net is None or self._signals is None:
            raise InputError("the FMU is not initialised")
        return self._net, self._signals

    def _make(self, overrides: tuple[str, ...]) -> None:
        """A net at time 0 of the case with further overrides; the one that is there if it is alike."""
        if self._net is not None and overrides == self._overrides and self._net.simulation.can_restart:
            self._net.reset()
            self._predictor = Predictor()
            return
        self._net = None
        net = self._model.net(self.content.load(self._folder, list(overrides)))
        signals = Signals(net)
        names = tuple(variable.name for variable in self._model.variables(signals))
        if names != self.content.variables:
            raise InputError(
                "these parameters give the net other variables than those of the model description"
            )
        self._net, self._signals, self._overrides = net, signals, overrides
        self._largest = {
            at_end: LongestStep(net, CONTRACTING if at_end else STABLE) for at_end in (False, True)
        }
        self._predictor = Predictor()

    def _with_outputs(self, values: Floats, loads: Mapping[str, PortLoad]) -> Floats:
        net, signals = self._built()
        outputs = signals.read(NetInstant(net, loads))
        return np.concatenate([values[: len(values) - len(outputs)], outputs])
