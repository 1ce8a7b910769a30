"""Rung 6: known answers, each from a short case of its own that both codes run."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from exunet.studies.both_codes import BothCodes
from exunet.verification.answers import balance, modes, mouth, orders, rest, rotation, snap, verlet
from exunet.verification.check import Finding

Answer = Callable[[BothCodes], Iterator[Finding]]

# What is known of the case of that name under cases/verification/.
ANSWERS: tuple[tuple[str, Answer], ...] = (
    ("snap", snap.snap),
    ("wave_small_stretch", modes.waves),
    ("wave_large_stretch", modes.waves),
    ("taut_net", modes.vibration),
    ("square_net", verlet.stable_steps),
    ("taut_net", verlet.near_the_limit),
    ("square_net", mouth.areas),
    ("free_net", mouth.areas),
    ("hanging", rest.hanging),
    ("pendulum", rotation.pendulum),
    ("free_net", balance.free_net),
    ("rotating", rotation.braking),
    ("smooth", orders.smooth),
    ("snap_from_slack", orders.with_kink),
)
