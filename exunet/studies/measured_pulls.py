"""How hard threads pull on bodies in states of a run that goes on, of which moved starts keep the sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rigid import in_frames
from exunet.results.pulls import PulledPlace, places_of, pull_in
from exunet.results.result import BodyStates
from exunet.simulation.preparation import Start
from exunet.simulation.recorder import fixed_nodes, story_of_scene
from exunet.system.states import States

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PulledPlaces:
    """The places that tie threads to the bodies of a scene.

    story : what there is to tell of the scene before its run, as of those that are held for a while
    """

    places: tuple[PulledPlace, ...] = ()
    story: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, start: Start) -> PulledPlaces:
        """Those of a scene."""
        story = story_of_scene(start)
        return cls(places_of(fixed_nodes(start.system), story), story)

    def pull(self, states: States) -> Floats:
        """(k, n_places, 2) sizes of force [N] and torque [N m], as if nothing were ever let go."""
        if not self.places:
            return np.zeros((len(states), 0, 2))
        system = states.system
        framed = in_frames(system.bodies, states.bodies)
        bodies = {
            body.name: BodyStates(
                body.mass, None, framed.position[:, k], framed.velocity[:, k], attitude=framed.attitude[:, k]
            )
            for k, body in enumerate(system.bodies)
        }
        position = states.position[:, : system.net.n_nodes]
        return pull_in(system.net, self.places, self.story, bodies, position, states.tension)
