"""`export_fmu`: a case as a file with the ending .fmu."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path

from exunet.base.errors import InputError, MissingExtra
from exunet.base.files import path_of, replacing
from exunet.base.version import VERSION
from exunet.coupling.fmu.description import FILE, Content, Description, as_xml, build_description
from exunet.coupling.fmu.served import FmuModel
from exunet.coupling.fmu.signals import Signals
from exunet.coupling.fmu.variables import Variable
from exunet.coupling.prediction import STABLE, longest_step
from exunet.scene.casefile import Case, load, parse_case, refuse_other_overrides
from exunet.simulation.preparation import load_restart

VERSIONS = (2, 3)
_COMMON = ("instance.c", "instance.h", "worker.c", "worker.h")

# What the worker begins with: the modules that the Python of the export had, in their order. With
# EXUNET_PYTHON it is another Python, with modules of its own.
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
    text = f"{sys.executable} cannot import exunet: {type(error).__name__}: {error}. Let the environment "
    text += "variable EXUNET_PYTHON name a Python that has exunet"
    os.write(0, struct.pack("=QQ", 1, len(text.encode())) + text.encode())
    sys.exit(1)
main(str(folder))
'''


def export_fmu(
    case: str | Path | Case,
    path: str | Path,
    overrides: Sequence[str] = (),
    *,
    fmi: int = 3,
    overwrite: bool = False,
) -> Path:
    """Make an FMU for co-simulation of a case; returns its path.

    case      : a case file's name, or what `exunet.load` gave
    overrides : "key.path=value", as after --set
    fmi       : version of the standard, 2 or 3
    overwrite : replace a file that is there
    The host's machine needs a Python with this exunet: that of the export, or the one that the environment
    variable EXUNET_PYTHON names there. Raises CaseError for a case that cannot be simulated, InputError if
    the file cannot be written, and MissingExtra if there is no C compiler.
    """
    if fmi not in VERSIONS:
        raise InputError(f"fmi: must be 2 or 3, got {fmi!r}")
    refuse_other_overrides(overrides, "export_fmu")
    target = path_of(path, "export_fmu")
    if os.path.exists(target) and not overwrite:
        raise InputError(
            f"{path}: there is a file of that name (overwrite=True, or --overwrite, replaces it)"
        )
    found = case if isinstance(case, Case) else load(path_of(case, "export_fmu"), overrides)
    if isinstance(case, Case) and overrides:
        found = parse_case(case.text, case.path, [*case.overrides, *overrides])
    binaries, compiler = _platform(fmi), _compiler()
    model = FmuModel(found)
    net = model.net(found)
    variables = model.variables(Signals(net))
    files, moved = _files_of(found)
    sources = {name: _source(name) for name in (*_COMMON, f"fmi{fmi}.c")}
    of_case = [VERSION, fmi, found.text, found.overrides, moved, repr(variables), sorted(sources.items())]
    token = _token([*of_case, *(hashlib.sha256(file).hexdigest() for file in files.values())])
    identifier = _identifier(found.name)
    content = Content(
        token,
        VERSION,
        f"{identifier}.toml",
        (*found.overrides, *moved),
        tuple(variable.name for variable in variables),
        tuple(item.start for item in variables),
        tuple(dict.fromkeys(str(Path(entry).resolve()) for entry in sys.path if entry)),
    )
    sources |= _table(token, variables)
    time, longest = found.scene.time, longest_step(net, STABLE)
    description = Description(
        identifier=identifier,
        name=found.name,
        title=found.scene.title,
        token=token,
        end=time.end,
        step=min(time.output_step or longest, longest),
        keeps_states=net.simulation.can_restart,
        variables=variables,
        files=tuple(sorted(name for name in sources if name.endswith(".c"))),
    )
    members = {
        "modelDescription.xml": as_xml(description, fmi).encode(),
        f"resources/{FILE}": content.as_text().encode(),
        "resources/start.py": _START.encode(),
        "resources/python.txt": f"{sys.executable}\n".encode(),
        f"resources/case/{content.case}": found.text.encode(),
        **{f"resources/case/{name}": one for name, one in files.items()},
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
        f"binaries/{binaries}/{description.identifier}.so": _compiled(compiler, sources),
    }
    if fmi == 3:
        members["sources/buildDescription.xml"] = build_description(description).encode()
    with replacing(target) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, one in sorted(members.items()):
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), one, zipfile.ZIP_DEFLATED)
    return target


def _platform(fmi: int) -> str:
    """The name of the folder of the binary."""
    machine = platform.machine()
    if sys.platform != "linux" or (fmi == 2 and machine != "x86_64"):
        raise InputError(f"fmi: no FMU of FMI {fmi} can be made on {sys.platform}, {machine}")
    return "linux64" if fmi == 2 else f"{machine}-linux"


def _compiler() -> str:
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None:
        raise MissingExtra("export_fmu: an FMU needs a C compiler: install gcc")
    return found


def _source(name: str) -> str:
    return (resources.files("exunet.coupling.fmu") / "c" / name).read_text(encoding="utf-8")


def _files_of(case: Case) -> tuple[dict[str, bytes], list[str]]:
    """Meshes and a result that the case names, by their new names, and the overrides that name them there."""
    files: dict[str, bytes] = {}
    moved = []
    for number, (name, keys) in enumerate(case.scene.bodies.items()):
        if keys.file is not None:
            new = f"mesh{number}{Path(keys.file).suffix}"
            files[new] = Path(keys.file).read_bytes()
            moved.append(f"bodies.{name}.file={json.dumps(new)}")
    if (named := case.scene.initial.restart) is not None:
        source = load_restart(named)
        files["start.h5"] = Path(source.provenance.result).read_bytes()
        moved.append(f'initial.restart="start.h5@{source.provenance.time_s!r}"')
    return files, moved


def _token(content: Sequence[object]) -> str:
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    return "{" + "-".join(digest[i:j] for i, j in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32))) + "}"


def _identifier(name: str) -> str:
    """A C identifier."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z]", plain) else f"net_{plain}"


