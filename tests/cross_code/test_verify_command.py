"""`exunet verify`: exit codes, report, processes and interrupts."""

from __future__ import annotations

import multiprocessing
import os
import pickle
from collections.abc import Iterable
from functools import partial
from html import unescape
from pathlib import Path
from typing import Any

import matplotlib.figure
import pytest

import reference_impl
from exunet.base.cases import shipped
from exunet.base.errors import InputError, Interrupted
from exunet.cli import verify as command
from exunet.methods.method import Backend
from exunet.verification import hard
from exunet.verification.check import Check, Finding, skipped
from exunet.verification.figures import picture
from exunet.verification.suite import AT_STATES, KNOWN, NETS, Item, run, suite
from exunet.verification.tolerances import FORCES, Tolerance

PAPER = shipped()["planar_deployment"]
BOUND = Tolerance(1.0, "a reason", "x")


def findings(*errors: float) -> Iterable[Finding]:
    for error in errors:
        yield Check(f"error {error:g}", error, BOUND, "node 3", 2.0, 1.5)
    yield pickle.loads(pickle.dumps(Check("forces", 0.0, FORCES)))  # as from another process
    yield skipped("the rest", "no time")
    yield picture("figure", matplotlib.figure.Figure(), "a caption")


def interrupts() -> Iterable[Finding]:
    raise Interrupted("interrupted after t = 0.1 s")


def dies() -> Iterable[Finding]:
    os._exit(3)


@pytest.mark.parametrize(
    ("second", "code"), [((0.5,), 0), ((2.0,), 1), ((float("nan"),), 1), (None, 130)], ids=str
)
def test_exit_code_and_report(
    second: Any,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """All hold: 0; one fails: 1; Ctrl-C: 130, and the report contains what was done."""
    items = [Item(NETS, "a net", partial(findings, 0.25))]
    items.append(Item(KNOWN, "another", interrupts if second is None else partial(findings, *second)))
    monkeypatch.setattr(command, "suite", lambda *how, **more: items)
    folder = tmp_path / "deep" / "report"
    assert command.verify([], folder, quick=False, processes=1) == code
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert [path.name for path in folder.iterdir()] == ["report.html"]
    assert "0.25 x" in page
    assert "data:image/png;base64," in page
    assert ("INCOMPLETE" in page) == (code == 130)
    assert ("Failing checks" in page) == (code == 1)
    assert "a reason" not in page  # of the tolerances of the suite, those of the checks
    assert FORCES.reason in unescape(page)
    assert ("FAILS another" in capsys.readouterr().out) == (code == 1)


def test_a_folder_that_cannot_be_written_is_refused_before_anything_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(
        command, "suite", lambda *how, **more: [Item(NETS, "a net", lambda: pytest.fail("ran"))]
    )
    with pytest.raises(InputError):
        command.verify([], tmp_path / "file" / "report", quick=True, processes=1)


def test_a_case_out_of_reach_is_refused_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(path: Path, overrides: Any) -> Any:
        raise reference_impl.Refused(["effects.magnetism: not known"])

    monkeypatch.setattr(reference_impl, "read", refuses)
    (tmp_path / "own.toml").write_text(PAPER.read_text())
    with pytest.raises(InputError, match=r"own: .*effects\.magnetism"):
        command.verify([tmp_path / "own.toml"], tmp_path / "out", quick=True)
    assert not (tmp_path / "out").exists()


def test_a_wrong_force_fails_the_quick_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from exunet.forces import cable

    tension = cable.tension
    monkeypatch.setattr(cable, "tension", lambda *a, **k: 1.001 * tension(*a, **k))
    assert command.verify([PAPER], tmp_path, quick=True, processes=1) == 1
    assert "tension, results" in capsys.readouterr().out


def test_ctrl_c_is_no_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run's `Interrupted` is a RunStopped too: taken for one, the hard cases would go on."""

    def interrupted(_start: Any) -> Any:
        raise Interrupted("interrupted after t = 0.1 s")

    monkeypatch.setattr(hard, "simulate", interrupted)
    on = Backend.COMPILED
    for work in (partial(hard.on_backend, hard.GALLERY[0], on), partial(hard.above, on)):
        with pytest.raises(KeyboardInterrupt):
            Item(hard.SECTIONS[0], "a case", work).run()


@pytest.mark.ci
@pytest.mark.slow
def test_processes_give_the_same_findings_and_an_interrupt_ends_them() -> None:
    items = [Item(NETS, str(k), partial(findings, float(k))) for k in range(4)]
    alone, together = (
        {item.subject: [repr(finding) for finding in found] for item, found in run(items, processes)}
        for processes in (1, 2)
    )
    assert together == alone  # as text: NaN differs from itself
    going = run(items, 2)
    next(going)
    going.close()
    assert multiprocessing.active_children() == []


@pytest.mark.ci
@pytest.mark.slow
def test_a_process_that_dies_fails_the_items_without_findings() -> None:
    found = dict(run([Item(NETS, "a", dies), Item(NETS, "b", dies)], 2))
    assert [check.holds for rows in found.values() for check in rows if isinstance(check, Check)] == [
        False
    ] * 2
    assert multiprocessing.active_children() == []


def test_items_of_a_named_case() -> None:
    """A net has all sections; bodies that are pulled no statistics; no case has the known answers."""
    net, pulled = ({item.section for item in suite([path])} for path in (PAPER, shipped("bodies")["snap"]))
    assert len(net) == 4
    assert len(pulled) == 3
    assert {NETS, AT_STATES} <= net & pulled
    assert KNOWN not in net
    assert len(suite([PAPER, PAPER])) == len(suite([PAPER]))  # a case named twice is verified once
