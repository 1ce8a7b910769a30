"""From a scene to the engine: net, terms of the effects, initial state, plan, and the filled model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exunet.effects import total_terms
from exunet.effects.terms import Terms
from exunet.engine.model import Model
from exunet.initial import initial_state
from exunet.net import weave
from exunet.net.arrays import Net
from exunet.plan import make_plan
from exunet.scene import Scene
from exunet.solvers import Plan

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """All that a run begins from, before any engine: plain values that a script can print or change.

    position, velocity : (n_nodes, 3) initial state [m], [m/s]
    """

    scene: Scene
    net: Net
    terms: Terms
    position: Floats
    velocity: Floats
    plan: Plan


def prepare(scene: Scene) -> Start:
    """Weave the net, sum the effects' terms, set the initial state and plan the integration."""
    net = weave(scene.net)
    terms = total_terms(scene.effects, net)
    position, velocity = initial_state(scene, net)
    return Start(scene, net, terms, position, velocity, make_plan(scene, net, terms, velocity))


def build(start: Start) -> Model:
    """Fill and assemble the engine's model: points, connectors, and terms if there are any."""
    model = Model()
    net = start.net
    fixed = np.zeros(net.n_nodes, dtype=bool)
    fixed[net.fixed_nodes] = True
    for node in range(net.n_nodes):
        if fixed[node]:
            model.fixed_point(start.position[node])
        else:
            model.point(
                net.mass[node], net.reference_position[node], start.position[node], start.velocity[node]
            )
    for (i, j), length, stiffness in zip(
        net.element_nodes, net.reference_length, net.axial_stiffness, strict=True
    ):
        model.cable_element(int(i), int(j), length, stiffness)
    model.linear_terms(start.terms.damping, start.terms.load)
    model.assemble()
    return model
