"""What of a contact must stop a run, in words."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from exunet.forces.contact.status import status_of
from exunet.forces.cores import Surface

Floats = NDArray[np.float64]
Name = Callable[[int], str]

TOO_DEEP, TOO_FAST, UNSEEN = 1.0, 2.0, 3.0


def trouble(
    values: Floats, surface: Surface, body: str, name: Name, beyond_radius: float | None = None
) -> str:
    """What is wrong by a memory; "": nothing.

    name          : of what the pair of a number is, but for the body
    beyond_radius : how much deeper than by its radius it may be [m]; None: as the surface allows
    """
    status = status_of(values)
    wrong, pair, when = status.wrong, status.wrong_pair, f"at t = {status.wrong_time:.6g} s"
    if wrong == TOO_DEEP and beyond_radius is not None and beyond_radius < surface.allowed:
        return (
            f"{name(int(pair))} is deeper than {2.0 * surface.least:.3g} m in {body}, the body's least "
            f"thickness, {when}: it comes out on the other side. Make contact stiffer, or its radius smaller"
        )
    if wrong == TOO_DEEP:
        return (
            f"{name(int(pair))} is deeper than {surface.allowed:.3g} m in {body} {when}: it may come out on "
            f"the other side of an edge, or of the body. Make contact stiffer, elements shorter (divisions), "
            f"steps smaller, or bodies.{body}.edge_radius larger"
        )
    if wrong == TOO_FAST:
        return (
            f"{name(int(pair))} near {body} moves by more than {surface.least:.3g} m, half of the body's "
            f"least thickness, in the step that ends {when}, and may pass through unseen. Give smaller steps "
            f"(solver.step, or a smaller solver.tolerance)"
        )
    if wrong == UNSEEN:
        return (
            f"{name(int(pair))} came to {body} faster than contact looks for it, {when}. Give smaller steps, "
            f"or look for what accelerates it so much"
        )
    return ""


def trouble_of_bodies(values: Floats, presses: str, touched: str, allowed: float, least: float) -> str:
    """What is wrong by the memory of two bodies; "": nothing.

    allowed : depth beyond which nothing may be [m]; least : half of the least thickness of both [m]
    """
    status = status_of(values)
    when = f"at t = {status.wrong_time:.6g} s"
    if status.wrong == TOO_DEEP:
        return (
            f"{presses} is deeper than {allowed:.3g} m in {touched} {when}: it may come out on the other "
            f"side of an edge, or of the body. Make effects.contact.body_stiffness or modulus larger, steps "
            f"smaller, or edge_radius of bodies.{presses} or bodies.{touched} larger"
        )
    if status.wrong == TOO_FAST:
        return (
            f"{presses} near {touched} may move by more than {least:.3g} m, half of the least thickness of "
            f"both, in the step that ends {when}, and may pass through unseen. Give smaller steps "
            f"(solver.step, or a smaller solver.tolerance)"
        )
    return ""
