"""Known answers: closed forms and invariants, each of a short case that both codes run."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from exunet.studies.both_codes import BothCodes
from exunet.verification.answers import bodies, linear, motions, mouth, reels, turning
from exunet.verification.check import Finding

Answer = Callable[[BothCodes], Iterator[Finding]]

# Case below cases/verification/, its answer, and whether that takes about a second.
ANSWERS: tuple[tuple[str, Answer, bool], ...] = (
    ("snap", motions.snap, True),
    ("snap_from_slack", motions.snap, True),
    ("wave_small_stretch", linear.waves, False),
    ("wave_large_stretch", linear.waves, False),
    ("taut_net", linear.vibration, False),
    ("square_net", linear.stable_steps, True),
    ("taut_net", linear.near_the_limit, True),
    ("square_net", mouth.areas, True),
    ("free_net", mouth.areas, True),
    ("hanging", motions.hanging, False),
    ("pendulum", motions.pendulum, False),
    ("free_net", motions.free_net, False),
    ("rotating", motions.braking, False),
    ("bodies/free_bodies", turning.free_rotation, False),
    ("bodies/snap_of_bodies", motions.snap, True),
    ("bodies/snap_off_centre", bodies.snap_off_centre, False),
    ("bodies/two_tethers", bodies.snap_off_centre, False),
    ("bodies/braked_body", bodies.braked, True),
    ("bodies/whirled", bodies.whirled, False),
    ("bodies/librations", bodies.librations, False),
    ("bodies/reel_rate", reels.at_a_rate, False),
    ("bodies/reel_force", reels.with_a_force, False),
    ("bodies/reel_nodes", reels.exchanges, False),
    ("bodies/led_winch", reels.exchanges, False),
)
