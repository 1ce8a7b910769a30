"""Why captures fail: small scenes that fail for different reasons, by outcome, cause and what is printed."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from scenes import NET_AT_BALL, of_text

import exunet
from exunet.results.observables import Observables
from exunet.results.outcome import Cause, Outcome, Reason, RunOutcome, outcome, reason
from exunet.results.summary import summary_of
from exunet.results.table import text


class Failure(NamedTuple):
    """Changes of the scene, and what follows from them.

    numbers : of the cause, by name: smallest and largest value
    """

    settings: tuple[str, ...]
    outcome: Outcome
    cause: Cause
    numbers: dict[str, tuple[float, float]]


WINCH = "closing.winch.commands=[{at=0.2, mode='tension', force=%g}, {at=1.2, mode='lock'}]"
FAR = "bodies.ball.position=[0.0, 0.0, %g]"
FAILURES = {
    "reel brakes": Failure(  # 3 N take the momentum of 0.19 kg m/s in 0.06 s, once it is at its force
        ("tethers.tow.reel.commands=[{at=0.0, mode='brake', force=3.0}]", FAR % 1.5),
        Outcome.MISSED,
        Cause.REEL_BRAKES,
        {"force_N": (1.0, 3.5), "speed_before_m_s": (1.99, 2.01), "speed_after_m_s": (-0.5, 0.0)},
    ),
    "winch too weak": Failure(
        (WINCH % 0.2,),
        Outcome.WRAPPED,
        Cause.WINCH_TOO_WEAK,
        {
            "force_N": (0.05, 0.2),
            "limit_N": (0.2, 0.2),
            "wound_m": (0.2, 0.5),
            "windable_m": (3.6 - 1e-9, 3.6 + 1e-9),
        },
    ),
    "locked too early": Failure(
        ("closing.winch.commands=[{at=0.2, mode='tension', force=2.5}, {at=0.4, mode='lock'}]",),
        Outcome.WRAPPED,
        Cause.WINCH_STOPPED,
        {"force_N": (0.3, 0.7), "limit_N": (2.5, 2.5)},
    ),
    "missed sideways": Failure(  # the mouth of 1 m2 is 1.41 m wide from corner to corner, 0.98 of it at first
        ("bodies.ball.position=[1.5, 0.0, 0.5]",),
        Outcome.MISSED,
        Cause.MISSED_SIDEWAYS,
        {"offset_m": (1.499, 1.501), "largest_m": (1.385, 1.415)},
    ),
    "passed by": Failure(  # packed to 0.2 m, whose diagonal is 0.28 m
        ("bodies.ball.position=[0.45, 0.0, 0.5]", "initial.packing=0.2"),
        Outcome.MISSED,
        Cause.PASSED_BY,
        {"offset_m": (0.449, 0.451), "mouth_m": (0.27, 0.29)},
    ),
    "mouth open": Failure(
        ("closing.winch.commands=[]",), Outcome.WRAPPED, Cause.MOUTH_OPEN, {"mouth_m": (0.6, 1.0)}
    ),
    "slipped off": Failure(  # the line stays 1.8 m long, as long as the rim of a disc of 0.57 m
        ("closing.winch.shortest=1.8", "time.end=2.5"),
        Outcome.ESCAPED,
        Cause.SLIPPED_OFF,
        {"enclosed": (0.99, 1.0), "mouth_m": (0.57, 0.7)},
    ),
    "thread broke": Failure(  # the winch pulls with 6 N at threads of 1 N
        ("tethers=", "bodies.chaser=", "effects.breaking={force=1.0}", WINCH % 6.0),
        Outcome.ESCAPED,
        Cause.THREAD_BROKE,
        {"broken": (1.0, 40.0)},
    ),
    "too slow": Failure(
        ("initial.velocity=[0.0, 0.0, 0.2]", FAR % 1.0),
        Outcome.UNDETERMINED,
        Cause.TOO_SLOW,
        {"speed_m_s": (0.16, 0.2), "distance_m": (0.4, 0.5), "arrival_s": (2.0, 3.0)},  # the reel slows it
    ),
    "enclosed in part": Failure(  # inside until the end, between half and the bound
        ("capture.enclosed=0.95",),
        Outcome.WRAPPED,
        Cause.CONDITION,
        {"value": (0.85, 0.95 - 1e-9), "bound": (0.95, 0.95)},
    ),
    "target flies away": Failure(  # 2 m/s after 3 m/s, from 0.35 m
        ("bodies.ball.velocity=[0.0, 0.0, 3.0]",),
        Outcome.MISSED,
        Cause.NOT_REACHED,
        {"speed_m_s": (-1.0, -0.99), "distance_m": (0.35, 0.352)},
    ),
    "not thrown": Failure(
        ("initial.velocity=[0.0, 0.0, 0.0]",),
        Outcome.MISSED,
        Cause.NOT_REACHED,
        {"speed_m_s": (-0.1, 0.1), "distance_m": (0.34, 0.352)},
    ),
    "target behind": Failure(  # the reel pulls the net back towards it later
        (FAR % -5.0,), Outcome.MISSED, Cause.NOT_REACHED, {"speed_m_s": (-2.01, -1.99)}
    ),
    "bounces on its tether": Failure(  # taut after 0.3 m of its way
        ("tethers.tow.reel=", "tethers.tow.length=0.4", FAR % 1.5),
        Outcome.MISSED,
        Cause.TETHER_TAUT,
        {"length_m": (0.4 - 1e-9, 0.4 + 1e-9), "speed_before_m_s": (1.99, 2.01)},
    ),
}


def judged(*settings: str) -> tuple[RunOutcome, Reason | None, str]:
    """Outcome, cause, and the first fifteen lines that `exunet run` prints, in one line."""
    run = Observables(exunet.run(of_text(NET_AT_BALL, *settings)))
    found = outcome(run)
    assert found is not None
    lines = text(summary_of(run, None, None)).splitlines()[:15]
    return found, reason(run), " ".join(" ".join(lines).split())


@pytest.mark.slow
@pytest.mark.ci
@pytest.mark.parametrize("name", FAILURES)
def test_the_cause_of_a_failed_capture(name: str) -> None:
    failure = FAILURES[name]
    found, why, printed = judged(*failure.settings)
    assert why is not None
    assert (found.outcome, why.cause) == (failure.outcome, failure.cause)
    assert 0.0 <= why.start <= why.end
    for key, (low, high) in failure.numbers.items():
        assert low <= why.numbers[key] <= high, key
    assert str(why) in printed


@pytest.mark.slow
@pytest.mark.ci
def test_a_capture_and_runs_of_it_that_end_too_early() -> None:
    """Captured, closing while the winch moves, and undetermined before the conditions have held for 0.3 s."""
    found, why, _ = judged("time.end=2.1")
    assert (found.outcome, why) == (Outcome.CAPTURED, None)
    assert found.since is not None
    found, why, _ = judged(f"time.end={found.since + 0.2}")
    assert found.outcome is Outcome.UNDETERMINED
    assert why is not None
    assert why.cause is Cause.ENDED_EARLY
    assert why.numbers["held_s"] == pytest.approx(0.2, abs=0.011)
    found, why, _ = judged("time.end=0.6")
    assert why is not None
    assert (found.outcome, why.cause) == (Outcome.CLOSING, Cause.STILL_CLOSING)
    found, why, _ = judged("time.end=0.5")  # in the net since 0.26 s
    assert why is not None
    assert (found.outcome, why.cause) == (Outcome.UNDETERMINED, Cause.ENDED_EARLY)
    assert why.numbers["held_s"] == pytest.approx(0.24, abs=0.011)
