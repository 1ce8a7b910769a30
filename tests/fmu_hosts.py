"""FMUs of small cases, and a host in C that loads them, for the tests of FMUs."""

from __future__ import annotations

import os
import subprocess
import zipfile
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

SOURCE = Path(__file__).with_name("fmu_host.c")

# A net of which one corner is fixed to a body that the host moves; a free body on a tether at another corner.
# The body pulls all threads taut within 0.2 s.
PORT = """
format = 1
title = "A net between a port and a free body"
time = { end = 1.0, output_step = 0.01 }
solver = { method = "DOPRI5", tolerance = 1e-9 }
engine = { backend = "compiled" }
initial = { packing = 0.99, velocity = [0.0, 0.0, 1.0] }
effects.material_damping.relaxation_time = 1e-3

[net]
topology = "square"
size = 1.0
mesh = 0.5
cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 1e8 }

[bodies.chaser]
motion = "port"
mass = 100.0
shape = "box"
size = [0.2, 0.2, 0.2]
position = [-0.495, -0.495, -0.2]
velocity = [0.0, 0.0, 1.0]
attachments.corner = { node = 0, point = [0.0, 0.0, 0.2] }

[bodies.the-target]
mass = 5.0
inertia = [0.1, 0.2, 0.25]
centre_of_mass = [0.02, 0.0, 0.01]
position = [0.9, 0.9, 0.3]
velocity = [0.6, 0.6, 1.0]
angular_velocity = [0.1, 0.0, 0.2]

[tethers.line]
diameter = 0.002
density = 1390.0
youngs_modulus = 1e8
length = 0.62
divisions = 3
start = { node = 8 }
end = { body = "the-target", point = [0.0, 0.0, -0.1] }
"""

# A 2 x 2 net that snaps from 0.1 s on, in Exudyn: no kernel is compiled.
THROWN = """
format = 1
title = "A small thrown net"
time = { end = 0.5, output_step = 0.005 }
solver = { method = "DOPRI5", tolerance = 1e-8 }
engine = { backend = "exudyn" }
initial = { packing = 0.5 }
launch = { speed = 5.0, spread_angle = 1.2 }

[net]
topology = "square"
size = 2.0
mesh = 1.0
cable = { diameter = 0.002, density = 1390.0, youngs_modulus = 70e9 }
strings = { diameter = 0.004, density = 1390.0, youngs_modulus = 70e9, length = 1.0 }
bullets = { mass = 0.5 }
"""


def written(folder: Path, name: str, text: str) -> Path:
    """A case file."""
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


@dataclass
class Unpacked:
    """An FMU in a folder of its own."""

    folder: Path

    @classmethod
    def of(cls, fmu: Path, folder: Path) -> Unpacked:
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        return cls(folder)

    @cached_property
    def description(self) -> ElementTree.Element:
        return ElementTree.parse(self.folder / "modelDescription.xml").getroot()

    @property
    def fmi(self) -> int:
        return int(self.description.attrib["fmiVersion"][0])

    @property
    def token(self) -> str:
        return self.description.attrib["guid" if self.fmi == 2 else "instantiationToken"]

    @property
    def binary(self) -> Path:
        (found,) = self.folder.glob("binaries/*/*.so")
        return found

    @cached_property
    def references(self) -> dict[str, int]:
        variables = self.description.find("ModelVariables")
        assert variables is not None
        return {variable.attrib["name"]: int(variable.attrib["valueReference"]) for variable in variables}


def built_host(folder: Path) -> Path:
    """The host, compiled."""
    path = folder / "host"
    subprocess.run(["gcc", "-std=gnu99", "-O1", "-o", str(path), str(SOURCE), "-ldl"], check=True)
    return path


@dataclass
class CHost:
    """A host in C with an FMU, in a process of its own; messages : of the last command."""

    program: Path
    fmu: Unpacked
    token: str = ""
    environment: dict[str, str] = field(default_factory=dict)

    def __enter__(self) -> CHost:
        resources = self.fmu.folder / "resources"
        arguments = [str(self.fmu.fmi), self.fmu.binary, f"{resources}/", self.token or self.fmu.token]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        environment = os.environ | self.environment
        self.process = subprocess.Popen([self.program, *arguments], text=True, env=environment, **pipes)
        return self

    def __exit__(self, *_: object) -> None:
        self.process.stdin.close()  # type: ignore[union-attr]
        self.process.stdout.close()  # type: ignore[union-attr]
        assert self.process.wait() == 0

    def ask(self, *command: object) -> tuple[int, float]:
        """Status and value, NaN without a value; raises AssertionError if the host has ended."""
        stdin, stdout = self.process.stdin, self.process.stdout
        assert stdin is not None
        assert stdout is not None
        stdin.write(" ".join(map(str, command)) + "\n")
        stdin.flush()
        self.messages: list[str] = []
        while (line := stdout.readline()).startswith("# "):
            self.messages.append(line[2:].rstrip("\n"))
        assert line, "the host has ended"
        status, *value = line.split()
        return int(status), float.fromhex(value[0]) if value else float("nan")

    def do(self, *command: object) -> float:
        """The value of a command that must succeed."""
        status, value = self.ask(*command)
        assert status == 0, self.messages
        return value

    def fails(self, *command: object) -> str:
        """The messages of a command that must end in an error."""
        assert self.ask(*command)[0] == 3
        return " ".join(self.messages)

    def start(self, number: int = 0) -> None:
        """An instance, initialised."""
        for command in (("new", number), ("enter", number, 0.0), ("exit", number)):
            self.do(*command)

    def set(self, name: str, value: float, number: int = 0) -> None:
        self.do("set", number, self.fmu.references[name], value.hex())

    def get(self, name: str, number: int = 0) -> float:
        return self.do("get", number, self.fmu.references[name])

    def all_outputs(self, number: int = 0) -> dict[str, float]:
        """Bodies and net."""
        return {n: self.get(n, number) for n in self.fmu.references if n.startswith(("net.", "bodies."))}


def workers_of(process: int) -> list[int]:
    """The processes that a process has started."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) == process and fields[0] != "Z":
                found.append(int(folder.name))
    return found


def resident(process: int) -> int:
    """Memory in use [bytes]."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
