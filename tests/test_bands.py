"""Bands of moved starts of contacts, closing, corner units, spins, momenta and pulls: kept and drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from result_samples import square_net, unfolding
from test_figures import body, labels
from test_spread import course

import exunet
from exunet.base.errors import InputError
from exunet.plots.registry import figure
from exunet.results.course import Course
from exunet.results.curves import CURVES, curve, curves_for
from exunet.results.ends import END
from exunet.results.ensemble_result import LEVELS, EnsembleResult, ensemble_result
from exunet.results.pulls import PulledPlace
from exunet.results.result import Result, TermStates

TIMES = 5  # of the courses, 0.5 s apart until 2 s
CONTACTS = ("contact_box/threads", "contact_box/bullets")
LINE = ("tension_start", "tension_end", "way", "wound_up")


def moved(size: float) -> Course:
    """A run in which all is in proportion to its size; what a unit spends, to the square of the time.

    A box gets momentum from the net, 5 t size along (0, 0.6, 0.8), and angular momentum, -2 t size along x.
    """
    of = course()
    rising = size * of.time
    gained = np.multiply.outer(rising, [0.0, 3.0, 4.0, -2.0, 0.0, 0.0])
    ends = np.zeros((2, 2), dtype=END)
    ends["momentum"][0] = ends["angular_momentum"][0] = [[7.0], [0.0]]  # of the box and of the net
    return replace(
        of,
        contact={f"{name}_{what}": rising for name in CONTACTS for what in ("touching", "force", "stored")},
        line={f"closing/{name}": 2.0 * rising for name in LINE[:3]},
        reel_names=("tow", "closing"),
        reel=np.stack([np.zeros((TIMES, 2)), np.outer(3.0 * rising, [1.0, 0.0])], axis=1),
        edge=1.0 - 0.1 * rising[:, None],
        mouth=4.0 * rising[:, None],
        units=np.stack([size * of.time**2, 5.0 * rising, rising], axis=1),
        body_names=("box",),
        body_centre=np.zeros((TIMES, 1, 3)),
        ends=ends,
        momentum=np.stack([7.0 + gained, -gained], axis=1),
        pulled=(PulledPlace("box", 0),),
        pull=np.multiply.outer(rising, [[3.0, 2.0]]),
        turning=("box",),
        spin=np.multiply.outer(rising, [[1.0, -1.0, 0.0]]),
    )


def moved_starts(*sizes: float) -> EnsembleResult:
    return ensemble_result([moved(size) for size in sizes], complete=True, verdict="ok", provenance={})


def test_quantiles_by_hand() -> None:
    """Of sizes 1, 2 and 6 the least, the middle and the largest, as each quantity goes with the size."""
    found, time = moved_starts(1.0, 2.0, 6.0), course().time
    rates = np.array([0.5, 0.5, 1.5, 2.5, 3.5])  # since the instant before; at first of the first interval
    expected: dict[str, Any] = {
        "contact_box/threads_touching": time,
        "contact_box/bullets_force": time,
        "closing/tension_end": 2.0 * time,
        "closing/way": 2.0 * time,
        "closing/wound_up": 3.0 * time,
        "mouth": 4.0 * time,
        "control/thrust_0": rates,
        "control/thrust_1": np.full(TIMES, 5.0),
        "body_box/angular_velocity_x": time,
        "attachment_box_0/force": 3.0 * time,
        "attachment_box_0/torque": 2.0 * time,
        "momentum/box": 5.0 * time,
        "angular_momentum/net": 2.0 * time,
    }
    for name, values in expected.items():
        of_sizes = np.multiply.outer([1.0, 2.0, 6.0], values)
        np.testing.assert_allclose(found.quantiles[name][[0, 3, 6]], of_sizes, rtol=1e-14, err_msg=name)
    assert found.provenance["momenta_along"]["angular"] == [1.0, 0.0, 0.0]
    falling = found.quantiles["body_box/angular_velocity_y"]
    np.testing.assert_allclose(falling[[0, 6]], np.multiply.outer([-6.0, -1.0], time), rtol=1e-14)
    part = found.quantiles["closing/part"]
    np.testing.assert_allclose(part[[0, 6]], 1.0 - 0.1 * np.multiply.outer([6.0, 1.0], time), rtol=1e-14)
    assert not any("stored" in name or "thrust_2" in name for name in found.quantiles)


def test_only_what_a_scene_has() -> None:
    names = {item.name for item in curves_for(course())}
    assert names < {entry.name for entry in CURVES}
    at_once = replace(
        moved(1.0), time=np.zeros(1), units=np.zeros((1, 3))
    )  # its script ended it at its start
    assert curve("control/thrust_1").value(at_once) == np.zeros(1)
    for name in ("", "control/thrust_x", "control/thrust", "contact_box/threads_stored", "body_box/speed"):
        with pytest.raises(KeyError):
            curve(name)


def test_a_file_keeps_them_with_units(tmp_path: Path) -> None:
    """In groups as a result has them; a name of no quantity is refused, and nothing is written."""
    found = moved_starts(1.0, 2.0)
    exunet.save_ensemble(found, tmp_path / "spread.h5")
    read = exunet.load_ensemble(tmp_path / "spread.h5")
    assert set(read.quantiles) == set(found.quantiles)
    for name, values in found.quantiles.items():
        assert np.array_equal(read.quantiles[name], values), name
    units = {"contact_box/threads_force": "N", "contact_box/threads_touching": "1", "closing/way": "m"}
    units |= {"attachment_box_0/force": "N", "attachment_box_0/torque": "N m"}
    units |= {"control/thrust_0": "N", "body_box/angular_velocity_z": "rad/s", "closing/part": "1"}
    with h5py.File(tmp_path / "spread.h5") as file:
        for name, unit in units.items():
            assert file[f"quantiles/{name}"].attrs["units"].decode() == unit, name
    strange = replace(found, quantiles={"speed of light": np.zeros((len(LEVELS), TIMES))})
    with pytest.raises(InputError, match="'speed of light' is none of which an ensemble has quantiles"):
        exunet.save_ensemble(strange, tmp_path / "other.h5")
    assert not (tmp_path / "other.h5").exists()


def shown(contacts: tuple[str, ...] = CONTACTS, bodies: int = 1, units: int = 2) -> Result:
    """A net that unfolds within 1 s beside bodies that turn, with a closing line and corner units."""
    rising = np.linspace(0.0, 1.0, 7)[:, None]
    names = ["box", *(f"body_{k}" for k in range(1, bodies))]
    spins = np.tile([0.1, 0.2, 0.3], (7, 1))
    turning = {item: replace(body((0, 0, 3), (0, 0, 0)), angular_velocity=spins) for item in names}
    turning["box"] = replace(turning["box"], nodes=np.array([0]), velocity=1e-3 * rising * [1.0, 0.0, 0.0])
    states = {f"{contact}_{what}": rising for contact in contacts for what in ("touching", "force")}
    states |= {f"closing/{entry}": rising for entry in LINE}
    states |= {"control/spent": rising * np.ones(units), "control/work": rising}
    stored = {name: TermStates("1", values) for name, values in states.items()}
    story = {"control": {"bullets": list(range(units))}}
    taut = np.full((7, 4), 1e-3)
    return unfolding(square_net(), bodies=turning, states=stored, provenance=story, tension=taut)


def bands_of(made: Figure) -> list[list[PolyCollection]]:
    """Of each pair of axes those that are drawn, not only told in the legend."""
    every = [
        [collection for collection in axes.collections if isinstance(collection, PolyCollection)]
        for axes in made.axes
    ]
    return [[item for item in own if item.get_paths()] for own in every]


def ends_at(band: PolyCollection, time: float) -> tuple[float, float]:
    """Least and largest of a band at one of its times."""
    at = [y for path in band.get_paths() for x, y in path.vertices if abs(x - time) < 1e-12]
    return min(at), max(at)


# Of each pair of axes: the quantities, and what is seen of them at their last time.
DRAWN: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "contacts": (
        ("contact_box/threads_touching", "contact_box/bullets_touching"),
        ("contact_box/threads_force", "contact_box/bullets_force"),
    ),
    "closing": (("closing/tension_start",), ("closing/way", "closing/wound_up"), ("mouth",)),
    "loads": (("attachment_box_0/force",), ("attachment_box_0/torque",)),
    "rotation": (tuple(f"body_box/angular_velocity_{axis}" for axis in "xyz"),),
    "control": (("control/thrust_0", "control/thrust_1"),),
    "momentum": (
        ("momentum/box", "momentum/net"),
        ("angular_momentum/box", "angular_momentum/net"),
    ),
}


@pytest.mark.parametrize("name", DRAWN)
def test_bands_reach_from_the_least_to_the_largest(name: str) -> None:
    """Each in its axes, in the colour of its curve and within the limits; means stand between instants."""
    spread = moved_starts(1.0, 2.0, 6.0)
    made = figure(shown(), name, ensemble=spread)
    last = 1.75 if name == "control" else 2.0  # the middle of the last interval
    assert len(made.axes) == len(DRAWN[name])
    for axes, quantities, own in zip(made.axes, DRAWN[name], bands_of(made), strict=True):
        assert len(own) == len(quantities)
        for quantity, band, line in zip(quantities, own, axes.get_lines(), strict=False):
            low, high = spread.band(quantity)
            assert ends_at(band, last) == pytest.approx((low[-1], high[-1])), quantity
            assert to_rgb(band.get_facecolor()[0]) == to_rgb(line.get_color()), quantity
            assert axes.get_ylim()[0] <= low.min()
            assert axes.get_ylim()[1] >= high.max()
    assert labels(made).count("range of 3 perturbed runs") == 1
    assert bands_of(figure(shown(), name)) == [[]] * len(made.axes)


def other_spins(number: int, size: float) -> dict[str, np.ndarray]:
    """Quantiles of the angular velocities of further bodies, from -size to size all the time."""
    ends = np.tile(np.linspace(-size, size, len(LEVELS))[:, None], TIMES)
    return {f"body_body_{k}/angular_velocity_{axis}": ends for k in range(1, number + 1) for axis in "xyz"}


def test_many_curves_have_one_band() -> None:
    """Of five units, and of nine angular velocities, from the smallest to the largest of all."""
    spread = moved_starts(1.0, 6.0)
    units = {
        f"control/thrust_{k}": np.outer(np.linspace(9, 40, len(LEVELS)), np.ones(5)) for k in range(2, 5)
    }
    more = replace(spread, quantiles=spread.quantiles | units | other_spins(2, 20.0))
    of = shown(bodies=3, units=5)
    for name, ends in (("rotation", (-20.0, 20.0)), ("control", (3.5, 40.0))):
        (band,) = bands_of(figure(of, name, ensemble=more))[0]
        assert ends_at(band, 1.75 if name == "control" else 2.0) == pytest.approx(ends), name
    one = {name: values[:, :1] for name, values in spread.quantiles.items()}
    at_once = replace(spread, time=np.zeros(1), quantiles=one)
    assert not any(bands_of(figure(shown(), "control", ensemble=at_once)))


def test_momenta_are_along_the_direction_of_their_bands() -> None:
    """That of the run that is shown: of its own largest change, where the spread knows the run."""
    whole, first = moved_starts(1.0, 6.0), moved(1.0)
    own = replace(first, momentum=first.momentum[..., [1, 2, 0, 3, 4, 5]])  # along (0.6, 0.8, 0)
    known = ensemble_result([first], complete=True, verdict="ok", provenance={}, shown=own)
    for spread, along in ((whole, "(0, 0.6, 0.8)"), (known, "(0.6, 0.8, 0)")):
        assert f"momentum along {along}" in labels(figure(shown(), "momentum", ensemble=spread))
    parts = known.quantiles["momentum/box"][0]
    np.testing.assert_allclose(parts, 3.0 * 0.8 * first.time, rtol=1e-14)  # (0, 3, 4) on (0.6, 0.8, 0)
    assert curve("momentum/box").value(first) is None  # without a direction
    assert [item.name for item in curves_for(first) if "momentum" in item.name] == []
