"""The ladder of verification: that it holds, that it can fail, and what it leaves behind."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import t as student_t

from exunet.base.errors import InputError
from exunet.cli.verify import verify
from exunet.net import TOPOLOGIES
from exunet.simulation.guards import ENERGY_BOUND
from exunet.studies.both_codes import both_of_text, read_both
from exunet.verification import states, tolerances
from exunet.verification.check import Check, shipped, worst_of
from exunet.verification.ladder import Ladder
from exunet.verification.matrices import matrices
from exunet.verification.one_step import Step, one_step
from exunet.verification.states import forces, measures
from exunet.verification.topology import random_topologies, topology
from reference_impl.read import Refused, read_document

CASES = [*shipped().values(), *shipped("verification/trajectories").values()]
PAPER = shipped()["planar_deployment"]


@pytest.mark.slow
@settings(max_examples=40, deadline=None, derandomize=True)
@given(topology=st.sampled_from(sorted(states.TOPOLOGIES)), seed=st.integers(0, 2**32 - 1))
def test_random_nets_are_the_same_in_both_codes(topology, seed):
    kind, text = states.random_case(np.random.default_rng(seed), topology)
    checks = list(globals()["topology"](both_of_text(kind, text)))
    assert [check.worst for check in checks if not check.holds] == []
    assert len(checks) == 2


def test_random_nets_cover_all_topologies_of_the_reference():
    """Whose names are in its refusal of another one."""
    with pytest.raises(Refused) as refused:
        read_document({"format": 1, "net": {"topology": "unknown"}})
    known = re.search(r'topology = "unknown": it knows (.*)', str(refused.value))
    assert set(states.TOPOLOGIES) == set(known[1].split(", "))
    assert set(states.TOPOLOGIES) <= set(TOPOLOGIES)


@pytest.mark.parametrize(
    "path", [*CASES, *shipped("effects").values()], ids=lambda path: f"{path.parent.name}-{path.stem}"
)
def test_forces_of_a_case_agree(path):
    """At two states of each kind: so little that the quick tests find an error in the force of any effect."""
    for check in forces(read_both(path), 2):
        assert check.holds, f"{check.name}: {check.measured} ({check.worst})"


@pytest.mark.ci_for("bending")
@pytest.mark.slow_for(
    "bending", "air_drag", "two_body", "launch_gas", "thrown_fine", "launch_spring", "bending_thread"
)
@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_states_of_a_case_agree(path):
    case = read_both(path)
    for rung in (topology, lambda case: forces(case, 10), measures, matrices, one_step):
        for check in rung(case):
            assert check.holds, f"{check.name}: {check.measured} ({check.worst})"


def test_the_reference_gets_the_effects_that_exunet_has_chosen():
    """All but mass damping are below the threshold of the case: docs/effects.md has the estimates."""
    case = read_both(shipped("effects")["auto"])
    assert case.effects == {"mass_damping"}
    theirs = case.theirs.case.effects
    assert theirs.mass_damping == 0.2
    assert theirs.orbit is None
    assert theirs.bending is None
    assert theirs.solar_pressure is None


def test_states_agree_with_the_net_of_exudyn():
    case = read_both(PAPER)
    for rung in (lambda case: forces(case, 10), matrices, one_step):
        for check in rung(case):
            assert check.holds, f"{check.name}: {check.measured} ({check.worst})"


@pytest.mark.parametrize("kind", ["radial", "hexagonal", "explicit"])
def test_states_of_random_nets_agree(kind):
    """Topologies that no shipped case has; the seed only fixes which nets are drawn."""
    random = np.random.default_rng(7)
    for k in range(3):
        case = both_of_text(f"{kind}-{k}", states.random_case(random, kind)[1])
        for check in (*forces(case, 10), *matrices(case)):
            assert check.holds, f"{check.name}: {check.measured} ({check.worst})"


def test_measures_name_the_state_where_they_differ(monkeypatch):
    from reference_impl import forces as formulas

    right = formulas.tension

    seen = []

    def wrong(system, x, intact, lengths):
        seen.append(1)
        pull = right(system, x, intact, lengths)
        if len(seen) == 4:
            pull[17] += 1.0  # [N]
        return pull

    monkeypatch.setattr(formulas, "tension", wrong)
    case = read_both(PAPER)
    (check,) = (check for check in measures(case) if not check.holds)
    ours = int(np.flatnonzero(case.reference_elements == 17)[0])
    assert check.name == "tension, 120 random states"
    assert f"state 3, number {ours}: " in check.worst
    assert check.worst.endswith(" N")


def test_kinds_of_states_are_what_they_are_called():
    net = read_both(PAPER).start.net
    random = np.random.default_rng(1)
    i, j = net.element_nodes.T

    def stretches(kind):
        drawn = states.random_states(net, kind, 20, random)
        return np.array([np.linalg.norm(x[j] - x[i], axis=1) / net.reference_length for x, _ in drawn])

    assert stretches("packed").max() < 1
    assert stretches("taut").min() > 1
    assert stretches("overstretched").min() > 1.05
    assert (stretches("coincident") == 0).any(axis=1).all()
    crumpled = stretches("crumpled")
    assert ((crumpled < 1).any(axis=1) & (crumpled > 1).any(axis=1)).all()


def test_half_slack_state_is_away_from_the_kink():
    net = read_both(PAPER).start.net
    position = states.smooth_states(net, np.random.default_rng(3))["half slack"]
    i, j = net.element_nodes.T
    strain = 0.5 * ((np.linalg.norm(position[j] - position[i], axis=1) / net.reference_length) ** 2 - 1)
    assert strain.min() < 0 < strain.max()
    assert np.abs(strain).min() > states.CLEAR_OF_THE_KINK


def test_a_measurement_that_is_no_number_fails():
    check = Check("name", math.nan, tolerances.FORCES)
    assert not check.holds
    fine = Check("fine", 0.0, tolerances.FORCES)
    assert worst_of("both", [fine, check]).worst.startswith("name")


def test_every_tolerance_is_demanded_of_something():
    """One that no rung uses would stand in the report's table for a check that nobody makes."""
    named = {name for name, value in vars(tolerances).items() if isinstance(value, tolerances.Tolerance)}
    folder = Path(tolerances.__file__).parent
    texts = [path.read_text() for path in folder.rglob("*.py") if path.name != "tolerances.py"]
    imports = re.compile(r"^from exunet\.verification\.tolerances import (\([^)]*\)|.*)$", re.MULTILINE)
    used = {name for text in texts for name in re.findall(r"\b[A-Z][A-Z_]+\b", imports.sub("", text))}
    assert named
    assert named - used == set()


