"""The explicit topology: nodes and elements that a case or two files list, perhaps with corners.

Its nodes keep their numbers: those of bullets on strings follow them. The file of elements may name threads
that are of other cables.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, StringConstraints

from exunet.base.errors import CaseError, Fault, InputError
from exunet.base.files import path_of
from exunet.base.record import FromArray, NonNegative, Number, Vector, distinct, once, shortened
from exunet.net.arrays import Floats, Ints, Mesh, edge_of
from exunet.net.base import Cable, ThrownNetConfig, no_node, other_length
from exunet.net.weave import planar_openings

Index = Annotated[int, Field(ge=0, lt=2**63)]
Pair = Annotated[tuple[Index, Index], FromArray]
File = Annotated[str, Field(min_length=1)]
ThreadName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$")]
_COLUMNS = {"nodes_file": (("x", "y", "z"), "mass"), "elements_file": (("i", "j"), "thread")}


class Listed(NamedTuple):
    """Nodes and elements of an explicit net.

    nodes    : (n, 3) [m]
    elements : (m, 2)
    masses   : (n,) added to the nodes [kg]; None: nothing
    threads  : (m,) 0: of `net.cable`, k: of the k-th of `net.threads`; None: all of `net.cable`
    lines    : of each element in its file; empty without a file
    """

    nodes: Floats
    elements: Ints
    masses: Floats | None
    threads: Ints | None
    lines: tuple[int, ...]


class ExplicitNet(ThrownNetConfig):
    """Any arrangement of nodes and cable elements, listed here or in files."""

    EXACTLY_ONE: ClassVar = ("nodes", "nodes_file")

    topology: Literal["explicit"] = Field(description="listed nodes and elements")
    nodes: Annotated[tuple[Vector, ...], FromArray] | None = Field(
        None,
        min_length=1,
        description="reference positions of the nodes [m]",
        examples=[[[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]],
    )
    nodes_file: File | None = Field(
        None,
        description="CSV file of the nodes, instead of nodes: a header x, y, z and perhaps mass [m, kg]; "
        "relative to the folder of the case",
        examples=["nodes.csv"],
    )
    elements: Annotated[tuple[Pair, ...], FromArray] | None = Field(
        None,
        description="the two nodes that each element joins, numbered from 0",
        examples=[[[0, 1], [1, 2], [2, 0]]],
    )
    elements_file: File | None = Field(
        None,
        description="CSV file of the elements, instead of elements: a header i, j and perhaps thread, a name "
        "among net.threads or empty",
        examples=["elements.csv"],
    )
    threads: Mapping[ThreadName, Cable] = Field(
        {},
        description="cables of the threads that elements_file names; net.cable is that of the others",
        json_schema_extra={"additionalProperties": False},
    )
    node_masses: Annotated[tuple[NonNegative, ...], FromArray] | None = Field(
        None, description="mass added to each node [kg]", examples=[[0.0, 0.5, 0.0]]
    )
    fixed: Annotated[tuple[int, ...], FromArray] | None = Field(
        None, description="numbers of the nodes that are held still", examples=[[0]]
    )
    corners: Annotated[tuple[Number, ...], FromArray] | None = Field(
        None,
        min_length=3,
        description="nodes at the corners of the mouth, anticlockwise as seen from +z, where strings and "
        "bullets are tied; absent: the net has no mouth",
        examples=[[0, 1, 2]],
    )

    @classmethod
    def from_csv(
        cls, nodes: str | Path | None = None, elements: str | Path | None = None, *more: Any, **keys: Any
    ) -> Self:
        """Make a net of a file of nodes and a file of elements.

        Parameters
        ----------
        nodes, elements : str or Path
            CSV files with the headers ``x, y, z[, mass]`` [m, kg] and ``i, j[, thread]``.
        **keys
            The other keys of the topology, such as ``cable``, ``corners`` and ``bullets``.
        """
        if nodes is None or elements is None or more:
            words = "requires a file of nodes and a file of elements, then keys by name, such as cable=…"
            raise InputError(f"ExplicitNet.from_csv {words}")
        files = (path_of(file, "ExplicitNet.from_csv") for file in (nodes, elements))
        return cls(**keys | dict(zip(("nodes_file", "elements_file"), map(str, files), strict=True)))

    def __eq__(self, other: object) -> bool:
        """Compare the keys, not the cached arrays."""
        if not isinstance(other, ExplicitNet):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)

    @cached_property
    def listed(self) -> Listed:
        """Nodes and elements; raises CaseError if a file cannot be read."""
        masses = None if self.node_masses is None else np.array(self.node_masses, dtype=float)
        threads, lines = None, tuple[int, ...]()
        if self.nodes_file is None:
            nodes = np.array(self.nodes, dtype=float)
        else:
            table = _Table("nodes_file", self.nodes_file)
            nodes = np.stack([table.column(name, _number) for name in "xyz"], axis=1)
            if "mass" in table.header and masses is not None:
                raise CaseError([Fault("node_masses", "excludes the column mass of nodes_file")])
            if "mass" in table.header:
                masses = table.column("mass", _mass)
        if self.elements_file is None:
            elements: Ints = np.array(self.elements or (), dtype=np.int64).reshape(-1, 2)
        else:
            table = _Table("elements_file", self.elements_file)
            lines = tuple(table.lines)
            elements = np.stack([table.column(name, int).astype(np.int64) for name in "ij"], axis=1)
            if "thread" in table.header:
                threads = table.column("thread", self._thread).astype(np.int64)
        return Listed(nodes, elements, masses, threads, lines)

    def _thread(self, name: str) -> int:
        if name and name not in self.threads:
            raise ValueError(f'unknown thread "{name}" (net.threads: {", ".join(self.threads) or "none"})')
        return 1 + list(self.threads).index(name) if name else 0

    @property
    def n_sides(self) -> int:
        return len(self.listed.elements)

    @property
    def n_corners(self) -> int:
        return len(self.corners or ())

    @property
    def has_mouth(self) -> bool:
        return self.corners is not None

    def thread_cables(self) -> tuple[Cable, ...]:
        """The cable of each number of `Listed.threads`."""
        return (self.cable, *self.threads.values())

    def faults(self) -> Iterator[Fault]:
        """Require elements between two places, lists that fit the nodes, masses, and corners on the edge."""
        if (self.elements is None) == (self.elements_file is None):
            yield Fault("elements", "requires exactly one of elements or elements_file")
            return
        if (self.nodes is None) == (self.nodes_file is None):
            return
        yield from (Fault(f"threads.{fault.key}", fault.reason) for fault in distinct(self.threads))
        try:
            nodes = self.listed.nodes
        except CaseError as error:
            yield from error.faults
            return
        count = len(nodes)
        bad = [*shortened(self._elements_without_length())]
        yield from bad
        if self.node_masses is not None and (reason := other_length(self.node_masses, nodes)):
            yield Fault("node_masses", reason)
        yield from shortened(
            Fault(f"fixed[{k}]", no_node(node, count))
            for k, node in enumerate(self.fixed or ())
            if not 0 <= node < count
        )
        if not bad:
            yield from shortened(self._nodes_without_mass())
            yield from self._wrong_corners()
        yield from super().faults()

    def place_of_element(self, element: int) -> tuple[str, str]:
        """Return the key of an element, and the file and line before the reason."""
        lines = self.listed.lines
        if not lines:
            return f"elements[{element}]", ""
        return "elements_file", f"{Path(self.elements_file or '').name}:{lines[element]}: "

    def _elements_without_length(self) -> Iterator[Fault]:
        nodes, elements = self.listed[:2]
        count = len(nodes)
        inside = np.asarray(((elements >= 0) & (elements < count)).all(axis=1))
        ends = nodes[np.where(inside[:, None], elements, 0)]
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        for k in np.flatnonzero(~(inside & (length > 0.0) & np.isfinite(length))).tolist():
            key, where = self.place_of_element(k)
            i, j = elements[k].tolist()
            if not inside[k]:
                yield Fault(key, where + no_node(i if not 0 <= i < count else j, count))
            elif i == j:
                yield Fault(key, f"{where}joins node {i} to itself")
            else:
                words = f"joins nodes {i} and {j}, which are {length[k]:g} m apart: not the length of a cable"
                yield Fault(key, where + words)
        _, firsts, pair = np.unique(
            np.sort(elements, axis=1) @ [count, 1], return_index=True, return_inverse=True
        )
        for k in np.flatnonzero(inside & (firsts[pair] != np.arange(len(elements)))).tolist():
            key, where = self.place_of_element(k)
            first, lines = int(firsts[pair][k]), self.listed.lines
            earlier = f"line {lines[first]}" if lines else f"elements[{first}]"
            i, j = elements[k].tolist()
            yield Fault(key, f"{where}joins {i} and {j} again ({earlier}): remove one")

    def _nodes_without_mass(self) -> Iterator[Fault]:
        nodes, elements, masses = self.listed[:3]
        if masses is not None and len(masses) != len(nodes):
            return  # reported above
        joined = np.zeros(len(nodes), dtype=bool)
        joined[elements] = True
        massless = ~joined if masses is None else ~joined & (masses == 0.0)
        for k in np.flatnonzero(massless).tolist():
            reason = f"node {k} has no mass: join it to an element or give it a mass"
            yield Fault(f"nodes[{k}]" if self.nodes_file is None else "nodes_file", reason)

    def _wrong_corners(self) -> Iterator[Fault]:
        """Require corners for strings and bullets, on the edge of a planar net, anticlockwise."""
        if self.corners is None:
            words = "requires net.corners: the nodes that strings and bullets are tied to"
            for name in ("strings", "bullets"):
                if self.is_given(name):
                    yield Fault(name, words)
            return
        nodes, corners, count = self.listed.nodes, list(self.corners), len(self.listed.nodes)
        found = [Fault(f"corners[{k}]", no_node(n, count)) for k, n in enumerate(corners) if n >= count]
        if found := found or [*once("corners", corners)]:
            yield from found
            return
        for node in corners if self.strings or self.bullets else ():
            if not nodes[node].any():
                yield Fault("corners", f"node {node} lies at the origin: its bullet has no direction")
        edge = edge_of([loop for loops in self.meshes for loop in map(tuple, loops.tolist())])
        if edge and (off := [node for node in corners if node not in edge]):
            words = f"node {off[0]} is not on the edge of the net"
            yield Fault(f"corners[{corners.index(off[0])}]", words)
            return
        x, y = (nodes[corners, :2] - nodes[corners, :2].mean(axis=0)).T
        if edge:
            first = edge.index(corners[0])
            right = sorted(corners, key=lambda node: (edge.index(node) - first) % len(edge))
        else:
            clockwise = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 0.0
            right = [corners[0], *corners[:0:-1]] if clockwise else corners
        if right != corners:
            words = f"must go round the net anticlockwise as seen from +z, got {corners}: give {right}"
            yield Fault("corners", words)

    @cached_property
    def meshes(self) -> tuple[Ints, ...]:
        """Loops of nodes round the meshes of a planar net; empty for others."""
        return planar_openings(self.listed.nodes, self.listed.elements)


def mesh(keys: ExplicitNet) -> Mesh:
    """The nodes and elements as listed; meshes if the net has corners and is planar."""
    nodes, elements, masses, threads, _ = keys.listed
    corners: Ints = np.array(keys.corners or (), dtype=np.int64)
    return Mesh(
        knots=nodes,
        sides=elements,
        anchors=corners[:, None],
        faces=keys.meshes if len(corners) else (),
        mouth=corners,
        node_mass=masses,
        fixed=np.array(keys.fixed or (), dtype=np.int64),
        threads=threads,
        knots_first=True,
    )


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _mass(text: str) -> float:
    value = _number(text)
    if value < 0.0:
        raise ValueError(f"must not be negative, got {text}")
    return value


class _Table:
    """A CSV file with a header; faults name its lines."""

    def __init__(self, key: str, file: str) -> None:
        self._key, self._name = key, Path(file).name
        needed, more = _COLUMNS[key]
        try:
            with Path(file).open(encoding="utf-8-sig", newline="") as stream:
                reader = csv.reader(stream, skipinitialspace=True)
                rows = [(reader.line_num, [part.strip() for part in row]) for row in reader if any(row)]
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            reason = "no such file" if isinstance(error, FileNotFoundError) else f"cannot be read: {error}"
            raise CaseError([Fault(key, f"{file}: {reason}")]) from None
        line, self.header = rows[0] if rows else (1, [])
        if sorted(self.header) not in (sorted(needed), sorted([*needed, more])):
            got = ", ".join(self.header) or "nothing"
            raise self._fault(line, f"the header must be {', '.join(needed)} or with {more} too, got {got}")
        self.lines, self._rows = [number for number, _ in rows[1:]], [row for _, row in rows[1:]]
        for number, row in zip(self.lines, self._rows, strict=True):
            if len(row) != len(self.header):
                words = f"must have {len(self.header)} values ({', '.join(self.header)}), got {len(row)}"
                raise self._fault(number, words)
        if not rows[1:]:
            raise self._fault(line, "no lines follow the header")

    def column(self, name: str, convert: Callable[[str], float]) -> Floats:
        """Return the converted values of a column."""
        column = self.header.index(name)
        return np.array(self._converted(name, [row[column] for row in self._rows], convert), dtype=float)

    def _converted(self, name: str, texts: Sequence[str], convert: Callable[[str], float]) -> list[float]:
        found = []
        for line, text in zip(self.lines, texts, strict=True):
            try:
                found.append(convert(text))
            except ValueError as error:
                kind = "a whole number" if convert is int else "a number"
                own = str(error) if convert not in (int, _number) and "could not" not in str(error) else ""
                raise self._fault(line, f"{name}: {own or f'must be {kind}, got {text!r}'}") from None
        return found

    def _fault(self, line: int, reason: str) -> CaseError:
        return CaseError([Fault(self._key, f"{self._name}:{line}: {reason}")])
