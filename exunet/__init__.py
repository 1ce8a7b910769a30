"""exunet: deployable cable nets for catching space debris, simulated with Exudyn and cross-checked.

    import exunet
    result = exunet.run(exunet.load("cases/planar_deployment.toml"))

docs/reference/python describes all public names. They are imported when they are first used, so that
`import exunet` itself costs next to nothing; `__init__.pyi` has the module of each.
"""

from importlib import import_module
from typing import Any

from exunet.base.version import VERSION

__version__ = VERSION

# Groups of public names, in the order of docs/reference/python.
_GROUPS = {
    "Run a case": "load run resume",
    "Build a scene": """
        Scene Time Solver Engine SquareNet RectangularNet HexagonalNet RadialNet CutNet ExplicitNet Cable
        Strings Bullets Initial Fold NetFrame ConeLaunch RadialLaunch Body Part Attachment Tether TetherEnd
        Reel ClosingLine EndOfLine Winch Perimeter Brake Lock Rate Tension PointControl FormationControl
        TableControl GivenControl Noise Capture ScriptEntry Effects Gravity MassDamping MaterialDamping
        RayleighDamping LinearContact HertzContact StickingFriction RegularisedFriction SelfContact Bending
        Breaking ThermalStrain AirDrag MolecularDrag SolarPressure Orbit J2 SpringLaunchForce GasLaunchForce
        Thrust
    """,
    "Step a simulation": "Simulation Snapshot NetEnvironment",
    "Add forces": "KernelTerm Input FirstOrder Blocks",
    "Couple a net to a host": "NetSystem FrameState PortLoad Coupler Ledger CoupledSnapshot",
    "Hosts": "Host BodiesHost ExudynHost add_to NativeItems export_fmu",
    "Results": "Result ContactKey BodyStates load_result save export to_frame summarise",
    "Metrics": """
        metrics Metric deployment Deployment mouth_area mesh_area achievable_area bullet_speeds
        centre_of_mass peak_tensions largest_tensions energy_balance loads CarriedLoads Loads clearance
        margins Margin
    """,
    "Compare runs": "compare Agreement",
    "Ensembles": """
        ensemble Ensemble save_ensemble load_ensemble prepare Start perturbed_positions run_ensemble
    """,
    "Studies": "Study StudyTable optimise Optimum",
    "Figures": "figure save_figures save_view",
    "Errors": """
        ExunetError InputError CaseError CaseWarning RunStopped Interrupted FigureError MissingExtra
    """,
}
API = {group: names.split() for group, names in _GROUPS.items()}
__all__ = ["__version__", *(name for names in API.values() for name in names)]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'exunet' has no attribute {name!r}")
    import re
    from pathlib import Path

    stub = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    (home,) = re.findall(rf"^from (\S+) import {name} as", stub, re.MULTILINE)
    value = getattr(import_module(home), name)
    globals()[name] = value  # so that this function is asked once for each name
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
