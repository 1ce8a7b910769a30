"""Rung 10: both codes do the same where something closes a mouth, and run through the same rings."""

from __future__ import annotations

import numpy as np
import pytest

from exunet import figure, load, run
from exunet.base.errors import InputError
from exunet.studies.both_codes import both_of_text, read_both
from exunet.verification import closing
from exunet.verification.check import Check, shipped
from exunet.verification.ladder import RUNGS, Ladder
from reference_impl.closing import Edge, Line

CASES = shipped(closing.CLOSING_CASES)


@pytest.mark.parametrize("name", list(CASES))
def test_laws_are_the_same_at_states(name: str) -> None:
    checks = list(closing.laws(read_both(CASES[name]), 3))
    assert [check.name for check in checks if not check.holds] == []
    assert len(checks) == len(closing.QUANTITIES) + 1


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_all_forms_are_the_same_at_states_and_over_a_run(name: str) -> None:
    case = read_both(CASES[name])
    for check in (*closing.at_states(case, 3), *closing.over_a_run(case)):
        assert check.holds, check


def test_the_quick_ladder_has_the_states_and_tells_what_it_leaves_out() -> None:
    steps = list(Ladder([], quick=True, paper=False)._closings())
    assert [step.subject for step in steps[::2]] == ["by_tether", "loop", "open_line", "perimeter"]
    assert {step.rung for step in steps} == {10} <= set(RUNGS)
    left = [item for step in steps[1::2] for item in step.run()]
    assert all(isinstance(entry, Check) and entry.left_out and entry.name == "whole runs" for entry in left)


def test_a_named_case_is_compared_in_rungs_1_and_10() -> None:
    ladder = Ladder([read_both(CASES["loop"])], quick=True, paper=False)
    found = [*ladder.nets(), *ladder._states(), *ladder._runs(), *ladder._closings()]
    assert {step.rung for step in found if step.subject == "loop"} == {1, 10}
    assert [step.subject for step in found].count("loop") == 3  # its net, its states, its run left out


NET = """
format = 1
title = "rings"
time = {{ end = 1.0, output_step = 0.5 }}
initial.packing = 0.9
[net]
divisions = 2
cable = {{ diameter = 0.001, density = 1000.0, youngs_modulus = 1e8 }}
{net}
[closing]
kind = {closing}
"""
STRINGS = "strings = { diameter = 0.001, density = 1e3, youngs_modulus = 1e8, length = 1.0 }"
BULLETS = f"bullets = {{ mass = 0.1 }}\n{STRINGS}"
BORDER = "border = { diameter = 0.002, density = 1000.0, youngs_modulus = 1e8 }\nmesh = 0.5\n"
NETS = {
    "square": 'topology = "square"\nsize = 2.0\nmesh = 0.5',
    "rectangular": 'topology = "rectangular"\nsize = [2.0, 1.0]\nmesh = [0.5, 0.5]',
    "hexagonal": 'topology = "hexagonal"\nmesh = 0.5\nrings = 1',
    "one_cell": 'topology = "hexagonal"\nmesh = 0.5\nrings = 0',
    "radial": 'topology = "radial"\nradius = 1.0\nspokes = 5\nrings = 2',
    "octagon": f'{BORDER}topology = "cut"\noutline = "octagon"\nsize = 3.0\nmesh_shape = "triangle"',
    "circle": f'{BORDER}topology = "cut"\noutline = "circle"\ncorners = 5\nsize = 3.0\nmesh_shape = "square"',
    "hexagon": f'{BORDER}topology = "cut"\noutline = "hexagon"\nsize = 3.0\nmesh_shape = "hexagon"',
}
LINE = (
    '"line"\nlength = 20.0\nstiffness = 100.0\nlinear_density = 0.01\nring_diameter = 0.01\nfriction = 0.0\n'
    'rings = "{rings}"\n{ends}'
)
ENDS = "start = {{ bullet = {} }}\nend = {{ bullet = {} }}\n"


@pytest.mark.parametrize("rings", ["edge", "corners"])
@pytest.mark.parametrize("net", NETS)
def test_both_codes_run_the_line_through_the_same_rings(net: str, rings: str) -> None:
    """In the same order, from the same corner; an open line tells where the first one is."""
    line = LINE.format(rings=rings, ends=ENDS.format(1, 2))
    case = both_of_text(net, NET.format(net=f"{NETS[net]}\n{BULLETS}", closing=line))
    ours, theirs = case.start.system.line, case.theirs.system.closing
    assert ours is not None
    assert isinstance(theirs, Line)
    assert case.reference_nodes[list(ours.path)].tolist() == theirs.nodes.tolist()
    mass = case.theirs.net.mass[case.reference_nodes]
    np.testing.assert_allclose(case.start.net.mass, mass, rtol=1e-14)


@pytest.mark.parametrize("net", NETS)
def test_both_codes_shorten_the_same_threads(net: str) -> None:
    edge = '"perimeter"\nat = 0.1\nrate = 1.0\npart = 0.5\n'
    case = both_of_text(net, NET.format(net=f"{NETS[net]}\n{BULLETS}", closing=edge))
    shortening, theirs = case.start.system.forces.cable.shortening, case.theirs.system.closing
    assert shortening is not None
    assert isinstance(theirs, Edge)
    ours = case.reference_elements[list(shortening.elements)]
    assert sorted(ours.tolist()) == sorted(theirs.element.tolist())


@pytest.mark.ci
@pytest.mark.slow
def test_the_figure_of_what_closes() -> None:
    """A line has three panels, its tension, its lengths and the mouth; an edge two; another net none."""
    made = {}
    for name in ("loop", "perimeter"):
        result = run(load(CASES[name], ["time.end=0.3"]))
        made[name] = [axes.get_ylabel().replace("\n", " ") for axes in figure(result, "closing").axes]
    mouth = "diameter of the mouth [m]"
    assert made["loop"] == ["tension of the line [N]", "length [m]", mouth]
    assert made["perimeter"] == ["part of the edge's length left [1]", mouth]
    with pytest.raises(InputError, match=r"requires \[closing\]"):
        figure(run(load(CASES["loop"], ["time.end=0.01", "closing="])), "closing")
