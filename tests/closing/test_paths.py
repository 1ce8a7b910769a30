"""Which nodes a closing line runs through and which elements a perimeter has, by hand; what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from listed_scenes import HEAD
from pydantic import ValidationError
from result_samples import net

from exunet.base.errors import CaseError
from exunet.forces.cable import STRETCH_BOUND
from exunet.net.arrays import Net, Tether, edge_of
from exunet.net.closing import (
    ClosingLine,
    ClosingLineConfig,
    Perimeter,
    PerimeterConfig,
    closing_of,
    with_mass_of,
)
from exunet.scene.casefile import parse_case
from exunet.simulation.preparation import prepare_case

LINE = {
    "kind": "line",
    "length": 9.0,
    "stiffness": 1e4,
    "linear_density": 0.1,
    "ring_diameter": 0.01,
    "friction": 0.1,
}
PERIMETER = {"kind": "perimeter", "at": 1.0, "rate": 0.5, "part": 0.2}


def two_by_one() -> Net:
    """Nodes 0 1 2 along x below 3 4 5, two meshes anticlockwise, bullets at 5 and 3; a tether from 4 to 6, 7.

    Elements 0 to 6; the thread between both meshes, 1 to 4, is element 2.
    """
    nodes = [(x, y, 0.0) for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)]
    elements = [(0, 1), (1, 2), (1, 4), (3, 4), (5, 4), (0, 3), (2, 5), (4, 6), (6, 7)]
    faces = ((0, 1, 4, 3), (1, 2, 5, 4))
    of = net([*nodes, (1.0, 1.0, -1.0), (1.0, 1.0, -2.0)], elements, (5, 3), faces, mouth=(2, 5, 3, 0))
    return replace(of, tethers=(Tether("tow", 6, (4, 6, 7)),))


def path(**keys: Any) -> tuple[int, ...]:
    found = closing_of(two_by_one(), ClosingLineConfig.model_validate(LINE | keys))
    assert isinstance(found, ClosingLine)
    return found.path


def told(**keys: Any) -> list[tuple[str, str]]:
    with pytest.raises(CaseError) as caught:
        path(**keys)
    return [(fault.key, fault.reason) for fault in caught.value.faults]


def test_rings_of_a_loop_and_of_a_line_with_ends() -> None:
    """A loop comes back to its first ring; with ends, rings of the edge or of corners go all round first."""
    assert path(rings="corners") == (2, 5, 3, 0, 2)
    assert path(rings="edge") == (2, 5, 4, 3, 0, 1, 2)
    assert path(nodes=[1, 4]) == (1, 4, 1)
    ends = {"start": {"bullet": 1}, "end": {"tether": "tow"}}
    assert path(nodes=[1, 4], **ends) == (3, 1, 4, 7)
    assert path(nodes=[1], start={"node": 0}, end={"bullet": 0}) == (0, 1, 5)
    assert path(rings="edge", **ends) == (3, 2, 5, 4, 3, 0, 1, 2, 7)


@pytest.mark.parametrize(
    ("end", "key", "words"),
    [
        ({"bullet": 2}, ".bullet", "there is no bullet 2: the net has 2, numbered from 0"),
        ({"node": 6}, ".node", "there is no node 6: the net has 6, numbered from 0"),
        ({"tether": "tug"}, ".tether", 'there is no tether "tug" (tethers: tow)'),
        ({"node": 1}, "", "node 1 is the ring next to it: tie the line to another, or leave out the ring"),
    ],
)
def test_an_end_that_is_not_there(end: dict[str, Any], key: str, words: str) -> None:
    """Each fault alone, whatever the ring next to it."""
    assert told(nodes=[1, 4], start=end, end={"node": 5}) == [(f"closing.start{key}", words)]
    assert told(nodes=[4, 1], start={"node": 5}, end=end) == [(f"closing.end{key}", words)]


def test_rings_that_are_not_there() -> None:
    words = "there is no node 6: the net has 6, numbered from 0"
    assert told(nodes=[5, 6, 0]) == [("closing.nodes[1]", words)]
    few = "a loop needs two rings at least: give start and end"
    assert told(nodes=[5]) == [("closing.nodes", few)]
    line = ClosingLineConfig.model_validate(LINE | {"rings": "corners"})
    with pytest.raises(CaseError, match=r"closing\.rings: the net has no mouth"):
        closing_of(replace(two_by_one(), mouth=(5,)), line)
    assert path(nodes=[5, 0]) == (5, 0, 5)


def test_a_perimeter_is_the_elements_of_the_edge() -> None:
    """All but the one between the meshes, and none of the tether's."""
    found = closing_of(two_by_one(), PerimeterConfig.model_validate(PERIMETER))
    assert found == Perimeter((0, 1, 3, 4, 5, 6), 1.0, 0.5, 0.2)
    with pytest.raises(CaseError, match=r"closing\.kind: the net has no edge that is one loop"):
        closing_of(replace(two_by_one(), faces=()), PerimeterConfig.model_validate(PERIMETER))


