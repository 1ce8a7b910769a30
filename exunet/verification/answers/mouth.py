"""Area of the mouth and of the openings: of flat polygons from their sides, and of a folded square."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from exunet.base.errors import InputError
from exunet.net import radial, square
from exunet.results import measures as metrics
from exunet.studies.both_codes import BothCodes, Floats
from exunet.verification.check import Check, against, worst_of
from exunet.verification.tolerances import AREA

SEED = 20210621
SHAPES = 10


def areas(case: BothCodes) -> Iterator[Check]:
    """The net stretched, sheared and turned by linear maps; mouth and openings then cover the same plane.

    A map A takes an area S in the plane of x and y to S |A e_x x A e_y|. A square of side s has S = s^2, a
    polygon of n corners at the distance r has S = n r^2 sin(2 pi / n) / 2.
    """
    net, flat = case.start.net, _flat(case)
    maps = [np.eye(3), *np.random.default_rng(SEED).normal(size=(SHAPES, 3, 3))]
    for what, area in (("the mouth", metrics.mouth_area), ("all openings", metrics.mesh_area)):
        checks = []
        for k, a in enumerate(maps):
            known = flat * float(np.linalg.norm(np.cross(a[:, 0], a[:, 1])))
            checks.append(
                against(f"shape {k}", float(area(net, net.reference_position @ a.T)), known, AREA, "m2")
            )
        yield worst_of(f"area of {what}, {len(maps)} flat shapes", checks)
    if isinstance(case.start.scene.net, square.SquareNet):
        folded = metrics.mouth_area(net, _folded(net.reference_position))
        yield against("area of the mouth, folded by a right angle", float(folded), flat * FOLDED, AREA, "m2")


# Of a unit square folded by a right angle about a diagonal, as a fan from the mean of its corners: with
# h = sqrt(1/2) the corners are (h, 0, 0), (0, h, 0), (0, 0, h), (0, -h, 0), their mean is (h, 0, h) / 4, and
# each of the four triangles has the area h^2 sqrt(11) / 8.
FOLDED = math.sqrt(11.0) / 4.0


def _flat(case: BothCodes) -> float:
    """Area [m2] in the reference configuration."""
    match case.start.scene.net:
        case square.SquareNet(size=side):
            return side**2
        case radial.RadialNet(spokes=corners, radius=distance):
            return 0.5 * corners * distance**2 * math.sin(2.0 * math.pi / corners)
    raise InputError(f"{case.name}: the area of the mouth is known of square and radial nets only")


def _folded(place: Floats) -> Floats:
    """The half with x + y > 0 turned out of the plane about the diagonal."""
    along, across = (place[:, 1] - place[:, 0]) / math.sqrt(2.0), (place[:, 0] + place[:, 1]) / math.sqrt(2.0)
    return np.column_stack([np.maximum(across, 0.0), along, np.maximum(-across, 0.0)])
