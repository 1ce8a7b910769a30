"""A plain NumPy/SciPy cable net, written to cross-check another program: see README.md.

scene = load("cases/planar_deployment.toml", {"time.end": 1.0})
trajectory = scene.integrate()
a = acceleration(scene.system, 0.0, scene.x0, scene.v0)
"""

from reference_impl.bodies import Bodies, BodyStates
from reference_impl.case import Case
from reference_impl.closing import Drawn
from reference_impl.effects import Effects, Orbit
from reference_impl.elements import damping, secant, tangent
from reference_impl.events import Break
from reference_impl.forces import acceleration
from reference_impl.integration import Diverged, Interrupted, Trajectory, integrate
from reference_impl.net import Net
from reference_impl.read import parse_override, read, read_document
from reference_impl.reels import Wound
from reference_impl.scene import Scene, load, perturbed, prepare
from reference_impl.start import initial_state, with_places
from reference_impl.system import System, assemble
from reference_impl.table import Refused
from reference_impl.weave import weave

__all__ = [
    "Bodies",
    "BodyStates",
    "Break",
    "Case",
    "Diverged",
    "Drawn",
    "Effects",
    "Interrupted",
    "Net",
    "Orbit",
    "Refused",
    "Scene",
    "System",
    "Trajectory",
    "Wound",
    "acceleration",
    "assemble",
    "damping",
    "initial_state",
    "integrate",
    "load",
    "parse_override",
    "perturbed",
    "prepare",
    "read",
    "read_document",
    "secant",
    "tangent",
    "weave",
    "with_places",
]
