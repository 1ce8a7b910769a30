"""Ctrl-C at any moment of a run: what was computed is kept, and the message says until when."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from scenes import planar

import exunet
from exunet.base.errors import Interrupted
from exunet.base.interrupt import TimeIsUp, limited, postponed
from exunet.integrators.compiled.loop import CompiledLoop
from exunet.integrators.exudyn.stepper import Stepper
from exunet.simulation.recorder import Recorder
from exunet.simulation.run import simulate

CONTACT = Path(__file__).parents[1] / "cases" / "verification" / "contact" / "threads.toml"
OUTPUT_STEP = 1e-3  # [s]; in free flight each stretch is one step, and a batch of the guards 256 of them
PRESSED = 0.3  # [s] of simulated time; the strings snap taut at 0.57 s
BACKENDS = {
    "exudyn": 'engine.backend="exudyn"',
    "compiled": 'engine.backend = "compiled"',
}
# Between two stretches, while a state is stored; and within the last step of a stretch.
MOMENTS: dict[str, list[tuple[type, str, Callable[[Any], float]]]] = {
    "storing": [(Recorder, "store", lambda recorder: recorder.until)],
    "stepping": [
        (Stepper, "_before_attempt", lambda stepper: stepper.time),
        (CompiledLoop, "_look_for_events", lambda loop: loop.time),
    ],
}

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")


def press_ctrl_c(
    patch: pytest.MonkeyPatch, owner: type, name: str, now: Callable[[Any], float], pressed: list[float]
) -> None:
    """Once, in the middle of the run, right after the method `name` has done its work."""
    original = getattr(owner, name)

    def method(self: Any, *arguments: Any) -> Any:
        done = original(self, *arguments)
        if now(self) >= PRESSED and not pressed:
            pressed.append(now(self))
            os.kill(os.getpid(), signal.SIGINT)
        return done

    patch.setattr(owner, name, method)


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("form", BACKENDS)
def test_all_that_was_computed_is_kept(form: str, moment: str, monkeypatch: pytest.MonkeyPatch) -> None:
    start = planar("time.end = 0.5", f"time.output_step = {OUTPUT_STEP}", BACKENDS[form])
    pressed: list[float] = []
    for method in MOMENTS[moment]:
        press_ctrl_c(monkeypatch, *method, pressed)
    with pytest.raises(Interrupted) as stop:
        simulate(start)
    part = stop.value.result
    assert part is not None
    assert not part.complete
    said = re.match(r"interrupted after t = ([\d.e+-]+) s$", str(stop.value))
    assert said
    assert abs(float(said[1]) - part.time[-1]) < 1e-9
    assert abs(part.time[-1] - pressed[0]) < 1.5 * OUTPUT_STEP  # at most the step that was under way
    assert len(part.time) == round(part.time[-1] / OUTPUT_STEP) + 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("form", BACKENDS)
def test_discrete_states_of_a_contact_are_stored_until_the_interrupt(form: str) -> None:
    """The step that reaches a stored time is followed by the report of discrete states."""
    pressed: list[float] = []

    def progress(time: float, *_: object) -> None:
        if not pressed:
            pressed.append(time)
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(Interrupted) as stop:
        exunet.run(exunet.load(CONTACT, [BACKENDS[form]]), progress)
    result = stop.value.result
    assert pressed
    assert result is not None
    assert {len(states.values) for states in result.states.values()} == {len(result.time)}


def test_a_block_in_another_leaves_ctrl_c_to_it() -> None:
    reached: list[object] = []

    def nested() -> None:
        with postponed() as outer:
            with postponed() as inner:
                os.kill(os.getpid(), signal.SIGINT)
            reached.append(inner is outer)
            outer()
            reached.append("after it")

    with pytest.raises(KeyboardInterrupt):
        nested()
    assert reached == [True]
    with postponed() as check:
        check()  # what the block before was told is forgotten


def test_a_limit_of_time_counts_from_the_first_look_on_and_ends_with_its_block():
    with limited(0.0):
        with postponed():  # looks at its end; what is compiled before that costs nothing
            pass
        with pytest.raises(TimeIsUp), postponed() as look:
            for_ever(look)
        with pytest.raises(TimeIsUp), postponed():
            pass
    with postponed() as look:
        look()
        look()


def for_ever(look: Callable[[], None]) -> None:
    while True:
        look()
