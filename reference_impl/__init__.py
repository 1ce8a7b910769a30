"""A plain NumPy/SciPy cable net, written to cross-check another program: see README.md.

case = read("cases/planar_deployment.toml")
net = weave(case)
system = assemble(case, net)
trajectory = march(system, *initial_state(case, net), case.times)
"""

from reference_impl.forces import System, acceleration, assemble
from reference_impl.march import Diverged, Interrupted, Trajectory, march
from reference_impl.read import Case, Refused, parse_override, read, read_document
from reference_impl.start import initial_state
from reference_impl.weave import Net, weave

__all__ = [
    "Case",
    "Diverged",
    "Interrupted",
    "Net",
    "Refused",
    "System",
    "Trajectory",
    "acceleration",
    "assemble",
    "initial_state",
    "march",
    "parse_override",
    "read",
    "read_document",
    "weave",
]
