"""Known answers: closed forms and invariants, each of a short case that both codes run."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from exunet.studies.both_codes import BothCodes
from exunet.verification.answers import bodies, motions, mouth
from exunet.verification.check import Finding

Answer = Callable[[BothCodes], Iterator[Finding]]

# Case below cases/verification/, its answer, and whether that takes about a second.
ANSWERS: tuple[tuple[str, Answer, bool], ...] = (
    ("snap", motions.snap, True),
    ("snap_from_slack", motions.snap, True),
    ("wave_small_stretch", motions.waves, False),
    ("wave_large_stretch", motions.waves, False),
    ("taut_net", motions.vibration, False),
    ("square_net", motions.stable_steps, True),
    ("taut_net", motions.near_the_limit, True),
    ("square_net", mouth.areas, True),
    ("free_net", mouth.areas, True),
    ("hanging", motions.hanging, False),
    ("pendulum", motions.pendulum, False),
    ("free_net", motions.free_net, False),
    ("rotating", motions.braking, False),
    ("bodies/free_bodies", bodies.free_rotation, False),
    ("bodies/snap_of_bodies", motions.snap, True),
    ("bodies/snap_off_centre", bodies.snap_off_centre, False),
    ("bodies/two_tethers", bodies.snap_off_centre, False),
    ("bodies/braked_body", bodies.braked, True),
    ("bodies/whirled", bodies.whirled, False),
    ("bodies/librations", bodies.librations, False),
    ("bodies/reel_rate", bodies.at_a_rate, False),
    ("bodies/reel_force", bodies.with_a_force, False),
    ("bodies/reel_nodes", bodies.exchanges, False),
    ("bodies/led_winch", bodies.exchanges, False),
)
