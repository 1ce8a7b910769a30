"""exunet: deployable cable nets for catching space debris, simulated with Exudyn and cross-checked.

    import exunet
    result = exunet.run(exunet.load("cases/planar_deployment.toml"))

Names are imported when they are first used, so that `import exunet` itself costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from exunet.base import version

__version__ = version.VERSION

if TYPE_CHECKING:
    from exunet.base.errors import CaseError as CaseError
    from exunet.base.errors import ExunetError as ExunetError
    from exunet.base.errors import InputError as InputError
    from exunet.base.errors import RunStopped as RunStopped
    from exunet.case.casefile import load as load
    from exunet.figures import save_figures as save_figures
    from exunet.results.measures import deployment as deployment
    from exunet.results.reading import load_result as load_result
    from exunet.results.result import Result as Result
    from exunet.results.writing import save as save
    from exunet.simulation.run import resume as resume
    from exunet.simulation.run import run as run
    from exunet.simulation.simulation import Simulation as Simulation
    from exunet.simulation.snapshot import Snapshot as Snapshot
    from exunet.studies.ensemble import perturbed_positions as perturbed_positions
    from exunet.studies.ensemble import run_ensemble as run_ensemble

_HOME = {
    "load": "exunet.case.casefile",
    "run": "exunet.simulation.run",
    "resume": "exunet.simulation.run",
    "Simulation": "exunet.simulation.simulation",
    "Snapshot": "exunet.simulation.snapshot",
    "Result": "exunet.results.result",
    "load_result": "exunet.results.reading",
    "save": "exunet.results.writing",
    "deployment": "exunet.results.measures",
    "save_figures": "exunet.figures",
    "run_ensemble": "exunet.studies.ensemble",
    "perturbed_positions": "exunet.studies.ensemble",
    "CaseError": "exunet.base.errors",
    "InputError": "exunet.base.errors",
    "ExunetError": "exunet.base.errors",
    "RunStopped": "exunet.base.errors",
}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'exunet' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value  # so that this function is asked once for each name
    return value
