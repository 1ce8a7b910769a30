"""Expected wall time of a run, and refusals of runs without room."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

import exunet
from exunet.base.errors import InputError
from exunet.simulation import expected_time as module
from exunet.simulation.expected_time import expected_time, stored_bytes, validate_disk
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.simulation import Simulation

PLANAR = Path(__file__).parent.parent / "cases" / "planar_deployment.toml"


def start(*overrides: str) -> Start:
    return prepare(exunet.load(PLANAR, ["engine.backend=compiled", *overrides]).scene)


def test_the_pace_of_the_first_steps_is_multiplied(monkeypatch: pytest.MonkeyPatch) -> None:
    """Equal steps of 1e-4 s over 2 s are 20,000; each takes 1 ms of a clock that counts steps."""
    made: list[Simulation] = []

    def counted(given: Start) -> Simulation:
        made.append(Simulation(given))
        return made[-1]

    monkeypatch.setattr(module, "Simulation", counted)
    clock = SimpleNamespace(perf_counter=lambda: 1e-3 * made[0].counts.steps)
    monkeypatch.setattr(module, "clock", clock)
    seconds = expected_time(start("solver={method='RK44', step=1e-4}"))
    assert seconds == pytest.approx(20.0, rel=0.05)  # stops between the steps shorten some
    assert 300 < made[0].counts.steps < 1000


def test_steps_that_fail_have_no_time() -> None:
    """A hundred times the stable step: the run diverges within the timed steps."""
    setting = "solver={method='RK44', step=2.5e-2, force=true, retry=0}"
    assert expected_time(start(setting, "time.output_step=0.1")) is None


def test_states_beyond_the_disk_or_memory_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begin = start("time.end=0.01")
    validate_disk(begin, tmp_path)
    monkeypatch.setattr(module, "disk_left", lambda _folder: 2 * stored_bytes(begin) - 1)
    with pytest.raises(InputError, match=r"11 stored states .* of disk"):
        validate_disk(begin, tmp_path)
    monkeypatch.setattr(module, "memory_left", lambda: stored_bytes(begin) - 1)
    with pytest.raises(InputError, match="of memory"):
        exunet.run(begin)
