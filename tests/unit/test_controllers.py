"""Controllers that act at their period and are restored with the simulation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CASES

import exunet
from exunet import InputError, Simulation, Snapshot

PLANAR = CASES / "planar_deployment.toml"
RK44 = ("solver.method=RK44", "solver.step=2e-4")


class Brake:
    """Brakes a bullet, harder each time: its state is the coefficient [N s/m]."""

    def __init__(self, period: float = 0.004) -> None:
        self.period, self.coefficient, self.times = period, 0.1, list[float]()

    def act(self, simulation: Simulation) -> None:
        bullet = int(simulation.net.bullets[0])
        self.coefficient *= 1.5
        self.times.append(simulation.time)
        simulation.set_force(bullet, -self.coefficient * simulation.net.velocity[bullet])

    def state(self) -> dict[str, float]:
        return {"coefficient": self.coefficient}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.coefficient = float(state["coefficient"])


def braked(period: float = 0.004) -> tuple[Simulation, Brake]:
    simulation, brake = Simulation(PLANAR, RK44), Brake(period)
    simulation.attach(brake)
    return simulation, brake


def test_it_acts_at_its_period_however_one_advances() -> None:
    """At 0, 4 and 8 ms, before the step that begins then; bitwise as with forces set by hand."""
    once, brake = braked()
    once.advance_to(0.01)
    assert brake.times == pytest.approx([0.0, 0.004, 0.008], abs=1e-15)
    pieces, other = braked()
    for until in (0.003, 0.004, 0.0075, 0.01):
        pieces.advance_to(until)
    assert other.times == pytest.approx(brake.times, abs=1e-15)
    by_hand, hand = Simulation(PLANAR, RK44), Brake()
    for until in (0.004, 0.008, 0.01):
        hand.act(by_hand)
        by_hand.advance_to(until)
    for name, values in once.state.arrays().items():
        np.testing.assert_array_equal(by_hand.state.arrays()[name], values)


def test_it_is_restored_with_the_simulation(tmp_path: Path) -> None:
    """In memory, from a file into another simulation with its controller, and by reset."""
    simulation, brake = braked()
    simulation.advance_to(0.006)
    here = simulation.snapshot()
    here.save(tmp_path / "here")
    simulation.advance_to(0.015)
    known, coefficient = simulation.state.arrays(), brake.coefficient
    other, its = braked()
    other.restore(Snapshot.load(tmp_path / "here"))
    simulation.restore(here)
    assert brake.coefficient == its.coefficient < coefficient
    for item in (simulation, other):
        item.advance_to(0.015)
        for name, values in known.items():
            np.testing.assert_array_equal(item.state.arrays()[name], values)
    simulation.reset()
    assert (simulation.time, brake.coefficient) == (0.0, 0.1)
    simulation.advance_to(0.015)
    for name, values in known.items():
        np.testing.assert_array_equal(simulation.state.arrays()[name], values)


def test_what_cannot_be_restored_is_refused() -> None:
    class Forgetful:
        period = 0.01

        def act(self, simulation: Simulation) -> None: ...

    simulation, _ = braked()
    here = simulation.snapshot()
    without = Simulation(PLANAR, RK44)
    plain = without.snapshot()
    for target, snapshot in ((without, here), (simulation, plain)):
        with pytest.raises(InputError, match="control"):
            target.restore(snapshot)
    without.attach(Forgetful())  # type: ignore[arg-type]
    without.advance(0.002)
    for what in (without.snapshot, without.reset):
        with pytest.raises(InputError, match="Forgetful"):
            what()
    for wrong in (object(), Brake(0.0), Brake(float("nan")), Brake(1e-300)):
        with pytest.raises(exunet.ExunetError, match="period"):
            without.attach(wrong)  # type: ignore[arg-type]


class Reporting(Brake):
    """Has a state of any kind, and does something within `act`."""

    def __init__(self, reported: Any, does: Any = None) -> None:
        super().__init__()
        self.reported, self.does, self.given = reported, does, None

    def act(self, simulation: Simulation) -> None:
        if self.does is not None:
            self.does(simulation)

    def state(self) -> Any:
        return self.reported

    def restore(self, state: Mapping[str, Any]) -> None:
        self.given = dict(state)


@pytest.mark.parametrize("last", [np.nan, 0.25, np.float32(0.25), 3, True, [np.nan, 2.0]])
def test_states_of_any_numbers_are_restored(tmp_path: Path, last: Any) -> None:
    controller = Reporting({"last": last, "a/b": 1, "": 0})
    simulation = Simulation(PLANAR, RK44)
    simulation.attach(controller)
    simulation.advance_to(0.005)
    here = simulation.snapshot()
    here.save(tmp_path / "here")
    controller.reported = {"last": np.zeros_like(last, dtype=float), "a/b": 1.5, "": 0}  # 0, and then 0.5
    for snapshot in (here, Snapshot.load(tmp_path / "here")):
        simulation.advance(0.002)
        simulation.restore(snapshot)
        np.testing.assert_array_equal(controller.given["last"], last)
        assert (simulation.time, float(controller.given["a/b"])) == (0.005, 1.0)
    simulation.reset()
    np.testing.assert_array_equal(controller.given["last"], last)


@pytest.mark.parametrize(
    "state",
    [{"a": "text"}, {"a": None}, {"a": 1 + 2j}, {"a": [1, 2, [3]]}, {"a": 10**400}, {1: 2.0}, None],
    ids=range(7),
)
def test_a_state_that_no_snapshot_restores_is_refused(state: Any) -> None:
    """When it is attached, or later when a snapshot is taken, with the name of the controller."""
    simulation = Simulation(PLANAR, RK44)
    with pytest.raises(InputError, match="Reporting"):
        simulation.attach(Reporting(state))
    controller = Reporting({"a": [1.0]})
    simulation.attach(controller)
    for changed in (state, {"a": [1.0, 2.0]}):
        controller.reported = changed
        with pytest.raises(InputError, match="Reporting"):
            simulation.snapshot()


@pytest.mark.parametrize("what", ["advance", "advance_to", "snapshot", "restore", "reset", "attach"])
def test_what_a_controller_may_not_do_while_it_acts(what: str) -> None:
    simulation = Simulation(PLANAR, RK44)
    start = simulation.snapshot()
    arguments = {"advance": (0.001,), "advance_to": (0.001,), "restore": (start,), "attach": (Brake(),)}
    controller = Reporting({"a": 1.0}, lambda own: getattr(own, what)(*arguments.get(what, ())))
    simulation.attach(controller)
    with pytest.raises(InputError, match=f"^{what}: "):
        simulation.advance_to(0.005)
    controller.does = None
    simulation.advance_to(0.005)
    simulation.restore(simulation.snapshot())
