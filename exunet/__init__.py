"""exunet: deployable cable nets for catching space debris, simulated with Exudyn and cross-checked.

    import exunet
    result = exunet.run(exunet.load("cases/planar_deployment.toml"))

docs/reference/python describes all public names. They are imported when they are first used, so that
`import exunet` itself costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from exunet.base.version import VERSION

__version__ = VERSION

if TYPE_CHECKING:
    from exunet.base.errors import CaseError as CaseError
    from exunet.base.errors import CaseWarning as CaseWarning
    from exunet.base.errors import ExunetError as ExunetError
    from exunet.base.errors import InputError as InputError
    from exunet.base.errors import Interrupted as Interrupted
    from exunet.base.errors import MissingExtra as MissingExtra
    from exunet.base.errors import RunStopped as RunStopped
    from exunet.bodies.config import Attachment as Attachment
    from exunet.bodies.config import Body as Body
    from exunet.bodies.config import Part as Part
    from exunet.bodies.port import FrameState as FrameState
    from exunet.coupling.coupler import Coupler as Coupler
    from exunet.coupling.exudyn_host import ExudynHost as ExudynHost
    from exunet.coupling.exudyn_host import NativeItems as NativeItems
    from exunet.coupling.exudyn_host import add_to as add_to
    from exunet.coupling.fmu.export import export_fmu as export_fmu
    from exunet.coupling.host import BodiesHost as BodiesHost
    from exunet.coupling.host import Host as Host
    from exunet.coupling.net_system import NetSystem as NetSystem
    from exunet.coupling.net_system import PortLoad as PortLoad
    from exunet.coupling.rollback import CoupledSnapshot as CoupledSnapshot
    from exunet.coupling.rollback import Ledger as Ledger
    from exunet.forces.blocks import Blocks as Blocks
    from exunet.forces.blocks import FirstOrder as FirstOrder
    from exunet.forces.contact.status import ContactKey as ContactKey
    from exunet.forces.corner_units import FormationControl as FormationControl
    from exunet.forces.corner_units import GivenControl as GivenControl
    from exunet.forces.corner_units import Noise as Noise
    from exunet.forces.corner_units import PointControl as PointControl
    from exunet.forces.corner_units import TableControl as TableControl
    from exunet.forces.effects import Effects as Effects
    from exunet.forces.effects.air_drag import AirDrag as AirDrag
    from exunet.forces.effects.bending import Bending as Bending
    from exunet.forces.effects.breaking import Breaking as Breaking
    from exunet.forces.effects.contact import HertzContact as HertzContact
    from exunet.forces.effects.contact import LinearContact as LinearContact
    from exunet.forces.effects.contact import RegularisedFriction as RegularisedFriction
    from exunet.forces.effects.contact import StickingFriction as StickingFriction
    from exunet.forces.effects.gravity import Gravity as Gravity
    from exunet.forces.effects.j2 import J2 as J2
    from exunet.forces.effects.launch_force import GasLaunchForce as GasLaunchForce
    from exunet.forces.effects.launch_force import SpringLaunchForce as SpringLaunchForce
    from exunet.forces.effects.mass_damping import MassDamping as MassDamping
    from exunet.forces.effects.material_damping import MaterialDamping as MaterialDamping
    from exunet.forces.effects.molecular_drag import MolecularDrag as MolecularDrag
    from exunet.forces.effects.orbit import Orbit as Orbit
    from exunet.forces.effects.rayleigh_damping import RayleighDamping as RayleighDamping
    from exunet.forces.effects.self_contact import SelfContact as SelfContact
    from exunet.forces.effects.solar_pressure import SolarPressure as SolarPressure
    from exunet.forces.effects.thermal_strain import ThermalStrain as ThermalStrain
    from exunet.forces.effects.thrust import Thrust as Thrust
    from exunet.forces.terms import Input as Input
    from exunet.forces.terms import KernelTerm as KernelTerm
    from exunet.methods.config import Solver as Solver
    from exunet.net.base import Bullets as Bullets
    from exunet.net.base import Cable as Cable
    from exunet.net.base import Strings as Strings
    from exunet.net.closing import ClosingLine as ClosingLine
    from exunet.net.closing import EndOfLine as EndOfLine
    from exunet.net.closing import Perimeter as Perimeter
    from exunet.net.closing import Winch as Winch
    from exunet.net.cut import CutNet as CutNet
    from exunet.net.drive import Brake as Brake
    from exunet.net.drive import Lock as Lock
    from exunet.net.drive import Rate as Rate
    from exunet.net.drive import Tension as Tension
    from exunet.net.explicit import ExplicitNet as ExplicitNet
    from exunet.net.folding import Fold as Fold
    from exunet.net.hexagonal import HexagonalNet as HexagonalNet
    from exunet.net.radial import RadialNet as RadialNet
    from exunet.net.rectangular import RectangularNet as RectangularNet
    from exunet.net.square import SquareNet as SquareNet
    from exunet.net.tether import Reel as Reel
    from exunet.net.tether import Tether as Tether
    from exunet.net.tether import TetherEnd as TetherEnd
    from exunet.plots.registry import figure as figure
    from exunet.plots.registry import save_figures as save_figures
    from exunet.results.clearance import clearance as clearance
    from exunet.results.comparison import Agreement as Agreement
    from exunet.results.comparison import compare as compare
    from exunet.results.ensemble import Ensemble as Ensemble
    from exunet.results.ensemble import load_ensemble as load_ensemble
    from exunet.results.ensemble import save_ensemble as save_ensemble
    from exunet.results.io import load_result as load_result
    from exunet.results.io import save as save
    from exunet.results.loads import CarriedLoads as CarriedLoads
    from exunet.results.loads import Loads as Loads
    from exunet.results.loads import Margin as Margin
    from exunet.results.loads import loads as loads
    from exunet.results.loads import margins as margins
    from exunet.results.measures import Deployment as Deployment
    from exunet.results.measures import achievable_area as achievable_area
    from exunet.results.measures import bullet_speeds as bullet_speeds
    from exunet.results.measures import centre_of_mass as centre_of_mass
    from exunet.results.measures import deployment as deployment
    from exunet.results.measures import energy_balance as energy_balance
    from exunet.results.measures import largest_tensions as largest_tensions
    from exunet.results.measures import mesh_area as mesh_area
    from exunet.results.measures import mouth_area as mouth_area
    from exunet.results.measures import peak_tensions as peak_tensions
    from exunet.results.metrics import Metric as Metric
    from exunet.results.metrics import metrics as metrics
    from exunet.results.result import BodyStates as BodyStates
    from exunet.results.result import Result as Result
    from exunet.results.summary import summarise as summarise
    from exunet.scene.capture import Capture as Capture
    from exunet.scene.casefile import load as load
    from exunet.scene.scene import ConeLaunch as ConeLaunch
    from exunet.scene.scene import Engine as Engine
    from exunet.scene.scene import Initial as Initial
    from exunet.scene.scene import NetFrame as NetFrame
    from exunet.scene.scene import RadialLaunch as RadialLaunch
    from exunet.scene.scene import Scene as Scene
    from exunet.scene.scene import Time as Time
    from exunet.scene.script import ScriptEntry as ScriptEntry
    from exunet.simulation.preparation import Start as Start
    from exunet.simulation.preparation import prepare as prepare
    from exunet.simulation.run import resume as resume
    from exunet.simulation.run import run as run
    from exunet.simulation.simulation import Simulation as Simulation
    from exunet.simulation.snapshot import Snapshot as Snapshot
    from exunet.studies.ensemble import ensemble as ensemble
    from exunet.studies.ensemble import perturbed_positions as perturbed_positions
    from exunet.studies.ensemble import run_ensemble as run_ensemble
    from exunet.studies.environment import NetEnvironment as NetEnvironment
    from exunet.studies.optimise import Optimum as Optimum
    from exunet.studies.optimise import optimise as optimise
    from exunet.studies.study import Study as Study
    from exunet.studies.study import StudyTable as StudyTable

# Groups of public names, in the order of docs/reference/python: name -> the module it lives in.
API = {
    "Run a case": {
        "load": "exunet.scene.casefile",
        "run": "exunet.simulation.run",
        "resume": "exunet.simulation.run",
    },
    "Build a scene": {
        "Scene": "exunet.scene.scene",
        "Time": "exunet.scene.scene",
        "Solver": "exunet.methods.config",
        "Engine": "exunet.scene.scene",
        "SquareNet": "exunet.net.square",
        "RectangularNet": "exunet.net.rectangular",
        "HexagonalNet": "exunet.net.hexagonal",
        "RadialNet": "exunet.net.radial",
        "CutNet": "exunet.net.cut",
        "ExplicitNet": "exunet.net.explicit",
        "Cable": "exunet.net.base",
        "Strings": "exunet.net.base",
        "Bullets": "exunet.net.base",
        "Initial": "exunet.scene.scene",
        "Fold": "exunet.net.folding",
        "NetFrame": "exunet.scene.scene",
        "ConeLaunch": "exunet.scene.scene",
        "RadialLaunch": "exunet.scene.scene",
        "Body": "exunet.bodies.config",
        "Part": "exunet.bodies.config",
        "Attachment": "exunet.bodies.config",
        "Tether": "exunet.net.tether",
        "TetherEnd": "exunet.net.tether",
        "Reel": "exunet.net.tether",
        "ClosingLine": "exunet.net.closing",
        "EndOfLine": "exunet.net.closing",
        "Winch": "exunet.net.closing",
        "Perimeter": "exunet.net.closing",
        "Brake": "exunet.net.drive",
        "Lock": "exunet.net.drive",
        "Rate": "exunet.net.drive",
        "Tension": "exunet.net.drive",
        "PointControl": "exunet.forces.corner_units",
        "FormationControl": "exunet.forces.corner_units",
        "TableControl": "exunet.forces.corner_units",
        "GivenControl": "exunet.forces.corner_units",
        "Noise": "exunet.forces.corner_units",
        "Capture": "exunet.scene.capture",
        "ScriptEntry": "exunet.scene.script",
        "Effects": "exunet.forces.effects",
        "Gravity": "exunet.forces.effects.gravity",
        "MassDamping": "exunet.forces.effects.mass_damping",
        "MaterialDamping": "exunet.forces.effects.material_damping",
        "RayleighDamping": "exunet.forces.effects.rayleigh_damping",
        "LinearContact": "exunet.forces.effects.contact",
        "HertzContact": "exunet.forces.effects.contact",
        "StickingFriction": "exunet.forces.effects.contact",
        "RegularisedFriction": "exunet.forces.effects.contact",
        "SelfContact": "exunet.forces.effects.self_contact",
        "Bending": "exunet.forces.effects.bending",
        "Breaking": "exunet.forces.effects.breaking",
        "ThermalStrain": "exunet.forces.effects.thermal_strain",
        "AirDrag": "exunet.forces.effects.air_drag",
        "MolecularDrag": "exunet.forces.effects.molecular_drag",
        "SolarPressure": "exunet.forces.effects.solar_pressure",
        "Orbit": "exunet.forces.effects.orbit",
        "J2": "exunet.forces.effects.j2",
        "SpringLaunchForce": "exunet.forces.effects.launch_force",
        "GasLaunchForce": "exunet.forces.effects.launch_force",
        "Thrust": "exunet.forces.effects.thrust",
    },
    "Step a simulation": {
        "Simulation": "exunet.simulation.simulation",
        "Snapshot": "exunet.simulation.snapshot",
        "NetEnvironment": "exunet.studies.environment",
    },
    "Add forces": {
        "KernelTerm": "exunet.forces.terms",
        "Input": "exunet.forces.terms",
        "FirstOrder": "exunet.forces.blocks",
        "Blocks": "exunet.forces.blocks",
    },
    "Couple a net to a host": {
        "NetSystem": "exunet.coupling.net_system",
        "FrameState": "exunet.bodies.port",
        "PortLoad": "exunet.coupling.net_system",
        "Coupler": "exunet.coupling.coupler",
        "Ledger": "exunet.coupling.rollback",
        "CoupledSnapshot": "exunet.coupling.rollback",
    },
    "Hosts": {
        "Host": "exunet.coupling.host",
        "BodiesHost": "exunet.coupling.host",
        "ExudynHost": "exunet.coupling.exudyn_host",
        "add_to": "exunet.coupling.exudyn_host",
        "NativeItems": "exunet.coupling.exudyn_host",
        "export_fmu": "exunet.coupling.fmu.export",
    },
    "Results": {
        "Result": "exunet.results.result",
        "ContactKey": "exunet.forces.contact.status",
        "BodyStates": "exunet.results.result",
        "load_result": "exunet.results.io",
        "save": "exunet.results.io",
        "export": "exunet.results.export",
        "to_frame": "exunet.results.export",
        "summarise": "exunet.results.summary",
    },
    "Metrics": {
        "metrics": "exunet.results.metrics",
        "Metric": "exunet.results.metrics",
        "deployment": "exunet.results.measures",
        "Deployment": "exunet.results.measures",
        "mouth_area": "exunet.results.measures",
        "mesh_area": "exunet.results.measures",
        "achievable_area": "exunet.results.measures",
        "bullet_speeds": "exunet.results.measures",
        "centre_of_mass": "exunet.results.measures",
        "peak_tensions": "exunet.results.measures",
        "largest_tensions": "exunet.results.measures",
        "energy_balance": "exunet.results.measures",
        "loads": "exunet.results.loads",
        "CarriedLoads": "exunet.results.loads",
        "Loads": "exunet.results.loads",
        "clearance": "exunet.results.clearance",
        "margins": "exunet.results.loads",
        "Margin": "exunet.results.loads",
    },
    "Compare runs": {
        "compare": "exunet.results.comparison",
        "Agreement": "exunet.results.comparison",
    },
    "Ensembles": {
        "ensemble": "exunet.studies.ensemble",
        "Ensemble": "exunet.results.ensemble",
        "save_ensemble": "exunet.results.ensemble",
        "load_ensemble": "exunet.results.ensemble",
        "prepare": "exunet.simulation.preparation",
        "Start": "exunet.simulation.preparation",
        "perturbed_positions": "exunet.studies.ensemble",
        "run_ensemble": "exunet.studies.ensemble",
    },
    "Studies": {
        "Study": "exunet.studies.study",
        "StudyTable": "exunet.studies.study",
        "optimise": "exunet.studies.optimise",
        "Optimum": "exunet.studies.optimise",
    },
    "Figures": {
        "figure": "exunet.plots.registry",
        "save_figures": "exunet.plots.registry",
        "save_view": "exunet.plots.view",
    },
    "Errors": {
        "ExunetError": "exunet.base.errors",
        "InputError": "exunet.base.errors",
        "CaseError": "exunet.base.errors",
        "CaseWarning": "exunet.base.errors",
        "RunStopped": "exunet.base.errors",
        "Interrupted": "exunet.base.errors",
        "FigureError": "exunet.base.errors",
        "MissingExtra": "exunet.base.errors",
    },
}
_HOME = {name: home for group in API.values() for name, home in group.items()}
__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'exunet' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value  # so that this function is asked once for each name
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
