"""The ladder of verification: that it holds, that it can fail, and what it leaves behind."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exunet.base.errors import InputError
from exunet.interfaces.commands.verify import verify
from exunet.net import TOPOLOGIES
from exunet.studies.both_codes import pair_of_text, read_pair
from exunet.verification import random_nets, states, tolerances
from exunet.verification.check import Check, worst_of
from exunet.verification.forces import forces
from exunet.verification.ladder import Ladder, Step, shipped
from exunet.verification.matrices import matrices
from exunet.verification.measures import measures
from exunet.verification.stepping import one_step
from exunet.verification.topology import random_topologies, topology

CASES = shipped() + shipped("verification/trajectories")


@settings(max_examples=40, deadline=None)
@given(topology=st.sampled_from(sorted(TOPOLOGIES)), seed=st.integers(0, 2**32 - 1))
def test_random_nets_are_the_same_in_both_codes(topology, seed):
    kind, text = random_nets.random_case(np.random.default_rng(seed), topology)
    checks = list(globals()["topology"](pair_of_text(kind, text)))
    assert [check.worst for check in checks if not check.holds] == []
    assert len(checks) == 2


def test_random_nets_cover_all_topologies():
    assert set(random_nets.TOPOLOGIES) == set(TOPOLOGIES)


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_states_of_a_case_agree(path):
    pair = read_pair(path)
    for rung in (topology, lambda pair: forces(pair, 10), measures, matrices, one_step):
        for check in rung(pair):
            assert check.holds, f"{check.name}: {check.measured} ({check.worst})"


def test_states_agree_with_the_fused_net():
    pytest.importorskip("numba")
    pair = read_pair(CASES[0]).fused()
    assert pair.start.scene.engine.net == "fused"
    for rung in (lambda pair: forces(pair, 10), matrices, one_step):
        for check in rung(pair):
            assert check.holds, f"{check.name}: {check.measured} ({check.worst})"


@pytest.mark.parametrize("kind", ["radial", "hexagonal", "explicit"])
def test_states_of_random_nets_agree(kind):
    """Topologies that no shipped case has; the seed only fixes which nets are drawn."""
    random = np.random.default_rng(7)
    for k in range(3):
        pair = pair_of_text(f"{kind}-{k}", random_nets.random_case(random, kind)[1])
        for check in (*forces(pair, 10), *matrices(pair)):
            assert check.holds, f"{check.name}: {check.measured} ({check.worst})"


def test_measures_name_the_state_where_they_differ(monkeypatch):
    from reference_impl import forces as formulas

    right = formulas.tension

    def wrong(system, x):
        pull = right(system, x)
        pull[3, 17] += 1.0  # [N]
        return pull

    monkeypatch.setattr(formulas, "tension", wrong)
    pair = read_pair(CASES[0])
    (check,) = (check for check in measures(pair) if not check.holds)
    ours = int(np.flatnonzero(pair.elements_to_theirs == 17)[0])
    assert check.name == "tension, 120 random states"
    assert f"state 3, number {ours}: " in check.worst
    assert check.worst.endswith(" N")


def test_kinds_of_states_are_what_they_are_called():
    net = read_pair(CASES[0]).start.net
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
    net = read_pair(CASES[0]).start.net
    position = states.smooth_states(net, np.random.default_rng(3))["half slack"]
    i, j = net.element_nodes.T
    strain = 0.5 * ((np.linalg.norm(position[j] - position[i], axis=1) / net.reference_length) ** 2 - 1)
    assert strain.min() < 0 < strain.max()
    assert np.abs(strain).min() > states.CLEAR_OF_THE_KINK


def test_a_measurement_that_is_no_number_fails():
    check = Check(1, "case", "name", math.nan, tolerances.FORCES)
    assert not check.holds
    fine = Check(1, "case", "fine", 0.0, tolerances.FORCES)
    assert worst_of("both", [fine, check]).worst.startswith("name")


def test_every_tolerance_has_a_reason():
    named = [value for value in vars(tolerances).values() if isinstance(value, tolerances.Tolerance)]
    assert len(named) > 5
    assert all(len(value.reason) > 20 for value in named)


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
    for later in ("_runs", "_answers", "_study_of_the_paper"):
        monkeypatch.setattr(Ladder, later, lambda self: iter(()), raising=False)


def test_a_failing_rung_says_where_and_ends_with_1(tmp_path, monkeypatch, capsys):
    from exunet.forces import cable

    _only_states(monkeypatch)
    tension = cable.tension
    monkeypatch.setattr(cable, "tension", lambda *a, **k: 1.001 * tension(*a, **k))
    assert verify([CASES[0]], tmp_path, quick=True) == 1
    text = (tmp_path / "verification.md").read_text()
    assert "What fails" in text
    assert "m/s2" in text  # both values with their unit
    printed = capsys.readouterr().out
    assert "FAILS" in printed
    assert "worst: " in printed


def test_an_interrupted_ladder_keeps_what_was_done(tmp_path, monkeypatch):
    from exunet.verification import forces as rung2

    def interrupted(pair):
        raise KeyboardInterrupt

    monkeypatch.setattr(rung2, "forces", interrupted)
    assert verify([CASES[0]], tmp_path, quick=True) == 130
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
    with pytest.raises(InputError, match=r"planar_deployment: .*reach.*effects\.magnetism"):
        verify([CASES[0]], out, quick=True)
    assert not out.exists()
