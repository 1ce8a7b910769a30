"""Metrics are not shifted without an accuracy; disk and memory of a run."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

import exunet
from exunet.base.errors import InputError
from exunet.simulation import recorder
from exunet.simulation.preparation import Start, prepare
from exunet.simulation.recorder import stored_bytes, validate_disk

ROOT = Path(__file__).parents[2]


def benchmark() -> Any:
    """benchmarks/measures.py, which is no package."""
    spec = importlib.util.spec_from_file_location("measures_benchmark", ROOT / "benchmarks" / "measures.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # for its dataclasses
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rectangular", "gravity", "soft threads"])
def test_measures_are_not_shifted(name: str) -> None:
    """Two one-sided tests at 5 %, of scenes of benchmarks/measures.md: rectangular, forced, and soft."""
    found = benchmark().study(name)
    for measure, shift in found.shifts.items():
        assert shift is None or shift.shown, (measure, shift)


# Disk and memory

DEPLOYMENT = ROOT / "cases" / "planar_deployment.toml"


def timed_start(*overrides: str) -> Start:
    return prepare(exunet.load(DEPLOYMENT, ["engine.backend=compiled", *overrides]).scene)


def test_states_beyond_the_disk_or_memory_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begin = timed_start("time.end=0.01")
    validate_disk(begin, tmp_path)
    monkeypatch.setattr(recorder, "disk_left", lambda _folder: 2 * stored_bytes(begin) - 1)
    with pytest.raises(InputError, match=r"11 stored states .* of disk"):
        validate_disk(begin, tmp_path)
    monkeypatch.setattr(recorder, "memory_left", lambda: stored_bytes(begin) - 1)
    with pytest.raises(InputError, match="of memory"):
        exunet.run(begin)
