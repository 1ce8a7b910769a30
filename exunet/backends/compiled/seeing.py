"""What steps leave behind in compiled code: extremes, rows of states, and what is watched of each step.

The text of these functions is copied into a kernel's module, before that of `many_steps`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def see(t: float, elastic: float, kinetic: float, x: Any, v: Any, seen: Any) -> None:
    """Take a step's end, whose elastic and kinetic energy [J] are known, into `seen`."""
    peaks = seen.peaks[0]
    if elastic > peaks["elastic"]:
        peaks["elastic"] = elastic
    if kinetic < peaks["kinetic"]:
        peaks["kinetic"] = kinetic
    if elastic > peaks["look_above"]:
        see_tensions(t, x, v, seen)


def see_tensions(t: float, x: Any, v: Any, seen: Any) -> None:
    """Take the largest tension of each group, and the least elastic energy with which there may be a larger.

    N = EA E11 sqrt(1 + 2 E11) <= EA E11 (1 + E11), so an element that pulls by N has at least the energy of
    the strain that makes the latter N. Viscous stress needs no energy: there each taut state is looked at.
    """
    first = seen.first
    second = seen.second
    longest = seen.longest
    peaks = seen.peaks[0]
    found = False
    viscous = False
    for g in range(seen.largest.size):
        largest = seen.largest[g]["tension"]
        element = -1
        for e in range(seen.bounds[g], seen.bounds[g + 1]):
            i = first[e]
            j = second[e]
            dx = x[j] - x[i]
            dy = x[j + 1] - x[i + 1]
            dz = x[j + 2] - x[i + 2]
            square = dx * dx + dy * dy + dz * dz
            if square > longest[e]:
                length = seen.length[e]
                along = 0.0
                if seen.twice_time[e] > 0.0:
                    viscous = True
                    along = dx * (v[j] - v[i]) + dy * (v[j + 1] - v[i + 1]) + dz * (v[j + 2] - v[i + 2])
                else:
                    longest[e] = square
                excess = square - length * length
                pull = (excess + seen.twice_time[e] * along) * math.sqrt(square) / (2.0 * length**3)
                tension = seen.stiffness[e] * pull
                if tension > seen.of_elements[e]:
                    seen.of_elements[e] = tension
                if tension > largest:
                    largest = tension
                    element = e
        if element >= 0:
            found = True
            seen.largest[g]["tension"] = largest
            seen.largest[g]["time"] = t
            seen.largest[g]["element"] = element
    if found and not viscous and peaks["look_above"] >= 0.0:
        least = np.inf
        for g in range(seen.largest.size):
            for e in range(seen.bounds[g], seen.bounds[g + 1]):
                if seen.stiffness[e] > 0.0:
                    tension = seen.largest[g]["tension"]
                    strain = 0.5 * (math.sqrt(1.0 + 4.0 * tension / seen.stiffness[e]) - 1.0)
                    least = min(least, 0.5 * seen.stiffness[e] * seen.length[e] * strain * strain)
        peaks["look_above"] = least


def keep(row: int, t: float, m: Any, kept: Any) -> int:
    """Copy the state into a row of `kept`; returns the next row."""
    kept.time[row] = t
    kept.taken[row] = m.taken[0]
    for c in range(m.x.size):
        kept.x[row, c] = m.x[c]
    for c in range(m.v.size):
        kept.v[row, c] = m.v[c]
    return row + 1


def look(t: float, m: Any, looks: Any) -> bool:
    """Copy what is watched of the state into `looks`; true if the stretch of steps ends there."""
    row = looks.at[0]
    looks.time[row] = t
    for k in range(looks.of_x.size):
        looks.x[looks.of_x[k], row] = m.x[looks.of_x[k]]
    for k in range(looks.of_v.size):
        looks.v[looks.of_v[k], row] = m.v[looks.of_v[k]]
    for k in range(looks.of_memory.size):
        looks.told[row, k] = looks.memory[looks.of_memory[k]]
    if looks.weights.size > 0:
        for axis in range(3):
            place = 0.0
            speed = 0.0
            for k in range(looks.weights.size):
                place += looks.weights[k] * m.x[3 * k + axis]
                speed += looks.weights[k] * m.v[3 * k + axis]
            looks.mean[row, axis] = place
            looks.mean[row, 3 + axis] = speed
    looks.at[0] = row + 1
    return looks.at[0] == looks.at[1]


SEEING = (see_tensions, see, look)
