"""Which effects matter in a scene: the estimate of each known effect, and advice.

Estimates are those of the effects' `magnitude`; effects that are off are estimated with the stated
assumptions of their `nominal`. With `effects.choose = "auto"` the same estimates switch effects on.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from exunet.base.errors import Fault, joining
from exunet.base.record import Record
from exunet.forces.effect import Effect
from exunet.forces.effects import EFFECTS, beyond_floats
from exunet.forces.effects.launch_force import LaunchForce
from exunet.forces.effects.orbit import Orbit
from exunet.forces.estimate import Estimate, EstimateBasis
from exunet.model.initial import initial_state
from exunet.net import weave
from exunet.scene.scene import Scene

ASKED = 0.01  # of the net's size: the accuracy that the advice is for, where the case states none


class Advice(StrEnum):
    """Advice on an effect of a scene."""

    KEEP = "keep"
    CONSIDER = "consider"
    NOT_NEEDED = "not needed"
    GROUND = "for tests on the ground"
    NUMERICAL = "numerical, not physics"
    CANDIDATE = "below effects.threshold"
    UNKNOWN = "not estimated"


@dataclass(frozen=True)
class Finding:
    """Estimate of one effect in one scene.

    on         : on in the case (with "auto": it has a table, and its estimate reaches the threshold)
    keys       : keys of the case, or assumed ones; None without an assumption for this scene
    assumption : assumption where the case does not have a table; "" if it has
    estimate   : None without keys
    relative   : estimated displacement over the size of the net
    """

    name: str
    on: bool
    keys: Record | None
    assumption: str
    estimate: Estimate | None
    relative: float

    def advice(self, accuracy: float) -> Advice:
        """Advise on the effect at an accuracy, as a fraction of the size of the net."""
        if not isinstance(self.keys, Effect) or self.estimate is None:
            return Advice.UNKNOWN
        if self.keys.NUMERICAL:
            return Advice.NUMERICAL
        if not self.on and not self.assumption:
            return Advice.CANDIDATE
        if not self.on and self.keys.ON_THE_GROUND:
            return Advice.GROUND
        if self.relative < accuracy:
            return Advice.NOT_NEEDED
        return Advice.KEEP if self.on else Advice.CONSIDER


def setting_of(scene: Scene, without: str = "", duration: float | None = None) -> EstimateBasis:
    """Return the basis of the estimates of a scene; bullets launched by a force have their final speed.

    without : effect that counts as off
    """
    net = weave(scene.net)
    position, velocity = initial_state(scene, net)
    launch = scene.effects.get(LaunchForce)
    if launch is not None and EFFECTS.get(without) is not LaunchForce:
        mass = net.mass[net.bullet_nodes]
        speed = np.sqrt(2.0 * launch.work / mass)
        velocity[net.bullet_nodes] += speed[:, None] * launch.barrels(net)
    lasts = scene.time.end if duration is None else duration
    return EstimateBasis(net, lasts, position, velocity, scene.effects.get(Orbit))


def survey(scene: Scene) -> list[Finding]:
    """Estimate every known effect; effects that are on first, then by decreasing displacement."""
    findings = [finding(scene, name) for name in EFFECTS]
    return sorted(findings, key=lambda effect: (not effect.on, -effect.relative))


def finding(scene: Scene, name: str, duration: float | None = None) -> Finding:
    """Estimate one effect; raise CaseError if its numbers, or those of the scene, overflow."""
    try:
        with np.errstate(all="ignore"):  # numbers that are not finite are refused
            return _finding(scene, name, duration)
    except ArithmeticError:
        raise beyond_floats(name) from None


def _finding(scene: Scene, name: str, duration: float | None) -> Finding:
    basis = setting_of(scene, name, duration)
    keys, assumption = scene.effects.on.get(name), ""
    has_table = keys is not None
    if keys is None:
        assumed = EFFECTS[name].nominal(basis)
        if assumed is None:
            return Finding(name, False, None, "", None, 0.0)
        keys, assumption = assumed
    estimate = keys.magnitude(basis)
    if estimate is None:
        return Finding(name, has_table, keys, assumption, None, 0.0)
    if not np.isfinite([estimate.acceleration, estimate.displacement]).all():
        raise beyond_floats(name)
    relative = estimate.displacement / basis.size
    threshold = scene.effects.threshold
    on = has_table and (threshold is None or relative >= threshold)
    return Finding(name, on, keys, assumption, estimate, relative)


def chosen(scene: Scene, faults: list[Fault]) -> tuple[Scene, tuple[str, ...]]:
    """Return the scene with the effects that matter, and notes on each candidate, with "auto".

    Another scene is returned unchanged.

    faults : receives faults of candidates whose numbers, or those of the scene, overflow; these stay on
    """
    choice = scene.effects
    if choice.threshold is None:
        return scene, ()
    off: dict[str, None] = {}
    notes = []
    for name in choice.on:
        one = None
        with joining(faults):
            one = finding(scene, name)
        if one is None:
            continue
        assert one.estimate is not None
        if not one.on:
            off[name] = None
        word, sign = ("on", ">=") if one.on else ("off", "<")
        notes.append(
            f"auto: {name} {word}: {one.relative:.1e} of the net's size {sign} {choice.threshold:g} "
            f"({one.estimate.source})"
        )
    return scene.model_copy(update={"effects": choice.model_copy(update=off)}), tuple(notes)


def without_choice(asked: Scene, resolved: Scene) -> tuple[str, ...]:
    """Return overrides that switch on the effects that `chosen` kept, for the reference."""
    if asked.effects.choose is None:
        return ()
    off = set(asked.effects.on) - set(resolved.effects.on)
    return tuple(f"effects.{name}=" for name in ("choose", "threshold", *sorted(off)))
