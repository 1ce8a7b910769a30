"""Ctrl-C at any moment: what was computed is kept, an earlier result stays, and the message has the time."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import (
    CASES,
    PLANAR,
    SHORT,
    WRITING_OFTEN,
    command,
    ended,
    process,
    states_stored,
    wait_until,
)
from scenes import BACKENDS, every_backend

import exunet
from exunet.base.errors import Interrupted
from exunet.base.interrupt import postponed
from exunet.integrators.exudyn.stepper import ExudynStepper
from exunet.results.run_folder import has_unfinished
from exunet.simulation import run as runs
from exunet.simulation.integrate import Integration
from exunet.simulation.recorder import Recorder

OUTPUT_STEP = 1e-3  # [s]; in free flight each interval is one step, and a batch of the guards 256 of them
PRESSED = 0.3  # [s] of simulated time; the strings snap taut at 0.57 s
# Between two intervals, while a state is stored; and within the last step of an interval.
MOMENTS: dict[str, list[tuple[type, str, Callable[[Any], float]]]] = {
    "storing": [(Recorder, "observe", lambda recorder: recorder.until)],
    "stepping": [
        (ExudynStepper, "_before_attempt", lambda stepper: stepper.time),
        (Integration, "_step", lambda run: run.stepper.time),
    ],
}

pytestmark = pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")


@pytest.mark.parametrize("moment", MOMENTS)
@every_backend
def test_all_that_was_computed_is_kept(backend: str, moment: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pressed once, in the middle of the run, right after a method has done its work."""
    pressed: list[float] = []

    def press_after(owner: type, name: str, now: Callable[[Any], float]) -> None:
        original = getattr(owner, name)

        def method(self: Any, *arguments: Any) -> Any:
            done = original(self, *arguments)
            if now(self) >= PRESSED and not pressed:
                pressed.append(now(self))
                os.kill(os.getpid(), signal.SIGINT)
            return done

        monkeypatch.setattr(owner, name, method)

    for item in MOMENTS[moment]:
        press_after(*item)
    overrides = ["time.end=0.5", f"time.output_step={OUTPUT_STEP}", BACKENDS[backend]]
    with pytest.raises(Interrupted) as stop:
        exunet.run(exunet.load(CASES / "planar_undamped.toml", overrides))
    part = stop.value.result
    assert part is not None
    assert not part.complete
    reported = re.search(r"t = ([\d.e+-]+) s$", str(stop.value))
    assert reported
    assert abs(float(reported[1]) - part.time[-1]) < 1e-9
    assert abs(part.time[-1] - pressed[0]) < 1.5 * OUTPUT_STEP  # at most the step that was under way
    assert len(part.time) == round(part.time[-1] / OUTPUT_STEP) + 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@every_backend
def test_discrete_states_of_a_contact_are_stored_until_the_interrupt(backend: str) -> None:
    """The step that reaches a stored time is followed by the report of discrete states."""
    pressed: list[float] = []

    def progress(time: float, *_: object) -> None:
        if not pressed:
            pressed.append(time)
            os.kill(os.getpid(), signal.SIGINT)

    case = CASES / "verification" / "contact" / "threads.toml"
    with pytest.raises(Interrupted) as stop:
        exunet.run(exunet.load(case, [BACKENDS[backend]]), progress)
    result = stop.value.result
    assert pressed
    assert result is not None
    assert {len(states.values) for states in result.contacts.values()} == {len(result.time)}


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
        check()  # the earlier Ctrl-C is forgotten


# The command


@pytest.mark.ci
@pytest.mark.slow
def test_ctrl_c_keeps_the_part_done(tmp_path):
    """Pressed in the middle of the run: once some of it can be read."""
    arguments = ("run", PLANAR, "--set", "time.end=1000", "--set", "time.output_step=0.05", "--out", "here")
    running = process(*arguments, folder=tmp_path, program=WRITING_OFTEN)
    wait_until(lambda: states_stored(tmp_path / "here") > 2, running)
    running.send_signal(signal.SIGINT)
    done = ended(running)
    assert done.returncode == 130
    assert "interrupted after t = " in done.stderr
    assert "Traceback" not in done.stderr
    assert not has_unfinished(tmp_path / "here")
    result = exunet.load_result(tmp_path / "here")
    assert not result.complete
    assert result.verdict.startswith("interrupted")
    assert len(result.time) > 2


@pytest.mark.slow
@pytest.mark.parametrize("module", ["typer", "h5py", "exudyn"])
def test_ctrl_c_at_start_up_is_clean_and_leaves_no_folder(tmp_path, module):
    """Ctrl-C while the command, or what it needs, is being imported: its modules come first."""
    (tmp_path / f"{module}.py").write_text("raise KeyboardInterrupt")
    arguments = ("run", PLANAR, *SHORT, "--check", "--out", "results/here")
    done = ended(process(*arguments, folder=tmp_path))
    assert done.returncode in (130, -signal.SIGINT)
    assert done.stderr.splitlines()[-1] == "interrupted"
    assert "Traceback" not in done.stderr
    assert {path.name for path in tmp_path.iterdir()} <= {f"{module}.py", "__pycache__"}


@pytest.mark.slow
def test_ctrl_c_while_the_result_is_written_keeps_the_states(tmp_path, monkeypatch):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "write_rows", interrupted)
    done = command("run", PLANAR, *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 130
    assert "exunet resume here" in done.stderr
    monkeypatch.undo()
    assert command("resume", "here", folder=tmp_path).returncode == 0
    assert not has_unfinished(tmp_path / "here")


@pytest.mark.slow
def test_ctrl_c_while_the_reference_runs_keeps_the_result(tmp_path: Path):
    """Pressed when the result is written; a package of its name stands in for a slow reference."""
    package = tmp_path / "reference_impl"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text("import time\n\nprint('known', flush=True)\ntime.sleep(3600)\n")
    running = process("run", PLANAR, "--check", "--out", "here", *SHORT, folder=tmp_path)
    result = tmp_path / "here/result.h5"
    wait_until(lambda: result.exists() and exunet.load_result(result).complete, running)
    running.send_signal(signal.SIGINT)
    done = ended(running)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr
    assert exunet.load_result(result).complete