def test_the_mass_of_a_line_is_at_its_nodes() -> None:
    """0.9 kg on three pieces: a sixth at either end, a third at each ring in between."""
    of = two_by_one()
    keys = LINE | {"nodes": [1, 4], "start": {"node": 0}, "end": {"node": 5}}
    line = closing_of(of, ClosingLineConfig.model_validate(keys))
    assert isinstance(line, ClosingLine)
    added = with_mass_of(of, line).mass - of.mass
    np.testing.assert_allclose(added, [0.15, 0.3, 0.0, 0.0, 0.3, 0.15, 0.0, 0.0], atol=1e-15)
    assert with_mass_of(of, replace(line, linear_density=0.0)) is of


def test_the_edge_of_meshes() -> None:
    """Of both ways round; two loops, of a frame, have an edge only from a node on."""
    faces = ((0, 1, 4, 3), (1, 2, 5, 4))
    assert edge_of(faces) == (0, 1, 2, 5, 4, 3)
    assert edge_of(faces, 5) == (5, 4, 3, 0, 1, 2)
    assert edge_of(tuple(face[::-1] for face in faces)) == (0, 3, 4, 5, 2, 1)
    outer, inner = (0, 1, 2, 3), (4, 5, 6, 7)
    frame = tuple((a, b, d, c) for a, b, c, d in zip(outer, (1, 2, 3, 0), inner, (5, 6, 7, 4), strict=True))
    assert edge_of(frame) == ()
    assert edge_of(frame, 2) == (2, 3, 0, 1)
    assert edge_of(frame, 6) == (6, 5, 4, 7)
    assert edge_of(()) == ()
    assert edge_of(faces, 9) == ()
    assert edge_of(((0, 1, 2), (0, 3, 4))) == ()  # which meet at a node only


def faults(**keys: Any) -> list[tuple[Any, ...]]:
    try:
        ClosingLineConfig.model_validate(LINE | keys)
    except ValidationError as error:
        return [fault.path for item in error.errors() for fault in item["ctx"]["faults"]]
    return []


def test_what_contradicts_itself() -> None:
    """Rings that follow themselves, a loop that names its first twice, a winch with nothing to wind up."""
    ends = {"start": {"node": 0}, "end": {"node": 5}}
    assert faults(nodes=[0, 1]) == []
    assert faults(nodes=[0, 1, 1, 2]) == [("nodes", 2)]
    assert faults(nodes=[0, 1, 0]) == [("nodes", 2)]
    assert faults(nodes=[3, 1, 3], **ends) == []
    assert faults(nodes=[0, 1], winch={"shortest": 8.999}) == []
    assert [fault[-1] for fault in faults(nodes=[0, 1], winch={"shortest": 9.0})] == ["shortest"]


ROUND = """
net.elements = []
net.nodes = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]]
net.node_masses = [2.0, 0.1, 0.3]
time = {{ end = 0.5, output_step = 0.1 }}
effects.thermal_strain = {{ temperature_change = {0}, expansion_coefficient = 1e-3 }}
[closing]
kind = "line"
nodes = [0, 1, 2]
length = {1}
stiffness = 200.0
linear_density = 0.0
ring_diameter = 1e-6
friction = 0.0
"""


@pytest.mark.parametrize("change", [80.0, -80.0])
@pytest.mark.parametrize(("part", "fits"), [(0.99, True), (1.01, False)])
def test_how_far_a_line_may_be_stretched_at_the_start(change: float, part: float, fits: bool) -> None:
    """Its way is 12 m: by as much as the law is valid for, of a length that is 1 + alpha dT times as long."""
    ratio = 1.0 + 1e-3 * change
    text = HEAD + ROUND.format(change, 12.0 / (STRETCH_BOUND * ratio * part))
    if fits:
        assert prepare_case(parse_case(text, Path("line.toml"))).system.line is not None
        return
    with pytest.raises(CaseError, match="its path through the rings of 12 m at the start") as caught:
        prepare_case(parse_case(text, Path("line.toml")))
    assert f"a stretch of {STRETCH_BOUND * part:.4g}" in str(caught.value)
