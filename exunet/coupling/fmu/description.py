"""What an FMU carries for its worker: the case with its files and overrides, and how it was made."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from xml.etree import ElementTree as Xml

from exunet.base.errors import InputError
from exunet.base.version import VERSION
from exunet.coupling.fmu.variables import Variable, powers
from exunet.scene.casefile import Case, load

FILE = "content.json"


@dataclass(frozen=True)
class Content:
    """Of the folder "resources" of an FMU.

    token     : that binds binary, description and states to each other
    exunet    : version that made it
    case      : name of the case file in the folder "case"
    overrides : applied to it, before those of parameters
    variables, starts : names of all variables, in the order of their values, and those in the case
    paths     : where the Python of the export found its modules
    """

    token: str
    exunet: str
    case: str
    overrides: tuple[str, ...]
    variables: tuple[str, ...]
    starts: tuple[float, ...]
    paths: tuple[str, ...]

    def as_text(self) -> str:
        """The file's text."""
        return json.dumps(asdict(self), indent=1) + "\n"

    @classmethod
    def read(cls, folder: Path) -> Content:
        """Of a folder; raises InputError if it is not there, or of another version of exunet."""
        try:
            found: Mapping[str, object] = json.loads((folder / FILE).read_text(encoding="utf-8"))
            content = cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in found.items()})  # type: ignore[arg-type]
        except (OSError, ValueError, TypeError, AttributeError) as error:
            raise InputError(f"{folder / FILE}: cannot be read ({error}): export the FMU again") from error
        if content.exunet != VERSION:
            raise InputError(
                f"the FMU is of exunet {content.exunet}, its worker of exunet {VERSION}: export it again, or "
                "let EXUNET_PYTHON name a Python that has the exunet of the FMU"
            )
        return content

    def load(self, folder: Path, overrides: list[str]) -> Case:
        """The case, with further overrides."""
        return load(folder / "case" / self.case, [*self.overrides, *overrides])


CATEGORIES = {
    "logStatusError": "why a function returned an error",
    "logStatusDiscard": "why a step was not taken",
}
_NOT_OF_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
TIME = 0  # the value reference of the independent variable; the others follow in their order


@dataclass(frozen=True)
class Description:
    """What the model description tells.

    identifier : of the binary, a C identifier
    name       : of the model
    title      : one line about it
    end, step  : until when, and by which steps [s]; infinite: any
    keeps_states : the FMU can be set back
    files      : of its sources
    """

    identifier: str
    name: str
    title: str
    token: str
    end: float
    step: float
    keeps_states: bool
    variables: tuple[Variable, ...]
    files: tuple[str, ...]


def as_xml(of: Description, fmi: int) -> str:
    """The text for a version of FMI, 2 or 3."""
    root = _of_version_2(of) if fmi == 2 else _of_version_3(of)
    Xml.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def build_description(of: Description) -> str:
    """sources/buildDescription.xml of FMI 3."""
    root = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = _put(root, "BuildConfiguration", modelIdentifier=of.identifier)
    files = _put(configuration, "SourceFileSet", language="C99", compiler="gcc")
    for name in of.files:
        _put(files, "SourceFile", name=name)
    Xml.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def _put(parent: Xml.Element, tag: str, **attributes: object) -> Xml.Element:
    """A new element; attributes that are None are left out."""
    return Xml.SubElement(parent, tag, _written(attributes))


def _written(attributes: Mapping[str, object]) -> dict[str, str]:
    return {name: _text(value) for name, value in attributes.items() if value is not None}


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else _NOT_OF_XML.sub("?", str(value))


