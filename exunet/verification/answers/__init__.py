"""Known answers, each from a short case of its own that both codes run: rung 6, and of bodies rung 8."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from exunet.studies.both_codes import BothCodes
from exunet.verification.answers import bodies, linear, motions, mouth, orders, reels, turning
from exunet.verification.check import Evidence

Answer = Callable[[BothCodes], Iterator[Evidence]]

# What is known of the case of that name under cases/verification/.
ANSWERS: tuple[tuple[str, Answer], ...] = (
    ("snap", motions.snap),
    ("wave_small_stretch", linear.waves),
    ("wave_large_stretch", linear.waves),
    ("taut_net", linear.vibration),
    ("square_net", linear.stable_steps),
    ("taut_net", linear.near_the_limit),
    ("square_net", mouth.areas),
    ("free_net", mouth.areas),
    ("hanging", motions.hanging),
    ("pendulum", motions.pendulum),
    ("free_net", motions.free_net),
    ("rotating", motions.braking),
    ("smooth", orders.smooth),
    ("snap_from_slack", orders.with_kink),
)

# What is known of the case of that name under cases/verification/bodies/.
BODY_ANSWERS: tuple[tuple[str, Answer], ...] = (
    ("free_bodies", turning.free_rotation),
    ("snap_of_bodies", motions.snap),
    ("snap_off_centre", bodies.snap_off_centre),
    ("two_tethers", bodies.snap_off_centre),
    ("braked_body", bodies.braked),
    ("whirled", bodies.whirled),
    ("librations", bodies.librations),
    ("reel_rate", reels.at_a_rate),
    ("reel_force", reels.with_a_force),
    ("reel_nodes", reels.exchanges),
    ("led_winch", reels.exchanges),
)
