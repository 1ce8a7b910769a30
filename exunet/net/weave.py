"""From a topology's mesh to a net: strings, bullets, divided cables, masses; the same for every topology."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from exunet.base.errors import CaseError, Fault
from exunet.net.arrays import Floats, Ints, Mesh, Net
from exunet.net.base import Bullets, Cable, NetConfig, Strings, ThrownNetConfig
from exunet.net.mesh_checks import refuse_unsound


@dataclass(frozen=True)
class _Cables:
    """Sides or strings of one kind, divided into elements.

    chains : (n_cables, divisions + 1) the nodes along each cable
    length : (n_cables,) reference length of each element [m]
    """

    chains: Ints
    length: Floats
    made_of: Cable
    is_string: bool

    @property
    def element_nodes(self) -> Ints:
        return np.stack([self.chains[:, :-1], self.chains[:, 1:]], axis=-1).reshape(-1, 2)

    @property
    def divisions(self) -> int:
        return self.chains.shape[1] - 1


def net_of(mesh: Mesh, keys: NetConfig) -> Net:
    """The net that `keys` asks for on the topology's `mesh`.

    Raises CaseError if a node's mass or position is beyond what floating-point numbers can hold, and
    ValueError if the topology is at fault (`refuse_unsound`).
    """
    refuse_unsound(mesh, keys.topology)
    strings, bullets = _thrown(keys)
    string_ends, end_position = _string_ends(mesh, strings)
    shift = len(end_position)  # bullets come first
    ends = np.concatenate([end_position, mesh.knots])

    sides = mesh.sides + shift
    span = ends[sides[:, 1]] - ends[sides[:, 0]]
    with np.errstate(over="ignore"):
        side_length = np.linalg.norm(span, axis=1)
    side_chains = _chains(sides, keys.divisions, len(ends))
    cables = _of_sides(side_chains, side_length / keys.divisions, mesh, keys)
    inner = [between(ends, sides, keys.divisions)]
    if strings:
        string_length = np.full(len(string_ends), strings.length / strings.divisions)
        chains = _chains(string_ends, strings.divisions, len(ends) + len(inner[0]))
        cables.append(_Cables(chains, string_length, strings, True))
        inner.append(between(ends, string_ends, strings.divisions))

    position = np.concatenate([ends, *inner])
    bullet_nodes = _bullet_nodes(mesh, strings, bullets)
    mass = _lumped_mass(cables, len(position))
    if bullets:
        mass[bullet_nodes] += bullets.mass
    if mesh.node_mass is not None:
        mass[shift : shift + len(mesh.knots)] += mesh.node_mass
    _refuse_overflow(mass, position)
    return _net(
        cables,
        reference_position=position,
        mass=mass,
        bullet_nodes=bullet_nodes,
        fixed_nodes=np.unique(mesh.fixed) + shift,
        faces=_loops_through(side_chains, [loops + shift for loops in mesh.faces]),
        mouth=tuple((mesh.mouth + shift).tolist()),
        knots=np.arange(shift, shift + len(mesh.knots)),
    )


def _of_sides(chains: Ints, length: Floats, mesh: Mesh, keys: NetConfig) -> list[_Cables]:
    """The cables of the mesh and, if the topology has one, the border."""
    if not mesh.n_border:
        return [_Cables(chains, length, keys.cable, False)]
    inside = len(chains) - mesh.n_border
    border: Cable = getattr(keys, "border")  # noqa: B009 - of the topologies that have one
    return [
        _Cables(chains[:inside], length[:inside], keys.cable, False),
        _Cables(chains[inside:], length[inside:], border, False),
    ]


def between(values: Floats, ends: Ints, divisions: int) -> Floats:
    """Values at the inner nodes of divided cables, evenly spaced between the values at their ends.

    values : (n_nodes, k); ends : (n_cables, 2) -> (n_cables * (divisions - 1), k), cable by cable
    """
    fraction = np.arange(1, divisions)[:, None] / divisions
    first, last = values[ends[:, 0], None], values[ends[:, 1], None]
    return (first * (1 - fraction) + last * fraction).reshape(-1, values.shape[1])


def _thrown(keys: NetConfig) -> tuple[Strings | None, Bullets | None]:
    return (keys.strings, keys.bullets) if isinstance(keys, ThrownNetConfig) else (None, None)


def _string_ends(mesh: Mesh, strings: Strings | None) -> tuple[Ints, Floats]:
    """Node pairs (bullet, corner) of the strings, and the bullets' positions (n_bullets, 3) [m].

    A bullet lies on the ray from the origin through the mean of its corner knots, at the strings' length from
    each: for one knot, length x unit vector beyond it; for a bridle, at the apex of the triangle.
    """
    if strings is None:
        return np.empty((0, 2), dtype=np.int64), np.empty((0, 3))
    n_bullets, n_strings = mesh.anchors.shape
    corners = mesh.knots[mesh.anchors]
    middle = corners.mean(axis=1)
    half_span = np.linalg.norm(corners[:, 0] - middle, axis=1)
    distance = np.linalg.norm(middle, axis=1)
    height = np.sqrt((strings.length - half_span) * (strings.length + half_span))
    position = middle * (1 + height / distance)[:, None]
    bullets = np.repeat(np.arange(n_bullets), n_strings)
    return np.stack([bullets, mesh.anchors.ravel() + n_bullets], axis=1), position


def _bullet_nodes(mesh: Mesh, strings: Strings | None, bullets: Bullets | None) -> Ints:
    if bullets is None:
        return np.empty(0, dtype=np.int64)
    return np.arange(len(mesh.anchors)) if strings else mesh.anchors[:, 0].copy()


def _chains(ends: Ints, divisions: int, first_inner: int) -> Ints:
    """(n_cables, divisions + 1) nodes along each cable; inner nodes are numbered from `first_inner` on."""
    inner = first_inner + np.arange(len(ends) * (divisions - 1)).reshape(len(ends), divisions - 1)
    return np.concatenate([ends[:, :1], inner, ends[:, 1:]], axis=1)


def _lumped_mass(cables: Iterable[_Cables], n_nodes: int) -> Floats:
    """(n_nodes,) half the mass of every element that ends in a node, eq. (9) [kg]."""
    mass = np.zeros(n_nodes)
    for kind in cables:
        half = (
            0.5 * kind.made_of.density * kind.made_of.cross_section * np.repeat(kind.length, kind.divisions)
        )
        for end in kind.element_nodes.T:
            mass += np.bincount(end, weights=half, minlength=n_nodes)
    return mass


def _loops_through(chains: Ints, faces: Iterable[Ints]) -> tuple[tuple[int, ...], ...]:
    """Loops of knots turned into loops of all nodes: the inner nodes of each side follow its first knot."""
    n_nodes = int(chains.max(initial=0)) + 1
    forward = chains[:, 0] * n_nodes + chains[:, -1]
    backward = chains[:, -1] * n_nodes + chains[:, 0]
    names = np.concatenate([forward, backward])
    # Without the last knot of each side, which opens the next one.
    steps = np.concatenate([chains[:, :-1], chains[:, :0:-1]])
    order = np.argsort(names)
    loops: list[tuple[int, ...]] = []
    for face in faces:
        wanted = face * n_nodes + np.roll(face, -1, axis=1)
        side = order[np.searchsorted(names, wanted, sorter=order)]
        loops.extend(map(tuple, steps[side].reshape(len(face), face.shape[1] * steps.shape[1]).tolist()))
    return tuple(loops)


def _refuse_overflow(mass: Floats, position: Floats) -> None:
    bad = ~((mass > 0) & np.isfinite(mass) & np.isfinite(position).all(axis=1))
    if bad.any():
        node = int(np.argmax(bad))
        reason = (
            f"node {node} has a mass of {mass[node]:g} kg at {position[node].tolist()} m; a node needs both"
        )
        reason += " a mass above 0 and a finite position"
        raise CaseError([Fault("net", reason, beyond_floats=True)])


def _net(
    cables: list[_Cables], faces: tuple[tuple[int, ...], ...], mouth: tuple[int, ...], **of_nodes: np.ndarray
) -> Net:
    """Put the elements of all cables one after another, and lock the arrays."""
    counts = [kind.chains.shape[0] * kind.divisions for kind in cables]

    def spread(values: list[float]) -> Floats:
        return np.repeat(np.array(values, dtype=float), counts)

    arrays: dict[str, Any] = of_nodes | {
        "element_nodes": np.concatenate([kind.element_nodes for kind in cables]),
        "reference_length": np.concatenate([np.repeat(kind.length, kind.divisions) for kind in cables]),
        "area": spread([kind.made_of.cross_section for kind in cables]),
        "youngs_modulus": spread([kind.made_of.youngs_modulus for kind in cables]),
        "density": spread([kind.made_of.density for kind in cables]),
        "is_string": np.repeat([kind.is_string for kind in cables], counts),
    }
    if any(kind.made_of.strength for kind in cables):
        arrays["strength"] = spread([kind.made_of.strength or 0.0 for kind in cables])
    for array in arrays.values():
        array.flags.writeable = False
    return Net(**arrays, faces=faces, mouth=mouth)
