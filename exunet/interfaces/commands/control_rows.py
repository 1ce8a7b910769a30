"""What `exunet check` tells of corner units: law, samples, limits, and whether the gains suit the period."""

from __future__ import annotations

from exunet.case.script import begins_control
from exunet.forces.control_keys import Control
from exunet.forces.corner_units import growth_of_error
from exunet.simulation.preparation import Start


def control_rows(start: Start) -> list[tuple[str, str]]:
    """Rows of the table; none of a case without [control]."""
    keys = start.scene.control
    if keys is None:
        return []
    bullets = ", ".join(map(str, keys.bullets))
    rows = [
        ("control", f"{_law(keys)}; units: bullets {bullets}"),
        ("control: samples", _samples(keys, start, scripted=begins_control(start.scene.script))),
        ("control: limits", _limits(keys)),
    ]
    lightest = float(start.net.mass[start.net.bullet_nodes[list(keys.bullets)]].min())
    growth = growth_of_error(keys, lightest)
    if growth is not None:
        verdict = "unstable: choose a shorter period, or weaker gains" if growth > 1.0 else "stable"
        words = f"of a free unit of {lightest:.4g} kg, by a factor of {growth:.4g} from sample to sample"
        rows.append(("control: an error", f"{words}: {verdict}"))
    return rows


def _law(keys: Control) -> str:
    if keys.kind == "table":
        assert keys.time is not None
        return f"table, {len(keys.time)} times from {keys.time[0]:g} s to {keys.time[-1]:g} s"
    if keys.kind == "given":
        return "given: by a function from Python"
    place = "the units' mean" if keys.body is None else f"body {keys.body}"
    if keys.point is not None:
        place = f"({', '.join(f'{value:g}' for value in keys.point)}) m"
    gains = f"{keys.stiffness:g} N/m, {keys.damping:g} N s/m"
    return f"{keys.kind}, {'to' if keys.kind == 'point' else 'about'} {place}; {gains}"


def _samples(keys: Control, start: Start, *, scripted: bool) -> str:
    begin, end = (
        "from when the script says" if scripted else f"from {keys.start:g} s on",
        start.scene.time.end,
    )
    words = f"every {keys.period:g} s, {begin}"
    if keys.start + keys.period > end:
        words += f": one at most, since the run ends at {end:g} s"
    if keys.noise is None:
        return f"{words}; no noise"
    noise = keys.noise
    return f"{words}; noise of {noise.position:g} m, {noise.velocity:g} m/s, seed {noise.seed}"


def _limits(keys: Control) -> str:
    words = f"at most {keys.largest_thrust:g} N a unit, direction: {keys.direction}"
    if keys.minimum_impulse > 0.0:
        least = keys.minimum_impulse / keys.period
        words += f"; below {keys.minimum_impulse:g} N s in a period ({least:g} N) nothing is fired"
    if keys.specific_impulse is not None:
        words += f"; specific impulse {keys.specific_impulse:g} s, masses stay as they are"
    return words
