"""Worker of an FMU: a process beside each instance that has its net, and answers requests of its socket.

A request is a header (two integers of 8 bytes: request, length) and its content; a reply a header (status,
length) and its content, which is the text of the error where the status is not zero. Byte order is that of
the machine, floats have 8 bytes. `exunet/coupling/fmu/c/worker.c` is the other side.
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import socket
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import numpy as np

from exunet.base.arrays import Floats
from exunet.base.errors import ExunetError, InputError, RunStopped
from exunet.base.files import pack_arrays, unpack_arrays
from exunet.base.version import VERSION
from exunet.bodies.port import FrameState, frames_of
from exunet.bodies.rigid import make_body
from exunet.bodies.rotations import rotation_matrix
from exunet.coupling.fmu.variables import (
    AT_END,
    LONGEST,
    NetInstant,
    Parameters,
    Signals,
    Variable,
    free_bodies_of,
    ports_of,
)
from exunet.coupling.net_system import NetSystem, PortLoad
from exunet.coupling.rollback import Predictor
from exunet.coupling.stability import CONTRACTING, STABLE, LongestStep
from exunet.scene.casefile import Case, load
from exunet.simulation.simulation import cannot_restart
from exunet.simulation.snapshot import Snapshot

KIND, FORMAT = "exunet FMU state", 1
FILE = "content.json"

# Tolerance of the begin of a communication step, relative to its length, and in units of the last place: sums
# of steps have round-off.
_SAME_TIME, _ROUND_OFF = 1e-6, 16
# A step that ends so near to a stored time of the case, relative to the step, ends there: hosts that count
# time differently then agree bitwise, where a snapping net would make 1e-9 m of round-off within a second.
_STORED = 1e-9


@dataclass(frozen=True)
class Content:
    """Data for the worker in the folder "resources" of an FMU, beside the files of the case.

    token     : identifies the export: binary, description and states must have the same
    exunet    : version of the export
    case      : name of the case file in the folder "case"
    overrides : applied to it, before those of parameters
    variables, starts : names of all variables, in the order of their values, and values of the unchanged case
    paths     : module paths of the Python of the export
    """

    token: str
    exunet: str
    case: str
    overrides: tuple[str, ...]
    variables: tuple[str, ...]
    starts: tuple[float, ...]
    paths: tuple[str, ...]

    @classmethod
    def read(cls, folder: Path) -> Content:
        """Read the file of a folder; raises InputError if it is unreadable or of another version."""
        try:
            found: Mapping[str, object] = json.loads((folder / FILE).read_text(encoding="utf-8"))
            content = cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in found.items()})  # type: ignore[arg-type]
        except (OSError, ValueError, TypeError, AttributeError) as error:
            raise InputError(f"{folder / FILE}: cannot be read ({error}): export the FMU again") from error
        if content.exunet != VERSION:
            raise InputError(
                f"the FMU is of exunet {content.exunet}, its worker of exunet {VERSION}: export it again, or "
                "set EXUNET_PYTHON to a Python that has the exunet of the FMU"
            )
        return content

    def load(self, folder: Path, overrides: list[str]) -> Case:
        """Load the case, with further overrides."""
        return load(folder / "case" / self.case, [*self.overrides, *overrides])


class FmuModel:
    """Variables of a case, and the net for their values."""

    def __init__(self, case: Case) -> None:
        self.parameters, self._scene = Parameters(case.scene), case.scene
        self.ports, self._bodies = ports_of(case.scene), free_bodies_of(case.scene)
        self._settings = (*self.parameters.variables, *([AT_END, LONGEST] if self.ports else []))
        self._centres = {
            name: np.array(make_body(name, case.scene.bodies[name]).centre) for name in self.ports
        }
        self.n_parameters, self.first_input = len(self.parameters.variables), len(self._settings)

    def net(self, case: Case) -> NetSystem:
        """Return a net of the case."""
        return NetSystem(case, wrenches=self._bodies)

    def variables(self, signals: Signals) -> tuple[Variable, ...]:
        """Return all variables: parameters, settings of ports, inputs, outputs."""
        return (*self._settings, *signals.inputs, *signals.outputs)

    def overrides(self, values: Floats, starts: Floats) -> list[str]:
        """Return the overrides for values: of parameters, and of states of ports that differ from the case's.

        starts : values of all variables in the unchanged case
        """
        found = self.parameters.overrides(values[: self.n_parameters].tolist())
        now, then = (frames_of(self.ports, all_of[self.first_input :]) for all_of in (values, starts))
        for name, state in now.items():
            if state != then[name]:
                found += self._start_of_port(name, FrameState.of(state, f"start of port {name}"))
        return found

    def _start_of_port(self, name: str, start: FrameState) -> list[str]:
        turn, spin = rotation_matrix(np.array(start.attitude)), np.array(start.angular_velocity)
        speed = start.velocity + turn @ np.cross(spin, self._centres[name])  # of the centre of mass
        keys, of = self._scene.bodies[name], f"bodies.{name}"
        return [f"{of}.{key}=" for key in ("axis", "angle") if getattr(keys, key) is not None] + [
            f"{of}.position={list(start.position)}",
            f"{of}.velocity={speed.tolist()}",
            f"{of}.attitude={list(start.attitude)}",
            f"{of}.angular_velocity={list(start.angular_velocity)}",
            f"{of}.angular_velocity_frame=body",
        ]


class StepDiscarded(ExunetError):
    """A step that was not taken: the net is unchanged, and a shorter step may be possible."""


class _Kept(NamedTuple):
    """State that the host keeps.

    snapshot : None before there is a net
    before   : of the predictor of the ports' motions, see `Predictor.as_array`
    """

    overrides: tuple[str, ...]
    snapshot: Snapshot | None
    before: Floats


class Served:
    """Net of one instance: built from values, stepped, kept and restored.

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
        self._largest: Mapping[bool, LongestStep] = {}  # by whether inputs are states at the end of a step
        self._kept: dict[int, _Kept] = {}
        self._numbers = count(1)

    def build(self, values: Floats) -> Floats:
        """Build a net at time 0 for these values; return them with the outputs."""
        self._make(tuple(self._model.overrides(values, self._starts)))
        return self._with_outputs(values, {})

    def step(self, begin: float, end: float, values: Floats) -> Floats:
        """Take a communication step [s]; return the values with the outputs at its end.

        A step that a guard stops raises RunStopped; the net is then at its begin.
        """
        net, signals = self._built()
        near = _SAME_TIME * (end - begin) + _ROUND_OFF * math.ulp(net.time)
        if begin - net.time < -near:
            reset = "reset the FMU, which begins at 0 s again"
            back = f"restore an FMU state that was kept by then, or {reset}"
            if not net.simulation.can_restart:
                reason = cannot_restart(net.simulation.plan.method)
                back = f"{reset}; it has no states to restore, since {reason}"
            raise InputError(
                f"doStep: the host goes back in time, to {begin:.9g} s, but the net is at {net.time:.9g} s: "
                f"{back}"
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
            self._validate_length(end - start, at_end=at_end, longest=longest)
        now = net.rows("step", signals.frames(inputs))
        signals.apply_wrenches(net, inputs.tolist())
        if at_end:
            loads = net.step(end, frames_of(net.ports, now))
        else:
            validated = self._validate_inputs(start, now)
            target = self._predictor.ahead(start, end, now)
            if validated:
                loads = net.follow(end, target).of(net.ports)
            else:
                loads = net.step(end, frames_of(net.ports, target))
        net.finish()
        self._predictor.keep(start, now, recoils=net.recoils(start, end))
        return self._with_outputs(values, loads)

    def _validate_inputs(self, start: float, now: Floats) -> bool:
        """Raise InputError if inputs (n, 13) at a time [s] are a jump; return False at the start.

        There they are compared with the net. After the jump of an ejection there is no step before, and
        predicted states may jump.
        """
        net, _ = self._built()
        if self._predictor.before is None:
            return start > net.simulation.start.state.time
        time, before = self._predictor.before
        net.validate_motion((time, start), (before, now))
        return True

    def _validate_length(self, step: float, *, at_end: bool, longest: float) -> None:
        by_ports = self._largest[at_end]
        if step > longest * (1.0 + 1e-9) if longest else not by_ports.allows(step):
            largest = longest or by_ports.now
            of = "ports.longest_step" if longest else "the largest stable one for the ports"
            raise StepDiscarded(
                f"doStep: a communication step of {step:.4g} s is longer than {of}, {largest:.4g} s: take "
                "shorter steps, or set ports.longest_step [s]"
            )

    def _or_stored(self, end: float, step: float) -> float:
        """Return the stored time of the case at the end of a step [s] but for round-off, else the end."""
        after = int(self._times.searchsorted(end))
        near = _STORED * step + _ROUND_OFF * math.ulp(end)
        for time in self._times[max(0, after - 1) : after + 1].tolist():
            if abs(time - end) <= near:
                return float(time)
        return end

    def keep(self) -> int:
        """Keep the present state; return its number."""
        snapshot = None if self._net is None else self._net.snapshot()
        return self._add(_Kept(self._overrides, snapshot, self._predictor.as_array()))

    def _add(self, kept: _Kept) -> int:
        number = next(self._numbers)
        self._kept[number] = kept
        return number

    def restore(self, number: int) -> None:
        """Restore a kept state."""
        kept = self._state(number)
        if kept.snapshot is None:
            return  # the host will build a net
        if self._net is None or kept.overrides != self._overrides:
            self._make(kept.overrides)
        self._built()[0].restore(kept.snapshot)
        self._predictor = Predictor.of_array(kept.before)

    def free(self, number: int) -> None:
        """Forget a kept state."""
        self._kept.pop(number, None)

    def pack(self, number: int, values: Floats) -> bytes:
        """Serialise a kept state, with numbers of the host's side (n,)."""
        kept = self._state(number)
        of_net = b"" if kept.snapshot is None else kept.snapshot.as_bytes()
        header = {"token": self.content.token, "overrides": list(kept.overrides)}
        net = np.frombuffer(of_net, dtype=np.uint8)
        return pack_arrays(KIND, FORMAT, header, {"values": values, "before": kept.before, "net": net})

    def unpack(self, content: bytes, size: int) -> tuple[int, Floats]:
        """Keep a serialised state of this FMU; return its number and the host's numbers (size,)."""
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
            or not Predictor.accepts(self._model.ports, arrays["before"])
        ):
            raise InputError("the FMU state is damaged: parts of it are missing or of another shape")
        of_net = arrays["net"].tobytes()
        snapshot = Snapshot.of_bytes(of_net) if of_net else None
        return self._add(_Kept(tuple(overrides), snapshot, arrays["before"])), values

    def _state(self, number: int) -> _Kept:
        if number not in self._kept:
            raise InputError(f"there is no FMU state {number} in this instance: it was freed")
        return self._kept[number]

    def _built(self) -> tuple[NetSystem, Signals]:
        if self._net is None or self._signals is None:
            raise InputError("the FMU is not initialised")
        return self._net, self._signals

    def _make(self, overrides: tuple[str, ...]) -> None:
        """Make a net at time 0 of the case with further overrides, or reset the present one."""
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
        bounds = {False: STABLE, True: CONTRACTING}
        self._largest = {at_end: LongestStep(net, bound) for at_end, bound in bounds.items()}
        self._predictor = Predictor()

    def _with_outputs(self, values: Floats, loads: Mapping[str, PortLoad]) -> Floats:
        net, signals = self._built()
        outputs = signals.read(NetInstant(net, loads))
        return np.concatenate([values[: len(values) - len(outputs)], outputs])


