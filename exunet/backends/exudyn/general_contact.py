"""Contact of spheres left to the engine's own GeneralContact, in place of exunet's law.

Each term of spheres that touch a body becomes one GeneralContact, so that what touches does not touch itself:
the body's sphere has the radii of both, and the points have none. The engine puts the stiffnesses of two
spheres in series. What the engine knows of its contact are forces; energy, depths and how many touch are
those of exunet's law, by the terms themselves, which are asked at the ends of steps and push nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from exunet.backends.exudyn.model import Model
from exunet.forces.contact.spheres import SphereContact
from exunet.forces.terms import KernelTerm
from exunet.forces.total import Forces
from exunet.system.system import System


def spheres_of(forces: Forces) -> tuple[KernelTerm, ...]:
    """The terms that the engine's contact can take over."""
    return tuple(term for term in forces.kernels if isinstance(term.data, SphereContact))


def without_spheres(forces: Forces) -> Forces:
    """The same forces but for these terms."""
    taken = spheres_of(forces)
    return replace(forces, kernels=tuple(term for term in forces.kernels if term not in taken))


def touch(model: Model, system: System) -> None:
    """Add the contact of a system's spheres to a model that has its points and bodies."""
    moving = np.flatnonzero(system.moves_freely).tolist()
    for term in spheres_of(system.forces):
        data, (body,) = cast(SphereContact, term.data), term.bodies
        points = data.node.astype(np.int64) // 3
        number = moving.index(system.blocks.rigid.index(body))
        radius = float(data.rounding[0] + data.thick)
        model.sphere_contact(number, data.place[0], radius, points.tolist(), data.stiffness)
