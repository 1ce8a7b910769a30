"""Both codes weave the same nets, and close them at the same rings and threads."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from exunet.studies.both_codes import both_of_text
from exunet.verification import random_states
from exunet.verification.cross_code import compared, motion
from reference_impl.case import NetNode
from reference_impl.closing import Edge, Line, node_of
from reference_impl.read import Refused, read_document


def test_random_nets_have_all_topologies_of_the_reference() -> None:
    """Whose names are in its refusal of another topology."""
    with pytest.raises(Refused) as refused:
        read_document(tomllib.loads(NET.format(net='topology = "unknown"', closing='"line"')))
    known = re.search(r'topology = "unknown": it knows (.*)', str(refused.value))
    assert known is not None
    assert set(random_states.TOPOLOGIES) == set(known[1].split(", "))


@pytest.mark.parametrize("kind", ["radial", "hexagonal", "explicit"])
def test_forces_of_random_nets_agree(kind: str) -> None:
    """Topologies that no shipped case has; the seed only fixes which nets are drawn."""
    random = np.random.default_rng(7)
    for k in range(3):
        case = both_of_text(f"{kind}-{k}", random_states.random_case(random, kind)[1])
        for check in compared(motion(case, compiled=False), 10):
            assert check.holds, check


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
    """In the same order, from the same corner; an open line shows where the first ring is."""
    line = LINE.format(rings=rings, ends=ENDS.format(1, 2))
    case = both_of_text(net, NET.format(net=f"{NETS[net]}\n{BULLETS}", closing=line))
    ours, theirs = case.start.system.line, case.theirs.system.closing
    assert ours is not None
    assert isinstance(theirs, Line)
    assert case.reference_nodes[list(ours.path)].tolist() == theirs.nodes.tolist()
    mass = case.theirs.net.mass[case.reference_nodes]
    np.testing.assert_allclose(case.start.net.mass, mass, rtol=1e-14)


@pytest.mark.parametrize("net", NETS)
def test_both_codes_name_the_same_nodes(net: str) -> None:
    """Several knots are equally near to the centre of most nets, and to 0.125 of the perimeter of some."""
    edge = '"perimeter"\nat = 0.1\nrate = 1.0\npart = 0.5\n'
    case = both_of_text(net, NET.format(net=f"{NETS[net]}\n{BULLETS}", closing=edge))
    for name in ("centre", "corner 0", "corner 2", "rim 0", "rim 0.125", "rim .3", "rim 0.99"):
        ours, theirs = case.start.net.node(name), node_of(case.theirs.net, NetNode("name", name))
        assert case.reference_nodes[ours] == theirs, name


@pytest.mark.parametrize("net", NETS)
def test_both_codes_throw_each_bullet_alike(net: str) -> None:
    """Numbers of bullets, factors and tilts, to round-off, at random values."""
    text = NET.format(net=f"{NETS[net]}\n{BULLETS}", closing="").partition("[closing]")[0]
    count = len(both_of_text(net, text).start.net.bullet_nodes)
    random = np.random.default_rng(3)
    factors, tilts = random.uniform(0.0, 2.0, count).tolist(), random.uniform(-1.0, 1.0, (count, 2)).tolist()
    keys = f"[launch]\nspeed = 3.0\nspread_angle = 0.6\nspeed_factors = {factors}\ntilts = {tilts}\n"
    both = both_of_text(net, text + keys)
    np.testing.assert_allclose(both.start.velocity, both.theirs.v0[both.reference_nodes], atol=1e-14)


@pytest.mark.parametrize("net", NETS)
def test_both_codes_shorten_the_same_threads(net: str) -> None:
    edge = '"perimeter"\nat = 0.1\nrate = 1.0\npart = 0.5\n'
    case = both_of_text(net, NET.format(net=f"{NETS[net]}\n{BULLETS}", closing=edge))
    shortening, theirs = case.start.system.forces.cable.shortening, case.theirs.system.closing
    assert shortening is not None
    assert isinstance(theirs, Edge)
    ours = case.reference_elements[list(shortening.elements)]
    assert sorted(ours.tolist()) == sorted(theirs.element.tolist())