HEADER = struct.Struct("=QQ")
DONE, FAILED, STOPPED = 0, 1, 2
_NUMBER = struct.Struct("=Q")


def _answer(served: Served, request: int, content: bytes) -> bytes:
    """Answer a request, in the order of `enum request` of c/worker.h."""
    values = np.frombuffer(content[: len(content) // 8 * 8], dtype=np.float64).copy()
    number = _NUMBER.unpack_from(content)[0] if len(content) >= _NUMBER.size else 0
    match request:
        case 0:
            return served.build(values).tobytes()
        case 1:
            return served.step(float(values[0]), float(values[1]), values[2:]).tobytes()
        case 2:
            return _NUMBER.pack(served.keep())
        case 3:
            served.restore(number)
        case 4:
            served.free(number)
        case 5:
            return served.pack(number, values[1:])
        case 6:
            new, numbers = served.unpack(content[_NUMBER.size :], number)
            return _NUMBER.pack(new) + numbers.tobytes()
        case _:
            raise ValueError(f"unknown request {request}")
    return b""


def serve(connection: socket.socket, folder: Path) -> None:
    """Answer the requests of a socket until the other side closes it."""
    try:
        served = Served(folder)
    except ExunetError as error:
        _reply(connection, FAILED, str(error).encode())
        return
    _reply(connection, DONE, served.content.token.encode())
    while header := _receive(connection, HEADER.size):
        request, length = HEADER.unpack(header)
        content = _receive(connection, length)
        if len(content) < length:
            return
        try:
            reply = DONE, _answer(served, request, content)
        except (RunStopped, StepDiscarded) as stop:
            reply = STOPPED, str(stop).encode()
        except ExunetError as error:
            reply = FAILED, str(error).encode()
        except Exception as error:  # noqa: BLE001 - the host reports every error and stops the instance
            reply = FAILED, f"a defect of exunet: {type(error).__name__}: {error}".encode()
        _reply(connection, *reply)


def _reply(connection: socket.socket, status: int, content: bytes) -> None:
    connection.sendall(HEADER.pack(status, len(content)) + content)


def _receive(connection: socket.socket, length: int) -> bytes:
    """Receive so many bytes, or fewer if the other side has closed."""
    found = bytearray()
    while len(found) < length and (part := connection.recv(min(length - len(found), 1 << 20))):
        found += part
    return bytes(found)


def _end_with_host(connection: socket.socket) -> None:
    """End the process when the other side closes the socket, also within a request."""
    hang_up = select.poll()
    hang_up.register(connection, 0)  # 0: POLLHUP alone, which is always reported
    hang_up.poll()
    os._exit(0)


def main(folder: str) -> None:
    """Serve over the socket that is standard input, and end the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the host ends its workers
    connection = socket.socket(fileno=os.dup(0))
    Thread(target=_end_with_host, args=(connection,), daemon=True).start()
    with suppress(OSError):  # the host has ended
        serve(connection, Path(folder))
    os._exit(0)  # nothing is left to write, and the host waits
