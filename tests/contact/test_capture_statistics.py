"""What a small net does to a ball, in both codes and after the horizon: distributions over moved starts."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import exunet
import reference_impl

Floats = NDArray[np.float64]

MASS, PLACE = 0.1, (0.03, 0.02, 0.15)  # of the ball [kg], [m]
MOVED = 1e-3  # m, by which each coordinate of its place is moved at most
SCENE = f"""format = 1
title = "A small net meets a ball"
time = {{ end = 0.4, output_step = 0.1 }}
solver = {{ method = "RK44", step = 1e-4 }}
engine.backend = "compiled"
initial = {{ packing = 0.95, velocity = [0.0, 0.0, 2.0] }}
effects.material_damping.relaxation_time = 5e-4
[net]
topology = "square"
size = 0.6
mesh = 0.2
bullets.mass = 0.01
cable = {{ diameter = 0.002, density = 1000.0, youngs_modulus = 1e7 }}
[bodies.ball]
shape = "sphere"
radius = 0.12
mass = {MASS}
position = [PLACE]
[effects.contact]
threads = ["ball"]
law = "linear"
stiffness = 1e3
restitution = 0.5
impact_speed = 2.0
friction = {{ law = "sticking", coefficient = 0.3 }}
"""


def written(folder: Path, seed: int) -> Path:
    """The case with the ball at a place drawn by a seed."""
    place = np.array(PLACE) + MOVED * np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    path = folder / f"scene_{seed}.toml"
    path.write_text(SCENE.replace("PLACE", ", ".join(map(repr, place.tolist()))))
    return path


def of_exunet(folder: Path, seed: int) -> tuple[Floats, float]:
    """(t,) momentum of the ball along the flight [N s]; what contact has taken at the end [J]."""
    run = exunet.run(exunet.load(written(folder, seed)))
    taken = sum(run.states[f"contact/{item}"].values[-1, 0] for item in ("damping", "friction"))
    return MASS * np.asarray(run.bodies["ball"].velocity)[:, 2], float(taken)


def of_reference(folder: Path, seed: int) -> tuple[Floats, float]:
    """The same by the reference, in some 4 s."""
    scene = reference_impl.load(written(folder, seed))
    run = scene.integrate(method="RK45")
    return MASS * run.bodies.velocity[:, 0, 2], float(run.rubbing[-1].sum())


@pytest.mark.slow
def test_both_codes_agree_on_what_moved_starts_do(tmp_path: Path) -> None:
    """Momentum of the ball and what contact takes, of starts that each code draws for itself."""
    ours = [of_exunet(tmp_path, seed) for seed in range(16)]
    theirs = [of_reference(tmp_path, seed) for seed in range(100, 108)]
    momentum, known = (np.array([one for one, _ in runs]) for runs in (ours, theirs))
    # At the end the codes have parted: the same starts differ by as much as starts that are moved.
    same = np.array([of_exunet(tmp_path, seed)[0] for seed in range(100, 108)])
    spread = momentum.std(axis=0, ddof=1)
    apart = np.abs(same - known).mean(axis=0)
    assert apart[1] < 0.5 * spread[1]
    assert apart[-1] > 0.5 * spread[-1]
    assert spread[-1] < 5e-3 * momentum[:, -1].mean()  # so that a wrong law would be seen
    for mine, other in (
        (momentum[:, -1], known[:, -1]),
        (np.array([taken for _, taken in ours]), np.array([taken for _, taken in theirs])),
    ):
        # The standard error of a median is sqrt(pi / 2) s / sqrt(n).
        error = math.sqrt(0.5 * math.pi * (mine.var(ddof=1) / len(mine) + other.var(ddof=1) / len(other)))
        assert abs(np.median(mine) - np.median(other)) < 3.0 * error
