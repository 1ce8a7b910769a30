"""Export of a case as an FMU: model description, sources, compiled library, and the case for its worker."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree as Xml

from exunet.base.errors import InputError, MissingExtra
from exunet.base.files import path_of, replacing
from exunet.base.version import VERSION
from exunet.coupling.fmu.variables import Signals, Variable, powers
from exunet.coupling.fmu.worker import FILE, Content, FmuModel
from exunet.coupling.stability import STABLE, longest_step
from exunet.scene.casefile import Case, case_of, files_of, refuse_other_overrides
from exunet.scene.scene import Scene
from exunet.simulation.preparation import load_restart

VERSIONS = (2, 3)
PART = 0.8  # of the longest step at the start: the default, as the bound shrinks with the stretch at ports
_TOLERANCE = "accuracy as the case defines it, a tolerance of the host is ignored"
CATEGORIES = {
    "logStatusError": "why a function returned an error",
    "logStatusDiscard": "why a step was not taken",
}
_NOT_OF_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_SOURCES = ("fmi.c", "instance.c", "instance.h", "worker.c", "worker.h")

# Start of the worker: with the module paths of the export, or with the Python of EXUNET_PYTHON and its own.
_START = '''"""Starts the worker of this FMU; see exunet/coupling/fmu/worker.py."""

import json
import os
import struct
import sys
from pathlib import Path

folder = Path(__file__).resolve().parent
if not os.environ.get("EXUNET_PYTHON"):
    paths = json.loads((folder / "content.json").read_text(encoding="utf-8"))["paths"]
    sys.path[:] = [*paths, *(path for path in sys.path if path not in paths)]
try:
    from exunet.coupling.fmu.worker import main
except Exception as error:
    text = f"{sys.executable} cannot import exunet: {type(error).__name__}: {error}. Set the environment "
    text += "variable EXUNET_PYTHON to a Python that has exunet"
    os.write(0, struct.pack("=QQ", 1, len(text.encode())) + text.encode())
    sys.exit(1)
main(str(folder))
'''


@dataclass(frozen=True)
class Description:
    """Content of the model description.

    identifier   : of the binary, a C identifier
    name, title  : of the model; one line about it
    end, step    : default experiment [s]; infinite: any
    keeps_states : states can be restored
    sources      : names of the C files
    """

    identifier: str
    name: str
    title: str
    token: str
    end: float
    step: float
    keeps_states: bool
    variables: tuple[Variable, ...]
    sources: tuple[str, ...]


def as_xml(of: Description, fmi: int) -> str:
    """Return modelDescription.xml for a version of FMI, 2 or 3."""
    new = fmi == 3
    root = Xml.Element("fmiModelDescription")
    _set(
        root,
        fmiVersion=f"{fmi}.0",
        modelName=of.name,
        description=f"{of.title}: {_TOLERANCE}" if of.title else _TOLERANCE,
        generationTool=f"exunet {VERSION}",
    )
    _set(root, variableNamingConvention="structured", numberOfEventIndicators=None if new else 0)
    _set(root, **{"instantiationToken" if new else "guid": of.token})
    simulation = _put(root, "CoSimulation", modelIdentifier=of.identifier, needsExecutionTool=True)
    of_state = "FMUState" if new else "FMUstate"
    _set(simulation, **{f"{does}{of_state}": of.keeps_states for does in ("canGetAndSet", "canSerialize")})
    _set(simulation, canHandleVariableCommunicationStepSize=True, hasEventMode=False if new else None)
    if not new:
        files = _put(simulation, "SourceFiles")
        for name in of.sources:
            _put(files, "File", name=name)
    units = _put(root, "UnitDefinitions")
    for unit in sorted({"s"} | {variable.unit for variable in of.variables if variable.unit}):
        base: dict[str, object] = dict(powers(unit))
        _put(_put(units, "Unit", name=unit), "BaseUnit", **base)
    categories = _put(root, "LogCategories")
    for name, words in CATEGORIES.items():
        _put(categories, "Category", name=name, description=words)
    step = of.step if math.isfinite(of.step) else None
    _put(root, "DefaultExperiment", startTime=0.0, stopTime=of.end, stepSize=step)
    variables = _put(root, "ModelVariables")
    if new:
        time = _put(variables, "Float64", name="time", valueReference=0, causality="independent", unit="s")
        _set(time, variability="continuous", description="simulated time")
    number_type = "Float64" if new else "Real"
    for reference, variable in enumerate(of.variables, start=1):
        what, is_parameter = variable.causality, variable.causality == "parameter"
        kind = "Boolean" if variable.is_switch else number_type
        element = _put(
            variables, kind if new else "ScalarVariable", name=variable.name, valueReference=reference
        )
        _set(element, description=variable.description, causality=what)
        _set(element, variability="fixed" if is_parameter else "continuous")
        _set(element, initial={"output": "calculated", "parameter": "exact"}.get(what))
        values = element if new else _put(element, kind)
        start: object = None if what == "output" else variable.start
        if variable.is_switch:
            _set(values, start=bool(start))
        else:
            _set(values, unit=variable.unit or None, min=variable.low, max=variable.high, start=start)
    structure = _put(root, "ModelStructure")
    for tag, dependencies in (("Output", ""), ("InitialUnknown", None)):
        parent = structure if new else _put(structure, f"{tag}s")
        for reference, variable in enumerate(of.variables, start=1):
            if variable.causality == "output":  # FMI 2 counts from 1, as the value references do
                unknown = _put(parent, tag if new else "Unknown", dependencies=dependencies)
                _set(unknown, **{"valueReference" if new else "index": reference})
    return _text_of(root)


def build_description(of: Description) -> str:
    """Return sources/buildDescription.xml of FMI 3."""
    root = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = _put(root, "BuildConfiguration", modelIdentifier=of.identifier)
    files = _put(configuration, "SourceFileSet", language="C99", compiler="gcc")
    for name in of.sources:
        _put(files, "SourceFile", name=name)
    return _text_of(root)


def _text_of(root: Xml.Element) -> str:
    Xml.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def _put(parent: Xml.Element, tag: str, **attributes: object) -> Xml.Element:
    """Add an element with its attributes; None: absent."""
    element = Xml.SubElement(parent, tag)
    _set(element, **attributes)
    return element


def _set(element: Xml.Element, **attributes: object) -> None:
    for name, value in attributes.items():
        if isinstance(value, bool):
            element.set(name, "true" if value else "false")
        elif value is not None:
            element.set(name, repr(value) if isinstance(value, float) else _NOT_OF_XML.sub("?", str(value)))


def export_fmu(
    case: str | Path | Case | Scene,
    path: str | Path,
    overrides: Sequence[str] = (),
    *,
    fmi: int = 3,
    overwrite: bool = False,
) -> Path:
    """Export a case as an FMU for co-simulation; return its path.

    Parameters
    ----------
    case : str, Path, Case or Scene
        Name of a case file, the result of `exunet.load`, or a scene.
    path : str or Path
    overrides : sequence of str, optional
        "key.path=value", as after --set.
    fmi : int, optional
        Version of the standard, 2 or 3.
    overwrite : bool, optional
        Replace an existing file.

    Raises
    ------
    CaseError
        For a case that cannot be simulated.
    InputError
        If the file cannot be written.
    MissingExtra
        Without a C compiler.

    Notes
    -----
    The host's machine needs a Python with this exunet: that of the export, or that of the environment
    variable EXUNET_PYTHON there.
    """
    if fmi not in VERSIONS:
        raise InputError(f"fmi: must be 2 or 3, got {fmi!r}")
    refuse_other_overrides(overrides, "export_fmu")
    target = path_of(path, "export_fmu")
    if os.path.exists(target) and not overwrite:
        raise InputError(
            f"{path}: there is a file of that name (overwrite=True, or --overwrite, replaces it)"
        )
    found = case_of(case, "export_fmu", overrides)
    binaries, compiler = _platform(fmi), shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise MissingExtra("export_fmu: an FMU needs a C compiler: install gcc")
    model = FmuModel(found)
    net = model.net(found)
    variables = model.variables(Signals(net))
    files, moved = _files_of(found)
    folder = resources.files("exunet.coupling.fmu") / "c"
    sources = {name: (folder / name).read_text(encoding="utf-8") for name in _SOURCES}
    of_case = [VERSION, fmi, found.text, found.overrides, moved, repr(variables), sorted(sources.items())]
    token = _token([*of_case, *(hashlib.sha256(file).hexdigest() for file in files.values())])
    plain = re.sub(r"\W", "_", found.name, flags=re.ASCII)
    identifier = plain if re.match(r"[A-Za-z]", plain) else f"net_{plain}"
    content = Content(
        token,
        VERSION,
        f"{identifier}.toml",
        (*found.overrides, *moved),
        tuple(variable.name for variable in variables),
        tuple(variable.start for variable in variables),
        tuple(dict.fromkeys(str(Path(entry).resolve()) for entry in sys.path if entry)),
    )
    sources |= _table(token, fmi, variables)
    time, longest = found.scene.time, PART * longest_step(net, STABLE)
    description = Description(
        identifier=identifier,
        name=found.name,
        title=found.scene.title,
        token=token,
        end=time.end,
        step=min(time.output_step or longest, longest),
        keeps_states=net.simulation.can_restart,
        variables=variables,
        sources=tuple(sorted(name for name in sources if name.endswith(".c"))),
    )
    members = {
        "modelDescription.xml": as_xml(description, fmi).encode(),
        f"resources/{FILE}": (json.dumps(asdict(content), indent=1) + "\n").encode(),
        "resources/start.py": _START.encode(),
        "resources/python.txt": f"{sys.executable}\n".encode(),
        f"resources/case/{content.case}": found.text.encode(),
        **{f"resources/case/{name}": file for name, file in files.items()},
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
        f"binaries/{binaries}/{identifier}.so": _compiled(compiler, sources),
    }
    if fmi == 3:
        members["sources/buildDescription.xml"] = build_description(description).encode()
    with replacing(target) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in sorted(members.items()):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), member, zipfile.ZIP_DEFLATED)
    return target


def _platform(fmi: int) -> str:
    """Return the name of the folder of the binary."""
    machine = platform.machine()
    if sys.platform != "linux" or (fmi == 2 and machine != "x86_64"):
        raise InputError(f"fmi: no FMU of FMI {fmi} can be made on {sys.platform}, {machine}")
    return "linux64" if fmi == 2 else f"{machine}-linux"


def _files_of(case: Case) -> tuple[dict[str, bytes], list[str]]:
    """Return the files and the result that a case names, by new names, and the overrides to these."""
    files: dict[str, bytes] = {}
    moved = []
    for number, (key, file) in enumerate(files_of(case.scene).items()):
        new = f"file{number}{Path(file).suffix}"
        files[new] = Path(file).read_bytes()
        moved.append(f"{key}={json.dumps(new)}")
    if (named := case.scene.initial.restart) is not None:
        source = load_restart(named)
        files["start.h5"] = Path(source.origin.result).read_bytes()
        moved.append(f'initial.restart="start.h5@{source.origin.time_s!r}"')
    return files, moved


def _token(content: Sequence[object]) -> str:
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    return "{" + "-".join(digest[i:j] for i, j in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32))) + "}"


def _table(token: str, fmi: int, variables: Sequence[Variable]) -> dict[str, str]:
    """Return the sources with names, kinds and starts of the variables, in the order of their references."""
    rows = [
        "    "
        f"    {{{json.dumps(variable.name, ensure_ascii=False)}, '{'s' if variable.is_switch else 'n'}', "
        f"'{variable.causality[0]}', {variable.start.hex()}}},"
        for variable in variables
    ]
    head = f"""/* The variables of this FMU, in the order of their value references, which begin with 1. */
#define FMI {fmi}
#define TOKEN "{token}"
#define VARIABLES {len(variables)}
typedef struct {{
    const char *name;
    char kind, causality; /* n: number, s: switch; p: parameter, i: input, o: output */
    double start;
}} variable;
extern const variable table[VARIABLES];
"""
    body = ['#include "table.h"', "", "const variable table[VARIABLES] = {", *rows, "};"]
    return {"table.h": head, "table.c": "\n".join(body) + "\n"}


def _compiled(compiler: str, sources: Mapping[str, str]) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        options = ["-std=gnu99", "-shared", "-fPIC", "-O2", "-fvisibility=hidden", "-s"]
        command = [compiler, *options, "-o", "net.so"]
        command += [*sorted(file for file in sources if file.endswith(".c")), "-lm"]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        except OSError as error:
            raise InputError(f"export_fmu: {compiler} cannot be started: {error}") from error
        if done.returncode != 0:
            lines = [line.strip() for line in done.stderr.splitlines() if "error" in line][:3]
            raise InputError(f"export_fmu: {compiler} cannot compile the FMU: {'; '.join(lines)}")
        return (folder / "net.so").read_bytes()
