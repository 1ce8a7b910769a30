"""The quantities over time of which headlines are made: of a run, of a piece of one, and of many runs."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class OverTime:
    """Each has a row for each of the t times, and of many runs an axis of runs before that.

    There are no defaults: a field that a result (`course_of`) or perturbed runs (`studies.measured`) do not
    fill in is an error.

    area         : (t,) of the mouth [m2]; zeros without one
    centre       : (t, 3) centre of mass of the net [m]
    bullet_speed : (t, n_bullets) [m/s]
    kinetic, elastic, potential : (t,) [J]
    dissipated   : (t,) [J], without the work that is put in: see `exunet.results.measures.dissipation`
    tension      : (t,) largest tension of all elements at each time [N]
    body_centre  : (t, n_bodies, 3) centres of mass of point masses and rigid bodies [m]
    reel         : (t, n_reels, 2) of tethers with reels, and of a closing line: length that is wound up [m],
                   work of the drum on it [J]
    loaded, loaded_element : (t, n_groups) largest tension / strength in each group of elements whose strength
                   is known, and in which element
    units        : (t, n_units + 1) impulse that each corner unit has spent [N s], and the work of all [J];
                   (t, 0) without any
    pull         : (t, n_places, 2) sizes of force [N] and torque [N m] of threads at each place that ties
                   them to a body, see `exunet.results.pulls`
    mouth        : (t, 1) diameter of the mouth [m], where something closes it; (t, 0) elsewhere
    edge         : (t, 1) part of its length that is left of an edge that becomes shorter; (t, 0) without one
    spin         : (t, n_rigid, 3) angular velocities of rigid bodies, in axes of each [rad/s]
    momentum     : (t, n_parts, 6) momentum [kg m/s], and angular momentum about the scene's origin [kg m2/s],
                   of `exunet.results.momenta.part_names`; (t, 0, 6) without bodies
    taken        : (t, n_taken) energies that damping and friction of contacts and of a closing line took
                   [J], in the order of `exunet.results.taken.TAKEN`, as far as the scene has them
    """

    area: Floats
    centre: Floats
    bullet_speed: Floats
    kinetic: Floats
    elastic: Floats
    potential: Floats
    dissipated: Floats
    tension: Floats
    body_centre: Floats
    reel: Floats
    loaded: Floats
    loaded_element: Ints
    units: Floats
    pull: Floats
    mouth: Floats
    edge: Floats
    spin: Floats
    momentum: Floats
    taken: Floats


OVER_TIME = tuple(field.name for field in fields(OverTime))
