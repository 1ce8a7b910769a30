"""Figures of `exunet cost` and of the report of `exunet verify`: scales that show what there is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_cost import SURE, entry
from test_cost import study as of_rows
from test_figures import drawn, labelled_lines, lightness

from exunet.methods.method import Backend, Method
from exunet.plots.style import drawing
from exunet.studies.cost.report import figure_of
from exunet.studies.cost.study import Study
from exunet.verification.figures import convergence, curves

TIME = np.linspace(0.0, 1.0, 5)
EXACT = replace(SURE, uncertainty=0.0)
METHODS = (Method.DOPRI5, Method.ODE23, Method.RK44, Method.RK67, Method.VELOCITY_VERLET)


def study(errors: list[float], backends: tuple[Backend, ...]) -> Study:
    """Each method on each backend, with two errors."""
    rows = [
        entry(method, 1e-3 * error, 1.0 + k + 10 * at, error, backend)
        for k, method in enumerate(METHODS)
        for backend in backends
        for at, error in enumerate(errors)
    ]
    return of_rows(rows, EXACT)


def test_the_scale_of_errors_is_that_of_the_settings() -> None:
    with drawing():
        figure = figure_of(study([1e-7, 1e-9], (Backend.EXUDYN,)))
    assert figure is not None
    low, high = drawn(figure).axes[0].get_ylim()
    assert 1e-7 < high < 1e-5
    assert 1e-10 < low < 1e-9


def test_at_most_eight_curves_are_drawn_in_full() -> None:
    with drawing():
        figure = figure_of(study([1e-6, 1e-8], (Backend.EXUDYN, Backend.COMPILED)))
    assert figure is not None
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(words) == 1 + 8 + 1  # the front, and one for all others
    assert "2 others" in words


def test_zeros_do_not_stretch_the_scale_of_differences() -> None:
    with drawing():
        made = drawn(curves("two codes", TIME, {"a": 1e-9 * TIME, "b": 0 * TIME}, {}))
    seen, nothing = labelled_lines(made)
    np.testing.assert_allclose(seen.get_ydata(), [np.nan, *(1e-9 * TIME[1:])])
    assert (nothing.get_ydata() > 0.0).all()  # which a logarithmic scale can show


def test_no_curve_of_a_convergence_is_too_pale() -> None:
    lines = {f"method {k}": (np.array([10.0, 100.0]), np.array([1e-3, 1e-5])) for k in range(8)}
    with drawing():
        made = convergence("orders", lines, {"all": list(lines)})
    assert max(lightness(line.get_color()) for line in labelled_lines(made)) < 90
