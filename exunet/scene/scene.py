"""The scene: the tables of a case as frozen records in SI units, and checks of tables against each other."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Tag, field_validator

from exunet.base.arguments import shown
from exunet.base.errors import CaseError, Fault, InputError, within
from exunet.base.files import path_of, replacing
from exunet.base.key_path import key_path
from exunet.base.record import (
    FromArray,
    NonNegative,
    Positive,
    Record,
    Vector,
    increasing,
    one_of,
    plain,
    shortened,
    unlocated,
)
from exunet.base.times import reached
from exunet.base.validation import Located, validated_record
from exunet.bodies import config as bodies
from exunet.bodies.config import Bodies, Placed, Quaternion
from exunet.forces import corner_units, effects
from exunet.forces.corner_units import AnyControl
from exunet.forces.effect import RestOfCase, existing_body
from exunet.forces.effects import Effects as _Effects
from exunet.forces.effects.contact import Contact
from exunet.forces.effects.thermal_strain import ThermalStrain
from exunet.methods.config import AUTO, Solver
from exunet.methods.method import COMPILED_METHODS, Backend
from exunet.net import AnyNetConfig, closing, explicit, folding, tether
from exunet.net.base import Cable, ThrownNetConfig, other_length
from exunet.net.closing import Closing
from exunet.net.folding import Fold
from exunet.net.tether import Tethers
from exunet.scene import capture, script
from exunet.scene.capture import Capture
from exunet.scene.document import (
    Override,
    applied,
    located,
    misspelt,
    overridden,
    place_files,
    read_text,
    text_of,
)
from exunet.scene.script import ScriptEntry

if TYPE_CHECKING:
    Effects = effects.Choice
    BackendKey = Backend | Literal["auto"]
else:  # made from the registry of effects and from enums, which a type checker cannot follow
    Effects = _Effects
    BackendKey = Literal[(*Backend, AUTO)]

MAX_STATES = 10_000_000
SHORTEST = 1e-9  # [s]
LINE_BREAK = r"[\n\r\u000b\u000c\u001c-\u001e\u0085\u2028\u2029]"  # what str.splitlines takes for one
UNPRINTED = r"[\u0000-\u0008\u000a-\u001f\u007f-\u009f\u2028\u2029]"  # these, and what steers a terminal


class Time(Record):
    """Duration and stored times."""

    TABLE: ClassVar = "time"
    EXACTLY_ONE: ClassVar = ("output_step", "output_times")

    end: Annotated[float, Field(ge=SHORTEST)] = Field(
        description="end of the simulation [s]; it starts at 0", examples=[2.0]
    )
    output_step: Positive | None = Field(
        None, description="spacing of the stored states [s]: k output_step and end", examples=[0.005]
    )
    output_times: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None,
        description="stored times [s], increasing, within [0, end], instead of output_step; 0 and end are "
        "stored anyway",
        examples=[[0.5, 1.0]],
    )

    def faults(self) -> Iterator[Fault]:
        """Require stored times that increase until the end, and not too many."""
        step, end, times = self.output_step, self.end, self.output_times or ()
        if step and end / step > MAX_STATES:
            reason = f"to {end:g} s, a state each {step:g} s are {end / step:.3g} states"
            yield Fault("output_step", f"{reason}; at most {MAX_STATES:,} are allowed", against=("end",))
        yield from shortened(
            Fault(f"output_times[{k}]", f"must not be after time.end, {end:g} s, got {time:g}")
            for k, time in enumerate(times)
            if not reached(end, time)
        )
        yield from shortened(increasing("output_times", times))

    @property
    def stored_times(self) -> NDArray[np.float64]:
        """(n_times,) times at which a run stores its state [s]: 0, the output times, and the end."""
        if self.output_times is not None:
            inner = np.array([t for t in self.output_times if t > 0.0 and not reached(t, self.end)])
        else:
            step = self.output_step or self.end
            number = int(np.floor(self.end / step * (1 + 1e-12)))
            inner = step * np.arange(1, number + 1)
            inner = inner[inner < self.end * (1 - 1e-12)]
        return np.concatenate([[0.0], inner, [self.end]])


class NetFrame(Placed):
    """The axes in which the net starts, in the frame of a body that carries them."""

    TABLE: ClassVar = "initial.frame"
    body: str = Field(description="name of the body that carries the packed net", examples=["chaser"])
    position: Vector = Field((0.0, 0.0, 0.0), description="of the net's origin in the body's frame [m]")
    attitude: Quaternion = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="quaternion [w, x, y, z] that turns the net's axes into those of the body's frame; "
        "brought to length 1",
    )
    eject_at: NonNegative = Field(
        0.0,
        description="until when the body holds the packed net [s], before time.end; then velocity, spin and "
        "[launch] act",
    )


class Initial(Record):
    """State at time 0."""

    TABLE: ClassVar = "initial"
    EXACTLY_ONE: ClassVar = ("packing", "fold", "restart")

    packing: NonNegative | None = Field(
        None, description="initial position = packing x reference position", examples=[0.1]
    )
    fold: Fold | None = Field(
        None, description="the net folded into a canister with 90 to 100 % of each length, instead of packing"
    )
    restart: Annotated[str, Field(min_length=1)] | None = Field(
        None,
        description="the state of another run, instead of packing: its folder or result.h5, relative to the "
        "folder of the case, then @ and a stored time [s] or end, which is the default",
        examples=["../results/capture@2.5"],
    )
    frame: NetFrame | None = Field(
        None,
        description="the net starts in axes that a body carries, and a launch acts back on the body; without "
        "it, in the scene's axes",
    )
    velocity: Vector | None = Field(
        None, description="velocity of every node [m/s]", examples=[[0.0, 0.0, 1.0]]
    )
    spin: Vector | None = Field(
        None, description="angular velocity about the origin [rad/s]", examples=[[0.0, 0.0, 0.1]]
    )
    node_positions: Annotated[tuple[Vector, ...], FromArray] | None = Field(
        None,
        description="initial positions [m], explicit topology with packing 1 only",
        examples=[[[0.0, 0.0, 0.0], [0.9, 0.0, 0.0]]],
    )
    node_velocities: Annotated[tuple[Vector, ...], FromArray] | None = Field(
        None,
        description="velocities added to those of the nodes [m/s], explicit topology only",
        examples=[[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]],
    )

    def faults(self) -> Iterator[Fault]:
        """Require one source of positions and velocities."""
        if self.restart is not None:
            words = "excludes initial.restart, whose state has positions and velocities: remove one"
            for name in ("frame", "velocity", "spin", "node_positions", "node_velocities"):
                if self.is_given(name):
                    yield Fault(name, words, against=("restart",))
        elif self.node_positions is not None and self.packing is not None and self.packing != 1:
            words = f"requires initial.packing = 1, got {self.packing:g}"
            yield Fault("node_positions", words, against=("packing",))

    @property
    def deployed(self) -> float:
        """The part of its size that the net has: packing; 0 where it is folded, 1 in another run's state."""
        if self.restart is not None:
            return 1.0
        return 0.0 if self.packing is None else self.packing


