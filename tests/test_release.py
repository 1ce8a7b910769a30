"""A script releases what it holds: nodes and ends of tethers that are fixed to bodies, drives that hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import case_in, continue_alike, restarted, stored
from scripts import SCENE, case_of, entry, happened

import exunet
from exunet.base.errors import CaseError
from exunet.bodies.rotations import rotation_matrix
from exunet.cli.check import describe
from exunet.results.measures import momentum_books
from exunet.simulation.run import run_into
from exunet.simulation.simulation import Simulation

TIE = "bodies.left.attachments.hook"
LET_GO = entry("go", at=0.4, do="release", on=TIE)
BACKENDS = {
    "compiled": ("engine.backend=compiled",),
    "exudyn": ("engine.backend=exudyn",),
}
# Without weight; the node of the net is fixed to the body on the left, which turns.
FREE = SCENE.replace("effects.gravity.acceleration = [0.0, 0.0, -9.81]\n", "").replace(
    "initial.node_velocities = [[0.5, 0.0, 0.0]]\n", ""
)
HOOKED = FREE[: FREE.index("[tethers.tow]")] + FREE[FREE.index("[capture]") :]
HOOKED = HOOKED.replace(
    "position = [0.0, 50.0, 0.0]\n",
    "position = [0.0, 50.0, 0.0]\nvelocity = [0.1, -0.2, 0.3]\nangular_velocity = [0.7, 2.0, -0.5]\n"
    "attachments.hook = { point = [0.2, 0.1, -0.3], node = 0 }\n",
)
# A tether of 3.2 m in two elements becomes taut between bodies that fly apart and turn.
TOWED = FREE.replace("[tethers.tow.reel]\ndamping = 100.0\n", "").replace(
    "position = [3.0, 50.0, 0.0]\n",
    "position = [3.0, 50.0, 0.0]\nvelocity = [2.0, 0.3, 0.0]\nangular_velocity = [0.4, 0.5, 1.0]\n",
)
TOWED = TOWED.replace(
    'end = { body = "right" }', 'end = { body = "right", point = [0.0, 0.2, 0.1] }'
).replace("youngs_modulus = 1e9\nlength", "youngs_modulus = 1e8\nlength")
END = entry("go", at=0.4, do="release", on="tethers.tow.end")


@pytest.mark.slow_for("exudyn")
@pytest.mark.parametrize("form", BACKENDS.values(), ids=BACKENDS)
def test_a_node_leaves_a_turning_body_along_its_tangent(form: tuple[str, ...]) -> None:
    """It goes on straight with v + w x r; the body keeps its motion, and all their momenta and energy.

    Until then both move as one: as with an attachment that stays, whose mass is the body's.
    """
    result = exunet.run(case_of(LET_GO, *form, scene=HOOKED))
    at, node, body = 8, result.position[:, 0], result.bodies["left"]
    assert result.time[at] == pytest.approx(0.4)
    assert body.attitude is not None
    assert body.angular_velocity is not None
    turn = rotation_matrix(body.attitude[at])
    lever, spin = turn @ np.array([0.2, 0.1, -0.3]), turn @ body.angular_velocity[at]
    np.testing.assert_allclose(node[at], body.position[at] + lever, atol=1e-12)
    speed = body.velocity[at] + np.cross(spin, lever)
    since = (result.time[at:] - result.time[at])[:, None]
    np.testing.assert_allclose(node[at:], node[at] + since * speed, atol=1e-11)
    np.testing.assert_allclose(body.position[at:], body.position[at] + since * body.velocity[at], atol=1e-11)
    assert np.ptp(result.kinetic) < 1e-10 * result.kinetic[0]  # of RK44 in steps of 1 ms
    for name, book in momentum_books(result).items():
        assert book.gained < 1e-10, name
    stays = exunet.run(case_of("", *form, scene=HOOKED))
    assert stays.bodies["left"].mass == pytest.approx(3.0)  # 2 kg, and the node's 1 kg
    assert body.mass == 2.0
    np.testing.assert_allclose(node[: at + 1], stays.position[: at + 1, 0], atol=1e-10)


@pytest.mark.slow_for("exudyn")
@pytest.mark.parametrize("form", BACKENDS.values(), ids=BACKENDS)
@pytest.mark.parametrize("motion", ["free", "prescribed"])
def test_the_end_of_a_taut_tether_leaves_a_body(form: tuple[str, ...], motion: str) -> None:
    """As without the script until then, to round-off; it pulls on the body no more, and all books close."""
    numbers = [*form, "solver.step=4e-4", "time.end=0.6", f"bodies.right.motion={motion}"]
    result, stays = (exunet.run(case_of(script, *numbers, scene=TOWED)) for script in (END, ""))
    before = slice(0, 9)
    np.testing.assert_allclose(result.position[before], stays.position[before], atol=1e-10)
    of = exunet.loads(result, "right")
    assert of.nodes.tolist() == [2]
    assert of.size[7, 0] > 5.0
    assert not of.size[8:].any()
    np.testing.assert_allclose(of.size[:8], exunet.loads(stays, "right").size[:8], rtol=1e-6, atol=1e-9)
    for name, book in momentum_books(result).items():
        assert book.gained < 1e-9, name
    balance = result.kinetic + result.elastic + result.dissipated
    assert np.ptp(balance) < 2e-4 * result.kinetic.max()  # what snapping costs RK44, as without the script
    velocity = result.bodies["right"].velocity
    assert np.ptp(velocity[8:], axis=0).max() < 1e-12
    (event,) = result.provenance["script"]
    assert (event["tie"], event["node"]) == ("tethers.tow.end", 2)


@pytest.mark.slow
def test_the_forms_agree_on_a_tether_that_is_released() -> None:
    """Compiled loop and engine, after the end has whipped back for 0.6 s."""
    first, *others = (
        exunet.run(case_of(END, *form, "solver.step=2e-4", scene=TOWED)).position
        for form in BACKENDS.values()
    )
    for other in others:
        np.testing.assert_allclose(other, first, atol=1e-7)


@pytest.mark.parametrize("form", BACKENDS.values(), ids=BACKENDS)
@pytest.mark.parametrize("at", [0.2, 0.5])
def test_a_snapshot_before_or_after_a_release_goes_on(
    tmp_path: Path, form: tuple[str, ...], at: float
) -> None:
    case = case_of(END, *form, scene=TOWED)
    one, other = Simulation(case), Simulation(case)
    one.advance_to(at)
    continue_alike(one, other, 0.7, tmp_path)
    assert one.state.memory["tethers.tow.end/held"] == [0.0]
    assert [event["entry"] for event in other.monitor.events] == ["go"]


def test_a_drive_that_is_released_turns_freely() -> None:
    """To the last bit as with a brake that gives way above 0 N, out of a lock; it can be asked again."""
    hold, again = entry("hold", at=0.02, do="lock", on="tow"), entry("again", at=0.5, do="lock", on="tow")
    go = (entry("go", at=0.1, do="release", on="tow"), entry("go", at=0.1, do="brake", on="tow", force=0.0))
    fast = ["bodies.right.velocity=[2.0, 0.0, 0.0]"]
    ours, theirs = (exunet.run(case_of(hold + item + again, *fast)) for item in go)
    assert np.array_equal(ours.position, theirs.position)
    wound = ours.states["tow/wound_up"].values[:, 0]
    assert [name for name, _ in happened(ours)] == ["hold", "go", "again"]
    assert not wound.any()  # all of it is outside: nothing can be paid out
    outside = [*fast, "tethers.tow.reel.paid_out=3.1"]
    wound = exunet.run(case_of(hold + go[0] + again, *outside)).states["tow/wound_up"].values[:, 0]
    assert np.ptp(wound[:3]) == 0.0
    assert wound[10] < wound[2] - 0.005
    assert np.ptp(wound[10:]) == 0.0


def test_what_is_released_is_told_beforehand_and_wrong_names_are_refused() -> None:
    told = dict(describe(case_of(END, scene=TOWED)))
    assert told["script"] == "t = 0.4 s: go: release tethers.tow.end"
    assert told["body right"].endswith("fixed to it until a script releases them: node 2 (tethers.tow.end)")
    wrong = (
        ("tow", SCENE, "tethers.tow.reel.damping="),
        ("tethers.tow.start", SCENE, "title=x"),
        ("tethers.tow", SCENE, "title=x"),
        (TIE, HOOKED, "bodies.left.motion=port"),
        ("tow", HOOKED, "title=x"),
    )
    for what, scene, override in wrong:
        with pytest.raises(CaseError, match=r"script\.toml:\d+: script\[0\]\.(on|do): "):
            case_of(entry("go", at=0.4, do="release", on=what), override, scene=scene)
    with pytest.raises(CaseError, match=r"script\[0\]: "):
        case_of(entry("go", at=0.4, do="release"))
    again = entry("go", when="range < 1", repeat=True, do="release", on=TIE)
    with pytest.raises(CaseError, match=r"script\[0\]\.repeat: "):
        case_of(again, scene=HOOKED)


def test_a_run_goes_on_from_before_and_after_a_release(tmp_path: Path) -> None:
    """What had been released stays so in a case that starts there; what had not is still held."""
    first = stored(tmp_path, case_in(tmp_path, TOWED + END))
    (tmp_path / "other").mkdir()
    run_into(tmp_path / "other", case_in(tmp_path, TOWED))
    soon = END.replace("0.4", "0.1")
    for at, script, ties in (("first@0.3", soon, 1.0), ("other@0.3", soon, 1.0), ("first@0.6", "", 0.0)):
        sim = Simulation(restarted(tmp_path, TOWED + script, at))
        assert sim.state.memory["tethers.tow.end/held"] == [ties]
        sim.advance_to(0.9 - float(at[-3:]))
        assert sim.state.memory["tethers.tow.end/held"] == [0.0]
        row = int(np.argmin(np.abs(first.time - 0.9)))
        np.testing.assert_allclose(sim.state.position, first.position[row], atol=1e-8)


def test_the_end_of_a_tether_leaves_through_the_surface_of_a_body() -> None:
    """It began within the body, and is not touched: contact leaves out what has been fixed to a body."""
    shape = '[bodies.right]\nshape = "sphere"\nradius = 0.4\nmass = 3.0'
    scene = TOWED.replace("[bodies.right]\nmass = 3.0\ninertia = [0.3, 0.4, 0.5]", shape)
    contact = (
        'effects.contact={threads=["right"], law="linear", stiffness=1e4, restitution=0.5, impact_speed=1.0, '
        'friction={law="regularised", coefficient=0.0, slip_speed=0.01}}'
    )
    result = exunet.run(case_of(END, contact, "solver.step=2e-4", scene=scene))
    inside = np.linalg.norm(result.position[:, 2] - result.bodies["right"].position, axis=1) < 0.4
    assert inside[8]
    assert not inside[-1]
    assert not any(np.any(one.values) for name, one in result.states.items() if name.endswith("/touching"))
