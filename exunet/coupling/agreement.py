"""Whether a port and its host's body are at the same place, and move alike."""

from __future__ import annotations

import math
from collections.abc import Mapping

from exunet.base.errors import InputError
from exunet.bodies.port import FrameState, difference

# At the start, in parts of the net's size, of the larger of 1 m/s or 1 rad/s and the speed, or in radians:
# what is left of numbers that were given with six digits.
_SAME = 1e-6
_LEAST_SIZE = 1e-3  # [m], of a net of one node


def apart(one: FrameState, other: FrameState, size: float) -> float:
    """How far apart two places are, in parts of a size [m], or two attitudes [rad]: the larger."""
    angle = math.hypot(*difference(one.attitude, other.attitude))
    return max(math.dist(one.position, other.position) / max(size, _LEAST_SIZE), angle)


def refuse_apart(who: str, name: str, port: FrameState, host: FrameState, size: float) -> None:
    """Raise InputError if a port and its host's body do not start alike."""
    for what, off, unit, scale in (
        ("position", math.dist(port.position, host.position), "m", max(size, _LEAST_SIZE)),
        ("attitude", math.hypot(*difference(port.attitude, host.attitude)), "rad", 1.0),
        ("velocity", math.dist(port.velocity, host.velocity), "m/s", max(1.0, math.hypot(*port.velocity))),
        (
            "angular_velocity",
            math.dist(port.angular_velocity, host.angular_velocity),
            "rad/s",
            max(1.0, math.hypot(*port.angular_velocity)),
        ),
    ):
        if off > _SAME * scale:
            values = " and ".join(_shown(getattr(state, what)) for state in (port, host))
            raise InputError(
                f"{who}: port {name}: its {what} at the start in the case and that in the host differ by "
                f"{off:.3g} {unit}: {values}. Give bodies.{name} the start that it has in the host"
            )


def refuse_elsewhere(
    who: str, time: float, left: Mapping[str, FrameState], found: Mapping[str, FrameState], size: float
) -> None:
    """Raise InputError if a run of the host does not begin where the coupling left its bodies at a time [s].

    size : as in `apart`
    """
    for name, state in left.items():
        if (off := apart(state, found[name], size)) > _SAME:
            raise InputError(
                f"{who}: the run of the host that begins at t = {time:.6g} s has its body at port {name} at "
                f"{_shown(found[name].position)} m, and the one before left it at {_shown(state.position)} m "
                f"({off:.3g} of the net's size or rad): {GOES_ON}"
            )


GOES_ON = (
    "a run goes on from another only if that was by mbs.SolveDynamic(..., updateInitialValues=True), else "
    "Exudyn begins from its first start; or restore a snapshot of the coupling"
)


def _shown(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"
