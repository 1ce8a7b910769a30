"""The same motion of a net of millimetres and of kilometres is judged alike: lengths go with the size."""

import re

import pytest

from exunet.studies.both_codes import both_of_text
from exunet.studies.perturbation import MOVE
from exunet.verification.balances import converged
from exunet.verification.check import Check, shipped
from exunet.verification.horizon import ROUND_OFF, growth, sensitivity
from exunet.verification.matrices import matrices
from exunet.verification.one_step import one_step, same_scheme

# Powers of the scale of lengths under which all stay alike that has the same speeds, moduli and densities.
POWERS = {
    "end": 1, "output_step": 1, "size": 1, "mesh": 1, "diameter": 1, "length": 1, "mass": 3,
    "alpha": -1, "beta": 1,
}  # fmt: skip
SCALES = [1e-3, 1e3]  # of 5 m: 5 mm and 5 km


def scaled(scale):
    """The paper's net with all lengths and times `scale` times as long."""

    def changed(line):
        power = POWERS.get(line[1])
        return line[0] if power is None else f"{line[1]} = {float(line[2]) * scale**power!r}"

    text = shipped()["planar_deployment"].read_text()
    return both_of_text("scaled", re.sub(r"^(\w+) = ([\d.e+-]+)\b.*$", changed, text, flags=re.MULTILINE))


def hold(findings):
    checks = [finding for finding in findings if isinstance(finding, Check)]
    assert [f"{c.name}: {c.measured} ({c.worst})" for c in checks if not c.holds] == []
    return checks


@pytest.mark.parametrize("scale", SCALES)
def test_matrices_and_one_step(scale):
    case = scaled(scale)
    assert case.size == pytest.approx(7.0 * scale)
    hold([*matrices(case), *one_step(case)])


@pytest.mark.slow
@pytest.mark.parametrize("scale", SCALES)
def test_growth_and_trajectories(scale):
    """To 1 s, times the scale; the paper's net itself grows at 19.3/s and has no horizon there."""
    case = scaled(scale)
    grown = growth(case, scale, (ROUND_OFF, MOVE))
    assert grown.rate * scale == pytest.approx(19.3, rel=0.02)
    hold([*same_scheme(case, grown), *converged(case, grown)])
    noted = hold(sensitivity(case, grown))
    assert any("no horizon before" in check.name for check in noted)