def _of_version_3(of: Description) -> Xml.Element:
    root = Xml.Element("fmiModelDescription", _written(_head(of, "3.0") | {"instantiationToken": of.token}))
    _put(
        root,
        "CoSimulation",
        modelIdentifier=of.identifier,
        needsExecutionTool=True,
        canGetAndSetFMUState=of.keeps_states,
        canSerializeFMUState=of.keeps_states,
        canHandleVariableCommunicationStepSize=True,
        hasEventMode=False,
    )
    _units(root, of.variables)
    _categories(root)
    _experiment(root, of)
    variables = _put(root, "ModelVariables")
    _put(
        variables,
        "Float64",
        name="time",
        valueReference=TIME,
        causality="independent",
        variability="continuous",
        description="simulated time",
        unit="s",
    )
    structure = Xml.Element("ModelStructure")
    for number, one in enumerate(of.variables, start=1):
        _put(
            variables,
            "Boolean" if one.is_switch else "Float64",
            name=one.name,
            valueReference=number,
            **_kind(one),
            description=one.description,
            **_number(one),
        )
    outputs = [number for number, one in enumerate(of.variables, start=1) if one.causality == "output"]
    for tag, dependencies in (("Output", ""), ("InitialUnknown", None)):
        for number in outputs:
            _put(structure, tag, valueReference=number, dependencies=dependencies)
    root.append(structure)
    return root


def _of_version_2(of: Description) -> Xml.Element:
    head = _head(of, "2.0") | {"guid": of.token, "numberOfEventIndicators": 0}
    root = Xml.Element("fmiModelDescription", _written(head))
    simulation = _put(
        root,
        "CoSimulation",
        modelIdentifier=of.identifier,
        needsExecutionTool=True,
        canHandleVariableCommunicationStepSize=True,
        canGetAndSetFMUstate=of.keeps_states,
        canSerializeFMUstate=of.keeps_states,
    )
    files = _put(simulation, "SourceFiles")
    for name in of.files:
        _put(files, "File", name=name)
    _units(root, of.variables)
    _categories(root)
    _experiment(root, of)
    variables = _put(root, "ModelVariables")
    for number, one in enumerate(of.variables, start=1):
        variable = _put(
            variables,
            "ScalarVariable",
            name=one.name,
            valueReference=number,
            description=one.description,
            **_kind(one),
        )
        _put(variable, "Boolean" if one.is_switch else "Real", **_number(one))
    structure = _put(root, "ModelStructure")
    outputs = [number for number, one in enumerate(of.variables, start=1) if one.causality == "output"]
    for tag, dependencies in (("Outputs", ""), ("InitialUnknowns", None)):
        unknowns = _put(structure, tag)
        for number in outputs:  # counted from 1, as the value references happen to be
            _put(unknowns, "Unknown", index=number, dependencies=dependencies)
    return root


def _head(of: Description, version: str) -> dict[str, object]:
    return {
        "fmiVersion": version,
        "modelName": of.name,
        "description": of.title,
        "generationTool": f"exunet {VERSION}",
        "variableNamingConvention": "structured",
    }


def _kind(one: Variable) -> dict[str, object]:
    is_output, is_parameter = one.causality == "output", one.causality == "parameter"
    return {
        "causality": one.causality,
        "variability": "fixed" if is_parameter else "continuous",
        "initial": "calculated" if is_output else "exact" if is_parameter else None,
    }


def _number(one: Variable) -> dict[str, object]:
    """Unit, bounds, and the start of what the host may set."""
    start: object = None if one.causality == "output" else one.start
    if one.is_switch:
        return {"start": bool(start)}
    return {"unit": one.unit or None, "min": one.low, "max": one.high, "start": start}


def _units(root: Xml.Element, variables: Sequence[Variable]) -> None:
    definitions = _put(root, "UnitDefinitions")
    for unit in sorted({"s"} | {variable.unit for variable in variables if variable.unit}):
        base: dict[str, object] = dict(powers(unit))
        _put(_put(definitions, "Unit", name=unit), "BaseUnit", **base)


def _categories(root: Xml.Element) -> None:
    categories = _put(root, "LogCategories")
    for name, words in CATEGORIES.items():
        _put(categories, "Category", name=name, description=words)


def _experiment(root: Xml.Element, of: Description) -> None:
    _put(
        root,
        "DefaultExperiment",
        startTime=0.0,
        stopTime=of.end,
        stepSize=of.step if math.isfinite(of.step) else None,
    )