def test_limits_of_long_runs_follow_from_each_other():
    """As their reasons say: a fifth of the guards' bound; a drift to it within 60 s, and a fifth more."""
    assert tolerances.HARD_LONG.value == pytest.approx(ENERGY_BOUND / 5.0)
    assert tolerances.HARD_DRIFT.value == pytest.approx(1.2 * tolerances.HARD_LONG.value / 60.0)


def test_the_limit_of_the_statistics_is_rarely_passed_by_chance():
    """Ten times of three measures, 16 and 128 runs: once in 20 000 ladders, as the reason says."""
    chance = 30 * 2 * student_t.sf(tolerances.SAME_STATISTICS.value, 16 + 128 - 2)
    assert chance == pytest.approx(5e-5, rel=0.1)
    offset = tolerances.SAME_STATISTICS.value * math.sqrt(1 / 16 + 1 / 128)
    assert offset == pytest.approx(1.3, abs=0.05)


def test_no_other_file_of_the_ladder_makes_a_tolerance():
    folder = Path(tolerances.__file__).parent
    files = {path.name: path.read_text(encoding="utf-8") for path in folder.rglob("*.py")}
    assert [name for name, text in files.items() if re.search(r"\bTolerance\(", text)] == ["tolerances.py"]


def test_random_topologies_report_the_worst():
    counted, widest = random_topologies(5)
    assert counted.measured == 0
    assert widest.worst.startswith("random-")


def test_a_stopped_run_fails_its_step():
    def stops():
        raise InputError("no such thing")
        yield

    (check,) = Step(5, "case", stops).run()
    assert not check.holds
    assert check.worst == "no such thing"


def _only_states(monkeypatch):
    """Leave out the rungs that take whole runs."""
    for later in ("_runs", "_answers", "_bodies"):
        monkeypatch.setattr(Ladder, later, lambda self: iter(()))


@pytest.mark.slow
def test_a_failing_rung_says_where_and_ends_with_1(tmp_path, monkeypatch, capsys):
    from exunet.forces import cable

    _only_states(monkeypatch)
    tension = cable.tension
    monkeypatch.setattr(cable, "tension", lambda *a, **k: 1.001 * tension(*a, **k))
    assert verify([PAPER], tmp_path, quick=True, processes=1) == 1
    text = (tmp_path / "verification.md").read_text()
    assert "What fails" in text
    assert "m/s2" in text  # both values with their unit
    printed = capsys.readouterr().out
    assert "FAILS" in printed
    assert "worst: " in printed
    assert all(len(line) <= 80 or str(tmp_path) in line for line in printed.splitlines())


@pytest.mark.ci
@pytest.mark.slow
def test_an_interrupted_ladder_keeps_what_was_done(tmp_path, monkeypatch, capsys):
    from exunet.verification import states as rung2

    def interrupted(case):
        raise KeyboardInterrupt

    monkeypatch.setattr(rung2, "forces", interrupted)
    assert verify([PAPER], tmp_path, quick=True, processes=1) == 130
    text = (tmp_path / "verification.md").read_text()
    assert "INCOMPLETE" in text
    assert "geometry, masses, start" in text
    assert "## 2." not in text


def test_a_case_out_of_reach_is_refused_by_name(tmp_path, monkeypatch):
    import reference_impl

    def refuses(path, overrides):
        raise reference_impl.Refused(["effects.magnetism: not known"])

    monkeypatch.setattr(reference_impl, "read", refuses)
    out = tmp_path / "out"
    with pytest.raises(InputError, match=r"planar_deployment: .*does not cover.*effects\.magnetism"):
        verify([PAPER], out, quick=True)
    assert not out.exists()
