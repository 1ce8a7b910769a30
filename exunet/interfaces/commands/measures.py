"""What a run's table says of solver.accuracy_of, once the spread shows where the horizon lies."""

from __future__ import annotations

from exunet.base.errors import ExunetError
from exunet.case.scene import Scene
from exunet.interfaces.commands.estimates import estimated, words_of_time
from exunet.methods.keys import Solver
from exunet.results.spread import Spread
from exunet.simulation.preparation import Start, prepare

ASKED = 1e-3  # of a measure's value: error before the horizon from which on measures need the trajectory
_OF_DEPLOYMENT = ("largest_area", "time_of_largest_area", "distance", "time_above_80_percent")


def for_measures(scene: Scene) -> Start:
    """The scene with accuracy_of = "measures", which leaves all but the retries to it."""
    solver = Solver.model_validate({"accuracy_of": "measures", "retry": scene.solver.retry})
    return prepare(scene.model_copy(update={"solver": solver}))


def rows_on_measures(scene: Scene, spread: Spread | str | None) -> list[tuple[str, str]]:
    """A row where the other accuracy would do: cheaper beyond the horizon, or the trajectory's before it."""
    if not isinstance(spread, Spread):
        return []
    if scene.solver.accuracy_of == "measures":
        return _before_the_horizon(spread)
    has_mouth = any(one.headline.name in _OF_DEPLOYMENT for one in spread.judged.values())
    if spread.predictable or not has_mouth:
        return []
    try:
        start = for_measures(scene)
        cost = estimated(start, spread=0).run
    except ExunetError:  # the advice must not cost the table
        return []
    words = (
        "the end is beyond the horizon of predictability; for the measures of deployment alone "
        f"--set 'solver={{accuracy_of=\"measures\"}}' by {start.plan.method}: "
        f"{words_of_time(cost)}"
    )
    return [("measures", words)]


def _before_the_horizon(spread: Spread) -> list[tuple[str, str]]:
    off = [
        one.headline.words
        for one in spread.judged.values()
        if one.headline.name in _OF_DEPLOYMENT
        and one.value is not None
        and one.error is not None
        and one.error > max(ASKED * abs(one.value), one.headline.least)
        and not (one.headline.at_a_time and one.error <= float(spread.time[1] - spread.time[0]))
    ]
    if not off:
        return []
    words = f"before the horizon of predictability, with errors above {ASKED:g}: {', '.join(off)}; "
    return [("measures", words + 'solver.accuracy_of = "trajectory" is for such an end')]
