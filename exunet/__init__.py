"""exunet: deployable cable nets for catching space debris, simulated with Exudyn and cross-checked.

    import exunet
    result = exunet.run(exunet.load("cases/planar_deployment.toml"))

Names are imported when they are first used, so that `import exunet` itself costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from exunet.casefile import load as load
    from exunet.ensemble import perturbed_positions as perturbed_positions
    from exunet.ensemble import run_ensemble as run_ensemble
    from exunet.errors import CaseError as CaseError
    from exunet.errors import ExunetError as ExunetError
    from exunet.errors import InputError as InputError
    from exunet.errors import RunStopped as RunStopped
    from exunet.metrics import deployment as deployment
    from exunet.plot import save_figures as save_figures
    from exunet.result import Result as Result
    from exunet.result import load_result as load_result
    from exunet.result import save as save
    from exunet.timeloop import run as run

_HOME = {
    "load": "exunet.casefile",
    "run": "exunet.timeloop",
    "Result": "exunet.result",
    "load_result": "exunet.result",
    "save": "exunet.result",
    "deployment": "exunet.metrics",
    "save_figures": "exunet.plot",
    "run_ensemble": "exunet.ensemble",
    "perturbed_positions": "exunet.ensemble",
    "CaseError": "exunet.errors",
    "InputError": "exunet.errors",
    "ExunetError": "exunet.errors",
    "RunStopped": "exunet.errors",
}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'exunet' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value  # so that this function is asked once for each name
    return value