def _table(token: str, variables: Sequence[Variable]) -> dict[str, str]:
    """The sources with the names, kinds and starts of the variables."""
    kinds = [("s" if variable.is_switch else "n", variable.causality[0]) for variable in variables]
    rows = [
        f"    {{{_c_string(one.name)}, '{kind}', '{causality}', {one.start.hex()}}},"
        for one, (kind, causality) in zip(variables, kinds, strict=True)
    ]
    head = [
        "/* The variables of this FMU, in the order of their value references, which begin with 1. */",
        f'#define TOKEN "{token}"',
        f"#define VARIABLES {len(variables)}",
        "typedef struct {",
        "    const char *name;",
        "    char kind, causality; /* n: number, s: switch; p: parameter, i: input, o: output */",
        "    double start;",
        "} variable;",
        "extern const variable table[VARIABLES];",
    ]
    body = ['#include "table.h"', "", "const variable table[VARIABLES] = {", *rows, "};"]
    return {"table.h": "\n".join(head) + "\n", "table.c": "\n".join(body) + "\n"}


def _c_string(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _compiled(compiler: str, sources: dict[str, str]) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        command = [
            compiler,
            "-std=gnu99",
            "-shared",
            "-fPIC",
            "-O2",
            "-fvisibility=hidden",
            "-s",
            "-o",
            "net.so",
        ]
        command += [*sorted(file for file in sources if file.endswith(".c")), "-lm"]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        except OSError as error:
            raise InputError(f"export_fmu: {compiler} cannot be started: {error}") from error
        if done.returncode != 0:
            lines = list(_errors(done.stderr))
            raise InputError(f"export_fmu: {compiler} cannot compile the FMU: {'; '.join(lines[:3])}")
        return (folder / "net.so").read_bytes()


def _errors(text: str) -> Iterator[str]:
    yield from (line.strip() for line in text.splitlines() if "error" in line)
    yield from text.strip().splitlines()[-1:]
