"""`exunet effects`: every known effect with its size and advice; with --ablate also what it changes."""

from __future__ import annotations

import math
from collections.abc import Iterator

from exunet.base.errors import Interrupted
from exunet.cli.output import ProgressBar, print_columns, print_line, print_rich
from exunet.forces.effects import EFFECTS
from exunet.model.effect_survey import ASKED, Finding, survey
from exunet.net import weave
from exunet.net.closing import ShortenedEdge, closing_of
from exunet.net.drive import WITHOUT_LIMIT
from exunet.scene.casefile import Case
from exunet.scene.scene import Scene
from exunet.studies.ablation import STARTS, MeasureChange, Toggled, ablate
from exunet.studies.ablation import of_closing as closing_of_scene
from exunet.studies.ensemble import MOVE
from exunet.studies.samples import SURE

SHOWN = 1e-3  # displacement as a part of the net's size, from which on an effect that is off is printed
_NOTHING = 1e-12  # of a change, in its unit: round-off


def show_effects(case: Case, *, asked: float | None, measure: bool, every: bool) -> None:
    """Print the table of estimates, and with `measure` that of the ablation as it grows.

    every : also effects that move the net by less than `SHOWN`, with accelerations and sources
    asked : displacement that matters, as a part of the net's size; None: effects.threshold, or 0.01
    """
    choice = case.scene.effects
    limit = asked if asked is not None else choice.threshold or ASKED
    print_rich(f"{case.scene.title}: {case.scene.time.end:g} s, advice for {limit:g} of the net's size")
    found, others = survey(case.scene), _others(case.scene)
    if others:
        print_rich(of_the_net_alone(others))
    if words := of_closing(case.scene):
        print_rich(words)
    header = ["effect", "", "of size", *["m/s2"] * every, "advice", *["how estimated"] * every]
    print_columns(header, list(_estimates(found, limit, every=every)), narrow=header.index("advice") + 1)
    small = [item.name for item in found if not (every or item.on or item.relative >= SHOWN)]
    if small:
        print_rich(f"{len(small)} below {SHOWN:.1%}: {', '.join(small)} (--all shows them and all sources)")
    if choice.choose == "auto":
        print_rich('effects.choose = "auto": on are the tables whose estimate reaches effects.threshold')
    if measure:
        _ablation(case)


def _others(scene: Scene) -> str:
    """Name the bodies and tethers beside the net; "" without any."""
    groups = (("bodies", scene.bodies), ("tethers", scene.tethers))
    return " and ".join(f"{what} ({', '.join(names)})" for what, names in groups if names)


def of_the_net_alone(others: str) -> str:
    """The note above the estimates of a scene that has more than a net; others: what more."""
    on_no_body = ", ".join(name for name, effect in EFFECTS.items() if effect.ON_THE_NET_ALONE)
    return (
        f"Sizes and advice are of the net alone, without {others} (--ablate measures the whole scene). "
        f"Not modelled on bodies: {on_no_body}."
    )


def of_closing(scene: Scene) -> str:
    """Estimate what closes the mouth of a scene; "" if nothing does.

    A tension N round a loop with the mass m draws it inward at 2 pi N / m; a line that becomes shorter at a
    rate w makes its radius smaller by w / (2 pi).
    """
    keys = scene.closing
    if keys is None:
        return ""
    net = weave(scene.net)
    closing, share = closing_of(net, keys), "closing: on."
    if isinstance(closing, ShortenedEdge):
        length = float(net.reference_length[list(closing.elements)].sum())
        speed = length * closing.rate / (2.0 * math.pi)
        return f"{share} The edge of {length:.3g} m is drawn inward at {speed:.1e} m/s"
    mass = float(net.mass[list(set(closing.path))].sum()) + closing.linear_density * closing.length
    force = max(drive.force for drive in closing.drives)
    rate = max(item.rate for item in closing.drives if item.rate < WITHOUT_LIMIT)
    words = [f"{2.0 * math.pi * force / mass:.1e} m/s2 by {force:.3g} N on {mass:.3g} kg"] if force else []
    words += [f"{rate / (2.0 * math.pi):.1e} m/s by {rate:.3g} m/s of line"] if rate > 0.0 else []
    return f"{share} Its rings are drawn inward: {'; '.join(words) or 'by a script, if at all'}"


def _estimates(found: list[Finding], limit: float, *, every: bool) -> Iterator[tuple[str, ...]]:
    """Yield columns of each effect: on, displacement, advice; every: acceleration and source too."""
    for item in found:
        if not every and not (item.on or item.relative >= SHOWN):
            continue
        moves = f"{item.relative:.2g}" if item.estimate is not None else ""
        assumed = f"{item.assumption}: " if item.assumption else ""
        source = "" if item.estimate is None else assumed + item.estimate.source
        speed = "" if item.estimate is None else f"{item.estimate.acceleration:.1e}"
        begin = (item.name, "on" if item.on else "off", moves, *[speed] * every)
        yield (*begin, item.advice(limit).value, *[source] * every)


def _ablation(case: Case) -> None:
    """Runs of the scene with each effect toggled, some lines for each as it is done."""
    print_rich(
        "\nMeasured with each effect toggled: displacement, as long as it exceeds that of "
        f"{STARTS} runs perturbed by up to {MOVE:.2g} m, and the estimate for the same time; "
        f"changes of the measures, beside the half width of the perturbed runs ({SURE:.0%}); wall time"
    )
    runs = 1 + STARTS + len(_toggled(case.scene))
    started: list[str] = []

    def update(what: str, time: float) -> None:
        if what not in started:
            started.append(what)
        show(len(started) - 1 + time / case.scene.time.end, what)

    try:
        with ProgressBar() as bar:
            show = bar.begin("run", runs)
            for item in ablate(case.scene, progress=update):
                for line in lines_of(item):
                    print_line(line)
    except Interrupted:
        raise Interrupted("interrupted; the lines that are printed are complete") from None


def _toggled(scene: Scene) -> list[Finding]:
    """Findings that are toggled in a run of their own."""
    return [item for item in (*closing_of_scene(scene), *survey(scene)) if item.keys is not None]


def lines_of(one: Toggled) -> list[str]:
    """Lines of text on a toggled effect."""
    name = f"{one.found.name:17s} {'on ' if one.found.on else 'off'}"
    if one.failure:
        return [f"{name} {one.failure}"]
    size, estimated = "not significant beside perturbed runs", one.found.estimate is not None
    if one.ratio is not None:
        size = f"until {one.until:.3g} s: {one.measured:.1e} of the size"
        size += f", estimate {one.estimate:.1e} (x {one.ratio:.2g})" if estimated else ""
    changes = [_change(change) for change in one.measures] or ["no mouth"]
    if one.became:
        counts = ", ".join(f"{number} {name}" for name, number in one.outcomes.items())
        other = "without it" if one.found.on else "with it"
        changes.append(f"the target, of {sum(one.outcomes.values())} runs: {counts}; {other}: {one.became}")
    return [f"{name} {size}", *(f"  {words}" for words in (*changes, f"wall time x {one.wall:.2f}"))]


def _change(change: MeasureChange) -> str:
    one = change.metric
    value, width = (0.0 if abs(each) < _NOTHING else each for each in (change.value, change.half_width))
    apart = "" if change.significant else ": not significant"
    unit = f" {one.unit}" if one.unit else ""
    return f"{one.words} {value:+.2g}{unit}, ± {width:.2g}{unit}{apart}"