class BulletLaunch(Record):
    """Velocities added to those of the bullets; subclasses give radial and axial speed."""

    speed_factors: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None,
        description="factor of the speed of each bullet, 0 if it is released but not thrown; default: 1",
        examples=[[1.0, 1.0, 1.05, 0.0]],
    )
    tilts: Annotated[tuple[Annotated[tuple[float, float], FromArray], ...], FromArray] | None = Field(
        None,
        description="angles of each bullet's velocity about two axes across it [rad]: positive ones lean "
        "outwards, and anticlockwise seen from +z; default: 0",
        examples=[[[0.01, 0.0], [0.0, 0.0], [0.0, -0.02], [0.0, 0.0]]],
    )

    @property
    def radial_and_axial(self) -> tuple[float, float]:
        """Speeds away from the origin and along +z [m/s]."""
        raise NotImplementedError

    def velocities(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute (n, 3) the velocities added to the bullets, in the net's axes [m/s].

        place : (n, 3) reference positions of the bullets [m]

        A tilt turns a velocity about z x outward, which is across it, then about the axis across both.
        """
        radial, axial = self.radial_and_axial
        outward, upward = place / np.linalg.norm(place, axis=1, keepdims=True), np.array([0.0, 0.0, 1.0])
        velocity = radial * outward + axial * upward
        if self.tilts is not None:
            width = np.linalg.norm(outward[:, :2], axis=1, keepdims=True)  # 1, or less of an explicit net
            radial, axial = radial * width, axial + radial * outward[:, 2:]
            outward = outward * [1.0, 1.0, 0.0] / np.where(width > 0.0, width, 1.0)
            first, second = np.array(self.tilts).T[..., None]
            leaning = (radial * np.cos(first) + axial * np.sin(first)) * outward
            leaning += (axial * np.cos(first) - radial * np.sin(first)) * upward
            sideways = np.hypot(radial, axial) * np.cross(upward, outward)
            velocity = np.cos(second) * leaning + np.sin(second) * sideways
        factors = 1.0 if self.speed_factors is None else np.array(self.speed_factors)[:, None]
        return np.asarray(factors * velocity)


class RadialLaunch(BulletLaunch):
    """Velocities added to those of the bullets: radial and axial speed."""

    TABLE: ClassVar = "launch"
    radial_speed: float = Field(
        description="away from the origin, in the net's plane; relative to a body before its recoil [m/s]",
        examples=[3.5],
    )
    axial_speed: float = Field(
        description="along +z, the direction of the launch, likewise before the recoil [m/s]", examples=[2.0]
    )

    @property
    def radial_and_axial(self) -> tuple[float, float]:
        """Speeds away from the origin and along +z [m/s]."""
        return self.radial_speed, self.axial_speed


class ConeLaunch(BulletLaunch):
    """Velocities added to those of the bullets: speed and spread angle."""

    TABLE: ClassVar = "launch"
    speed: NonNegative = Field(
        description="speed of each bullet, relative to a body before its recoil [m/s]",
        examples=[2.5],
    )
    spread_angle: float = Field(
        ge=0.0,
        le=math.pi / 2,
        description="between the bullets' velocities and +z, the direction of the launch [rad]",
        examples=[0.6],
    )

    @property
    def radial_and_axial(self) -> tuple[float, float]:
        """Speeds away from the origin and along +z [m/s]."""
        return self.speed * math.sin(self.spread_angle), self.speed * math.cos(self.spread_angle)


Launch = Annotated[
    Annotated[RadialLaunch, Tag("radial_speed and axial_speed")]
    | Annotated[ConeLaunch, Tag("speed and spread_angle")],
    one_of(RadialLaunch, ConeLaunch),
]


class Engine(Record):
    """Backend of a run; the results of both agree. The reference ignores this table."""

    TABLE: ClassVar = "engine"
    backend: BackendKey = Field(
        AUTO,
        description="integrator: Exudyn, with a connector for each element, or exunet's compiled loop; "
        "auto: the compiled loop if it has the method and Numba is installed, else Exudyn",
    )


class Scene(Record):
    """Scene of a simulation: the tables of a case file, from a file or from Python.

    A scene is frozen. Tables are records of exunet or dictionaries of a case file's keys; names of files are
    relative to the current folder. Raises CaseError with all errors, each with its key.
    """

    TABLE: ClassVar = ""
    format: Literal[1] = Field(description="version of the case format", examples=[1])
    title: str = Field(
        description="one line for tables and figures",
        examples=["Deployment of a net"],
        json_schema_extra={"pattern": rf"^(?![\s\S]*{UNPRINTED})"},
    )
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = Field(
        0, description="seed of the perturbed runs of a run and of an ensemble"
    )
    time: Time = Field(description="duration and stored times")
    solver: Solver = Field(
        default_factory=lambda: Solver.model_validate({}), description="how the equations are integrated"
    )
    engine: Engine = Field(
        default_factory=lambda: Engine.model_validate({}), description="backend that integrates"
    )
    net: AnyNetConfig = Field(description="the net in its reference configuration")
    initial: Initial = Field(description="state at time 0")
    launch: Launch | None = Field(None, description="velocities added to those of the bullets")
    bodies: Bodies = Field(
        {},
        description="rigid bodies",
        json_schema_extra={"additionalProperties": False},
    )
    tethers: Tethers = Field(
        {},
        description="cables beside the net, each between two of its nodes, bullets and bodies",
        json_schema_extra={"additionalProperties": False},
    )
    closing: Closing | None = Field(
        None, description="line or shortened edge that closes the mouth of the net"
    )
    control: AnyControl | None = Field(
        None, description="corner units (bullets with thrusters) and their controller"
    )
    capture: Capture | None = Field(None, description="criterion of a capture")
    script: Annotated[tuple[ScriptEntry, ...], FromArray] = Field(
        (),
        description="events of the mission, each a trigger and an action",
        examples=[[{"name": "lock", "at": 2.5, "do": "lock", "on": "closing"}]],
    )
    effects: Effects = Field(default_factory=_Effects, description="a table present switches its effect on")

    @field_validator("format", mode="before")
    @classmethod
    def _whole_number(cls, value: Any) -> Any:
        if isinstance(value, bool | float):  # which Literal would take for equal to 1
            raise ValueError(f"must be 1, a whole number, got {str(value).lower()}")
        return value

    @field_validator("title")
    @classmethod
    def _one_line(cls, title: str) -> str:
        if re.search(LINE_BREAK, title):
            raise ValueError("must be one line")
        if found := re.search(UNPRINTED, title):
            raise ValueError(f"must not hold control characters, got {found[0]!r}")
        return title

    def __init__(self, /, *args: Any, **keys: Any) -> None:
        document = plain(keys)
        place_files(document, Path())
        super().__init__(*args, **document)

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # as Record's

    @classmethod
    def load(cls, path: str | Path, overrides: Sequence[str] = ()) -> Scene:
        """Read a case file and apply overrides "key.path=value".

        Raises InputError if the file cannot be read, and CaseError with all errors and their lines if it is
        not a valid case.
        """
        path = path_of(path, "Scene.load")
        return parse_scene(read_text(path), path, overrides)

    @classmethod
    def of(cls, case: Mapping[str, Any] | str) -> Scene:
        """Return the scene of a case that is given as a dictionary or as the text of a file.

        Names of files are relative to the current folder. Raises CaseError if the case is not valid.
        """
        if isinstance(case, Mapping):
            return cls(**{str(key): value for key, value in case.items()})
        if isinstance(case, str):
            return parse_scene(case, Path("text"))
        raise InputError(f"Scene.of: needs a dictionary or the text of a case, got {shown(case)}")

    def save(self, path: str | Path) -> None:
        """Write the scene as a case file: the given keys, names of files relative to its folder.

        Raises InputError if the file cannot be written.
        """
        path = path_of(path, "Scene.save")
        text = self.text(path.parent)
        with replacing(path) as part:
            part.write_text(text, encoding="utf-8")

    def text(self, folder: str | Path = ".") -> str:
        """Return the scene as TOML, with names of files relative to a folder."""
        return text_of(self.document(), path_of(folder, "Scene.text", "the name of a folder"))

    def replace(self, changes: Mapping[str, Any]) -> Scene:
        """Return a scene with other values.

        Parameters
        ----------
        changes : Mapping
            Values by key path, as in {"launch.speed": 9.0, "script[2].force": 40.0}; None removes the key.

        Raises
        ------
        CaseError : a path does not exist, or the new scene is not valid.
        """
        if not isinstance(changes, Mapping):
            raise InputError(f"Scene.replace: needs a dictionary of values by key path, got {shown(changes)}")
        document = self.document()
        made, faults = list[Override](), list[Fault]()
        for key, value in changes.items():
            try:
                if not isinstance(key, str):
                    raise ValueError("a key path is a string")
                change = Override(key, key_path(key), plain(value), removes=value is None)
                made.append(applied(change, document, Scene))
            except ValueError as error:
                faults.append(Fault("", f"Scene.replace: {key}: {error}"))
        if faults:
            raise CaseError(faults)
        scene, found = _validated(document, Path())
        if found := misspelt(found, made):
            raise unlocated(found)
        assert scene is not None
        return scene

    def faults(self) -> Iterator[Fault]:
        """Yield every contradiction between tables, at the key that is to be changed."""
        yield from _engine(self)
        yield from _initial(self)
        yield from _launch(self)
        yield from within("bodies", bodies.cross_checks(self.bodies, self.time.end))
        yield from within("tethers", tether.cross_checks(self.tethers, self.bodies))
        yield from _names(self)
        yield from _laws(self)
        if self.control is not None:
            scripted = script.begins_control(self.script)
            own = corner_units.cross_checks(self.control, RestOfCase(self), scripted=scripted)
            yield from within("control", own)
        if self.effects.is_given("choose") and (self.bodies or self.tethers):
            words = "its estimates are of a net alone, without bodies and tethers: "
            words += "give the tables of what acts"
            yield Fault("effects.choose", words)
        yield from within("effects", effects.cross_checks(self))
        if self.capture is not None:
            contact = self.effects.get(Contact)
            touched = frozenset(() if contact is None else (*contact.threads, *contact.nodes))
            mouth = self.net.has_mouth
            found = capture.cross_checks(self.capture, self.bodies, touched, has_mouth=mouth)
            yield from within("capture", found)
        yield from _script(self)


def cables(scene: Scene) -> dict[str, Cable]:
    """Return the cables of a scene by their keys."""
    found: dict[str, Cable | None] = {
        f"net.{name}": getattr(scene.net, name, None) for name in ("cable", "border", "strings")
    }
    found |= {f"net.threads.{name}": cable for name, cable in getattr(scene.net, "threads", {}).items()}
    found |= {f"tethers.{name}": keys for name, keys in scene.tethers.items()}
    return {key: cable for key, cable in found.items() if cable is not None}


def parse_scene(text: str, path: Path, overrides: Sequence[str] = ()) -> Scene:
    """Return the scene of a text that is, or was, that of the file `path`; raises CaseError with lines."""
    document, changes = overridden(text, path, overrides, Scene)
    scene, found = _validated(document, path.parent)
    if found := misspelt(found, changes):
        raise CaseError(located(found, text, path, changes))
    assert scene is not None
    return scene


def _validated(document: dict[str, Any], folder: Path) -> tuple[Scene | None, list[Located]]:
    """The scene of a document with names of files relative to a folder, or None and every fault."""
    place_files(document, folder)
    return validated_record(document, Scene)


def _engine(scene: Scene) -> Iterator[Fault]:
    method, backend = scene.solver.method, scene.engine.backend
    if backend == Backend.COMPILED and method not in ("auto", *COMPILED_METHODS):
        known = ", ".join(("auto", *COMPILED_METHODS))
        yield Fault("engine.backend", f"the compiled loop has {known}, not solver.method = {method}")
    for name, body in scene.bodies.items():
        if body.motion == "port" and backend == Backend.EXUDYN:
            words = 'a port excludes engine.backend = "exudyn": the net takes steps of its own'
            yield Fault(f"bodies.{name}.motion", words, against=("engine.backend",))


def _initial(scene: Scene) -> Iterator[Fault]:
    initial = scene.initial
    if initial.fold is not None:
        yield from within("initial.fold", folding.cross_checks(scene.net, initial.fold))
    if (frame := initial.frame) is not None:
        yield from existing_body("initial.frame.body", frame.body, RestOfCase(scene))
        if frame.eject_at > 0.0 and reached(frame.eject_at, scene.time.end):
            words = f"must be before time.end, {scene.time.end:g} s, got {frame.eject_at:g} s"
            yield Fault("initial.frame.eject_at", words)
        if frame.eject_at > 0.0 and isinstance(scene.net, explicit.ExplicitNet) and scene.net.fixed:
            words = "a net that a body holds until then excludes net.fixed"
            yield Fault("initial.frame.eject_at", words)
    for name in ("node_positions", "node_velocities"):
        if (values := getattr(initial, name)) is None:
            continue
        if not isinstance(scene.net, explicit.ExplicitNet):
            yield Fault(f"initial.{name}", f'is for net.topology = "explicit", not "{scene.net.topology}"')
        elif scene.net.is_given("strings"):
            yield Fault(f"initial.{name}", "excludes net.strings, whose bullets are not listed")
        elif reason := other_length(values, scene.net.listed.nodes):
            yield Fault(f"initial.{name}", reason)
    if initial.restart is not None:
        words = "excludes initial.restart, whose state has positions and velocities: remove one"
        excluded = ["launch"] if scene.launch is not None else []
        on = scene.effects.on.items()
        excluded += [f"effects.{name}" for name, effect in on if effect.REPLACES_LAUNCH]
        for name, keys in scene.tethers.items():
            if keys.reel is not None and keys.reel.paid_out is not None:
                excluded.append(f"tethers.{name}.reel.paid_out")
        yield from (Fault(key, words, against=("initial.restart",)) for key in excluded)


def _launch(scene: Scene) -> Iterator[Fault]:
    if scene.launch is None:
        return
    if not isinstance(scene.net, ThrownNetConfig):
        yield Fault("launch", f'a net of topology "{scene.net.topology}" does not have bullets to launch')
    elif scene.net.bullets is None:
        yield Fault("launch", "there are no bullets to launch: add [net.bullets] or remove [launch]")
    else:
        for name in ("speed_factors", "tilts"):
            values = getattr(scene.launch, name)
            if values is not None and len(values) != (number := RestOfCase(scene).n_bullets):
                words = f"requires an entry for each of the {number} bullets, got {len(values)}"
                yield Fault(f"launch.{name}", words)


def _laws(scene: Scene) -> Iterator[Fault]:
    """Require the law of the paper where another one is not modelled."""
    other = [key for key, cable in cables(scene).items() if cable.law != "green_lagrange"]
    reasons = {
        "effects.thermal_strain": "whose free strain is of Green and Lagrange"
        if scene.effects.get(ThermalStrain) is not None
        else "",
        'closing.kind = "perimeter"': "which shortens threads of that law"
        if scene.closing is not None and scene.closing.kind == "perimeter"
        else "",
    }
    for key in other:
        for what, reason in reasons.items():
            if reason:
                yield Fault(f"{key}.law", f'excludes {what}, {reason}: use "green_lagrange"')


def _names(scene: Scene) -> Iterator[Fault]:
    """Require names that results can distinguish."""
    bodies = {name.lower() for name in scene.bodies}
    for name, keys in scene.tethers.items():
        if keys.reel is not None and name.lower() in bodies:
            words = "a body has this name too, and results have series of both: rename one"
            yield Fault(f"tethers.{name}", words)
    if scene.closing is not None:
        words = "the closing line has this name in results: rename it"
        for table, names in (("bodies", scene.bodies), ("tethers", scene.tethers)):
            yield from (Fault(f"{table}.{name}", words) for name in names if name.lower() == closing.NAME)


def _script(scene: Scene) -> Iterator[Fault]:
    if faults := list(script.entry_faults(scene)):
        yield from faults
    else:
        yield from script.conflicts(scene.script)
