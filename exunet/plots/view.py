"""Page of results: a self-contained HTML file with a 3-D view, a time bar and plots.

The page consists of `viewer/page.html`, the program `viewer/viewer.min.js` (built from `viewer/src`, see
`viewer/package.json`) and the data, both compressed by gzip in base64. The data are those of
`exunet.base.files.pack_arrays`; titles and names are text in its header, never HTML.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exunet.base.arguments import takes
from exunet.base.arrays import Floats
from exunet.base.errors import InputError
from exunet.base.files import pack_arrays, path_of, replacing
from exunet.bodies.touched import surface_shown
from exunet.net.arrays import Net
from exunet.plots.nets import evenly_spaced
from exunet.plots.scene_3d import free_nodes
from exunet.plots.time_axes import rows_with_extremes
from exunet.results.capture import capture_of
from exunet.results.clearance import rounded_shapes
from exunet.results.loads import Peak, broken_at
from exunet.results.observables import (
    LINE,
    Observables,
    TimeSeries,
    capture_series,
    further_series,
    time_series,
)
from exunet.results.outcome import Outcome, outcome
from exunet.results.penetration import contact_forces, contact_places
from exunet.results.result import Result
from exunet.results.summary import EventSummary, timeline
from exunet.results.table import GAP, ReportContent

Arrays = dict[str, NDArray[Any]]

KIND, VERSION = "exunet view", 1
FRAMES = 1000  # stored states of a page at most, evenly spaced
STEPS = 65000  # of a coordinate over the largest extent of the scene
_CAPTURED = "captured since"
_MOST_BREAKS = 10  # with a mark each
_MEASURED = 51  # states of which the measures of a capture are computed for a page


@takes(result=Result, other=Result)
def save_view(result: Result, path: str | Path, other: Result | None = None) -> None:
    """Write a page that shows a result in 3-D, or two results beside each other.

    Parameters
    ----------
    result : Result
        The run.
    path : str or Path
        File to write, whose name ends in .html; it opens in a browser without a network.
    other : Result, optional
        A second run, under the same time bar.

    Raises
    ------
    InputError
        For another ending, or a file that cannot be written.
    """
    path = path_of(path, "save_view")
    if path.suffix != ".html":
        raise InputError(f"{path}: the name must end in .html")
    write_page(path, [result] if other is None else [result, other])


def write_page(
    path: Path,
    runs: Sequence[Result | Observables],
    report: ReportContent | None = None,
    frames: int = FRAMES,
) -> None:
    """Write the page of one or two runs, with what a report has beside.

    The measures of a capture take 10 ms a state: of `Observables`, which have them, all are shown, else few.
    """
    with replacing(path) as part:
        part.write_text(page(runs, report, frames), encoding="utf-8")


def page(
    runs: Sequence[Result | Observables], report: ReportContent | None = None, frames: int = FRAMES
) -> str:
    """Return the HTML text of a page."""
    arrays: Arrays = {}
    origin = _corner(runs[0])
    headers = [_run(run, f"{k}/", arrays, origin, frames) for k, run in enumerate(runs)]
    header = {
        "heading": " | ".join(dict.fromkeys(run["title"] for run in headers)),
        "runs": headers,
        "answer": _cells(report.answer if report else ()),
        "table": _cells(report.table if report else ()),
        "case": report.case if report else "",
        "provenance": _cells(report.provenance if report else ()),
    }
    text, program = _template()
    return text.replace("%PROGRAM%", program).replace(
        "%DATA%", _compressed(pack_arrays(KIND, VERSION, header, arrays))
    )


def _cells(rows: Sequence[tuple[str, str]]) -> list[list[str]]:
    """Return each row as its name and its values, which are apart in the text."""
    return [[name, *value.split(GAP)] for name, value in rows]


@lru_cache(maxsize=1)
def _template() -> tuple[str, str]:
    folder = files("exunet.plots") / "viewer"
    program = (folder / "viewer.min.js").read_bytes()
    return (folder / "page.html").read_text(encoding="utf-8"), _compressed(program)


def _compressed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, 5, mtime=0)).decode()


def _corner(run: Result | Observables) -> Floats:
    """Return a point near a run [m]; positions in a page are from that of its first run, for 32 bits."""
    result = run.result if isinstance(run, Observables) else run
    first = [
        np.asarray(result.position[0]),
        *(np.asarray(body.position[:1]) for body in result.bodies.values()),
    ]
    return np.asarray(np.concatenate(first).min(axis=0))


def _run(
    source: Result | Observables, name: str, arrays: Arrays, origin: Floats, most: int
) -> dict[str, Any]:
    """Add the arrays of a run under names with a prefix, positions from an origin; return its header."""
    run = source if isinstance(source, Observables) else Observables(source)
    result, net = run.result, run.result.net
    frames = evenly_spaced(result.time, min(len(result.time), most))
    position = np.asarray(result.position[frames]) - origin
    bodies = {body: np.asarray(states.position[frames]) - origin for body, states in result.bodies.items()}
    extremes = [position.reshape(-1, 3), *bodies.values()]
    low = np.min([part.min(axis=0) for part in extremes if len(part)], axis=0)
    high = np.max([part.max(axis=0) for part in extremes if len(part)], axis=0)
    resolution = float((high - low).max() / STEPS) or 1e-9
    tension = np.clip(np.asarray(result.tension[frames]), 0.0, None)
    largest = float(tension.max(initial=0.0))
    found, time = _series(run, isinstance(source, Observables))
    rows, elements = np.nonzero(~np.isnan(places := contact_places(result, frames)))
    arrays |= {
        f"{name}{key}": values
        for key, values in {
            "time": result.time[frames],
            "elements": net.element_nodes.astype("<u4"),
            "radius": np.sqrt(net.area / np.pi).astype("<f4"),
            "strength": (np.zeros(net.n_elements) if net.strength is None else net.strength).astype("<f4"),
            "bullets": net.bullet_nodes.astype("<u4"),
            "balls": np.concatenate([net.bullet_nodes, free_nodes(result)]).astype("<u4"),
            "positions": _differences(np.rint((position - low) / resolution), 2),
            "tensions": _differences(np.rint(65535 * np.sqrt(tension / (largest or 1.0))), 1),
            "contactStarts": np.searchsorted(rows, np.arange(len(frames) + 1)).astype("<u4"),
            "contactElements": elements.astype("<u4"),
            "contactPlaces": np.rint(255 * places[rows, elements]).astype("u1"),
            "closingPath": np.array(result.run.closing_path, dtype="<u4"),
            "seriesTime": time,
        }.items()
    }
    series = []
    for k, (about, *both) in enumerate(found):
        arrays |= {
            f"{name}series/{k}/{key}": values
            for key, values in zip(("values", "time"), both, strict=True)
            if key == "values" or values is not time
        }
        series.append(about)
    title = result.run.title or "exunet"
    return {
        "title": str(title),
        "verdict": "" if result.complete else f"INCOMPLETE: {result.verdict}",
        "size_words": f"nodes: {net.n_nodes}, elements: {net.n_elements}, stored states: {len(frames)} of "
        f"{len(result.time)}",
        "nodes": net.n_nodes,
        "netNodes": net.n_net_nodes if net.n_net_elements else net.n_nodes,
        "size": _size(net, high - low),
        "up": (up := result.run.up or [0.0, 1.0, 0.0]),
        "direction": _direction(high - low, np.array(up)),
        "corner": low.tolist(),
        "resolution": resolution,
        "tensionMax": largest or 1.0,
        "broken": list(broken_at(result).items()),
        "events": (events := _events(run, result.time[frames], isinstance(source, Observables))),
        "open": _opening(events, result.time[frames], tension),
        "follows": bool(not bodies and _travels(position, net)),
        "series": series,
        "nodeWords": {node: net.node_words(node) for node in _named_nodes(net)},
        "tethers": [[own.start, own.stop] for own in net.tether_elements.values()],
        "reels": [
            {"name": reel, "node": node, "series": k}
            for reel, node in result.run.drums.items()
            for k, item in enumerate(series)
            if item["name"] == f"{reel}/wound_up"
        ],
        "bodies": _bodies(result, frames, bodies, name, arrays, origin),
    }


def _differences(values: Floats, order: int) -> NDArray[np.uint8]:
    """Pack integers from 0 to 65535, (times, ...), as differences over time, which compress well.

    A series for each entry; signs in the last bit; all low bytes before all high bytes. Sums are modulo 2^16.
    """
    rows = np.ascontiguousarray(values.reshape(len(values), -1).astype(np.uint16).T)
    for _ in range(order):
        rows = np.diff(rows, axis=1, prepend=np.uint16(0))
    signed = rows.view(np.int16)
    codes = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    return np.stack([codes & 255, codes >> 8]).astype(np.uint8).ravel()


def _size(net: Net, extent: Floats) -> float:
    """Return the size of the net [m]; without a net that of the scene."""
    return net.size if net.n_net_elements else float(extent.max()) or 1.0


def _direction(extent: Floats, up: Floats) -> list[float]:
    """Return where the view is from: the side, or the front of what stays in the plane of x and y."""
    if extent[2] < 0.01 * extent.max():
        return [0.2, 0.15, 1.0]
    across = np.eye(3)[0 if abs(up[0]) < 0.9 else 2]
    across -= (across @ up) * up
    across /= np.linalg.norm(across)
    return np.asarray(across + 0.55 * up + 0.6 * np.cross(across, up)).tolist()


def _named_nodes(net: Net) -> list[int]:
    """Return the nodes that have a name."""
    ends = [node for tether in net.tethers for node in (tether.nodes[0], tether.nodes[-1])]
    return sorted({*net.bullet_nodes.tolist(), *ends, *net.mouth})


def _travels(position: Floats, net: Net) -> bool:
    """True if the net leaves its place by more than four times its size."""
    middle = position.mean(axis=1)
    return bool(np.linalg.norm(middle - middle[0], axis=1).max() > 4.0 * net.size)


def _bodies(
    result: Result, frames: list[int], places: dict[str, Floats], name: str, arrays: Arrays, origin: Floats
) -> list[dict[str, Any]]:
    shapes, rule = rounded_shapes(result), result.run.capture
    first = "target" if "target" in result.bodies else next(iter(result.bodies), None)
    first = first if rule is None else rule.target
    pressed, found = contact_forces(result, frames), []
    for k, (body, states) in enumerate(result.bodies.items()):
        none = np.zeros((0, 3))
        force, point = pressed.get(body, (none, none))
        mesh = None if body not in shapes else surface_shown(shapes[body])
        arrays |= {
            f"{name}body {k}/{key}": np.asarray(values, dtype=kind)
            for key, values, kind in (
                ("position", places[body], "<f4"),
                ("attitude", states.attitude[frames], "<f4"),
                ("force", force, "<f4"),
                ("point", point - origin, "<f4"),
                ("vertices", none if mesh is None else mesh.vertices, "<f4"),
                ("triangles", none if mesh is None else mesh.triangles, "<u4"),
            )
        }
        role = "target" if body == first else "chaser"
        found.append({"name": body, "role": role})
    return found


def _events(run: Observables, shown: Floats, measured: bool) -> list[tuple[float, str, str]]:
    """Return times [s], words and a remark of what a mark of the time bar shows, in order.

    shown : stored times of the page [s]
    """
    net, line = run.result.net, run.states(LINE)
    found = [(event.time, _words(event), event.cause) for event in timeline(run)]
    broken = sorted((time, element) for element, time in broken_at(run.result).items())
    known = {time for time, *_ in found}
    broken = [item for item in broken if item[0] > run.time[0] and item[0] not in known]
    found += [(time, f"element {element} broke", "") for time, element in broken[:_MOST_BREAKS]]
    if more := broken[_MOST_BREAKS:]:
        found.append((more[0][0], f"first of {len(more)} more breaks", ""))
    if measured and (judged := outcome(run)) is not None and judged.outcome is Outcome.CAPTURED:
        found.append((judged.since or 0.0, _CAPTURED, ""))
    peaks = ((name, run.peak(name)) for name, own in net.groups.items() if len(own))
    found += [_peak(net, name, peak, shown) for name, peak in peaks if peak and peak.element >= 0]
    if f"{LINE}largest" in line and line[f"{LINE}largest"][-1] > 0.0:
        tension, time = (float(line[LINE + name][-1]) for name in ("largest", "largest_time"))
        found.append(
            (time, f"largest tension of the closing line in this run: {tension:.4g} N, of all steps", "")
        )
    return sorted((float(time), words, remark) for time, words, remark in found)


def _opening(events: list[tuple[float, str, str]], shown: Floats, tension: Floats) -> float:
    """Return when a page opens [s]: at the capture, else at the largest tension of the states shown."""
    largest = tension.max(axis=1, initial=0.0)
    otherwise = shown[largest.argmax() if largest.any() else -1]
    return next((when for when, words, _ in events if words == _CAPTURED), float(otherwise))


def _words(event: EventSummary) -> str:
    """Return the name of an event, and what happened where the name does not say so."""
    name = event.name.replace("_", " ") if event.cause else event.name
    if event.action in ("", "note"):
        return name
    return event.action if event.action.split()[0] == name else f"{name}: {event.action}"


def _peak(net: Net, group: str, peak: Peak, shown: Floats) -> tuple[float, str, str]:
    """Return the event of the largest tension of a group, with element, nodes and the nearest shown state."""
    first, last = (net.node_words(node) for node in net.element_nodes[peak.element].tolist())
    near = shown[np.abs(shown - peak.time).argmin()]
    remark = f"in element {peak.element} ({first} to {last}); nearest state shown: {near:.6g} s"
    words = f"largest tension of the {group} in this run: {peak.tension:.4g} N, of {peak.of}"
    return peak.time, words, remark


def _series(run: Observables, measured: bool) -> tuple[list[tuple[dict[str, Any], Floats, Floats]], Floats]:
    """Return what plots show, each with values and times, and the times of most of it.

    All stored times, or of very many those with extremes.
    measured : the measures of a capture are known, or soon will be, at all of them
    """
    result = run.result
    rows = rows_with_extremes(result.time, run.tension)
    time, few = result.time[rows], np.array(evenly_spaced(result.time, min(len(result.time), _MEASURED)))
    found = [(item, rows) for item in chain(time_series(run, capture=measured), further_series(run))]
    if run.criterion is not None and not measured:
        measures = capture_series(capture_of(result, run.criterion, few.tolist()))
        found += [(item, np.arange(len(few))) for item in measures]
    known = {
        "tension": ("largest tension of the elements, stored states", ""),
        **dict.fromkeys((f"{LINE}tension_start", f"{LINE}tension_end"), ("tension of the closing line", "")),
    }
    series = []
    for item, chosen in found:
        group, label = known.get(item.name, (_group(item), ""))
        order = (k for k, end in enumerate(_SHOWN) if item.name.endswith(end))
        about = {
            "name": item.name,
            "words": item.words,
            "label": label or item.words,
            "group": group,
            "unit": item.unit,
            "shown": next(order, _HIDDEN) if np.any(item.values) else _HIDDEN,
            "contact": "" if item.contact is None else item.contact.body,
        }
        own = time if chosen is rows else result.time[few]
        series.append((about, np.asarray(item.values)[chosen].astype("<f4"), own))
    return series, time


_SHOWN = ("tension", "threads_force", "area", "mouth", "kinetic")  # names of series, from the top
_HIDDEN = 99
_GROUPS = {
    **dict.fromkeys(("kinetic", "elastic", "potential", "dissipated"), "energy"),
    **dict.fromkeys(("bullet_speed", "slowest_bullet", "fastest_bullet"), "speed of bullets"),
    **dict.fromkeys(("cqi", "mcqi", "enclosed"), "capture"),
}


def _group(item: TimeSeries) -> str:
    """Return the title of the plot of a series: series of one kind share a plot."""
    if item.name in _GROUPS:
        return _GROUPS[item.name]
    if item.name.startswith("body_"):
        return item.words.rpartition(",")[0]
    if item.name.startswith("distance"):
        return "distance"
    if item.contact is not None:
        body = item.contact.body
        return f"contact force on {body}, stored states" if item.unit else f"number in contact with {body}"
    return item.words
