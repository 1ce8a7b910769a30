"""Headlines of bodies: how they have moved by the end, and the books of momentum and energy, body by body."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from exunet.bodies.rotations import product, rotation_vector
from exunet.forces.from_outside import OUTSIDE
from exunet.results.course import Course
from exunet.results.headline import Headline, of_vector

Floats = NDArray[np.float64]

NET = "the net"  # with strings, bullets and tethers: all mass that is not a body's
_LEAST = 1e-8  # [m/s], [rad/s], [rad], [N s], [N m s], [J]: what moves of 1e-9 m do themselves
# What an entry of the books is small against: parts of the largest entry, and of what there is of it.
_OF_BOOK, _OF_OWN = 1e-3, 1e-6
_ANGLE = 1e-2  # [rad] that a rotation is small against


def motion_of(name: str, *, free: bool = True, turns: bool = True) -> tuple[Headline, ...]:
    """How far a body has come; of a free one, how it moves at the end, and how it has turned."""
    found = [_displacement(name)]
    if free:
        found += of_vector(
            f"body_{name}_velocity",
            f"velocity of {name}",
            "m/s",
            lambda course: _at_end(course, name, "velocity"),
            remark="at the end, in the scene's axes",
            least=_LEAST,
        )
    if free and turns:
        found += of_vector(
            f"body_{name}_angular_velocity",
            f"angular velocity of {name}",
            "rad/s",
            lambda course: _at_end(course, name, "spin"),
            remark="at the end, in the body's axes",
            least=_LEAST,
        )
        remark = "first attitude to last, the shorter way"
        found.append(
            Headline(
                f"body_{name}_turned",
                f"rotation of {name}",
                "rad",
                lambda course: _turned(course, name),
                size=lambda course: _ANGLE,
                remark=remark,
                least=_LEAST,
            )
        )
    return tuple(found)


def _displacement(name: str) -> Headline:
    """How far the centre of mass is from its start at the end."""

    def value(course: Course) -> float | None:
        if name not in course.body_names:
            return None
        centre = course.body_centre[:, course.body_names.index(name)]
        return float(np.linalg.norm(centre[-1] - centre[0]))

    words = f"displacement of {name}"
    return Headline(f"body_{name}_displacement", words, "m", value, least=1e-8, remark="at the end")


def gained_by(name: str) -> tuple[Headline, ...]:
    """What a free body has got of momentum, angular momentum and kinetic energy since the start."""
    return _gained(f"body_{name}", name)


def gained_by_the_net() -> tuple[Headline, ...]:
    """The same of the net."""
    return _gained("net", NET)


def _gained(key: str, name: str) -> tuple[Headline, ...]:
    return (
        *of_vector(
            f"{key}_momentum_gained",
            f"momentum gained by {name}",
            "kg m/s",
            lambda course: _change(course, name, "momentum"),
            lambda course: _size(course, name, "momentum"),
            remark="in the scene's axes",
            least=_LEAST,
            of_book=True,
        ),
        *of_vector(
            f"{key}_angular_momentum_gained",
            f"angular momentum gained by {name}",
            "kg m2/s",
            lambda course: _change(course, name, "angular_momentum"),
            lambda course: _size(course, name, "angular_momentum"),
            remark="about the scene's origin",
            least=_LEAST,
            of_book=True,
        ),
        Headline(
            f"{key}_kinetic_energy_gained",
            f"kinetic energy gained by {name}",
            "J",
            lambda course: _number(_change(course, name, "kinetic")),
            size=lambda course: _size(course, name, "kinetic"),
            least=_LEAST,
            of_book=True,
        ),
    )


def given_by(name: str) -> tuple[Headline, ...]:
    """What a body whose motion is given has given to all else by the end."""
    return (
        *of_vector(
            f"body_{name}_impulse",
            f"impulse given by {name}",
            "N s",
            lambda course: _at_end(course, name, "impulse"),
            remark="to all else, in the scene's axes",
            least=_LEAST,
            of_book=True,
        ),
        *of_vector(
            f"body_{name}_angular_impulse",
            f"angular impulse given by {name}",
            "N m s",
            lambda course: _at_end(course, name, "angular_impulse"),
            remark="to all else, about the scene's origin",
            least=_LEAST,
            of_book=True,
        ),
        Headline(
            f"body_{name}_work",
            f"work of {name}",
            "J",
            lambda course: _number(_at_end(course, name, "work")),
            remark="on all else",
            least=_LEAST,
            of_book=True,
        ),
    )


def given_from_outside(name: str) -> tuple[Headline, ...]:
    """What an effect from outside has given to net and bodies by the end."""
    return (
        *of_vector(
            f"effect_{name}_impulse",
            f"impulse of {name}",
            "N s",
            lambda course: _at_end(course, _line(name), "impulse"),
            lambda course: _size(course, NET, "momentum"),
            remark="on all, in the scene's axes",
            least=_LEAST,
            of_book=True,
        ),
        *of_vector(
            f"effect_{name}_angular_impulse",
            f"angular impulse of {name}",
            "N m s",
            lambda course: _at_end(course, _line(name), "angular_impulse"),
            lambda course: _size(course, NET, "angular_momentum"),
            remark="on all, about the scene's origin",
            least=_LEAST,
            of_book=True,
        ),
    )


def _line(effect: str) -> str:
    """The name of an effect among those of bodies, of which one may have the same name."""
    return f"{OUTSIDE}{effect}"


def _elastic(course: Course) -> float | None:
    return float(course.elastic[-1] - course.elastic[0])


def _potential(course: Course) -> float | None:
    return float(course.potential[-1] - course.potential[0]) if np.any(course.potential) else None


OF_A_SCENE = (
    *gained_by_the_net(),
    Headline(
        "elastic_energy_gained",
        "elastic energy gained",
        "J",
        _elastic,
        size=lambda course: _OF_BOOK * _largest(course, "kinetic"),
        remark="of all threads",
        least=_LEAST,
        of_book=True,
    ),
    Headline(
        "potential_energy_gained",
        "potential energy gained",
        "J",
        _potential,
        size=lambda course: max(
            _OF_OWN * float(np.abs(course.potential).max(initial=0.0)), _OF_BOOK * _largest(course, "kinetic")
        ),
        remark="of contact, loads, fields, springs, and outlets of reels",
        least=_LEAST,
        of_book=True,
    ),
    Headline(
        "work_of_ejection",
        "work of the ejection",
        "J",
        lambda course: course.ejection,
        remark="on the net and the body that held it",
        of_book=True,
    ),
)


def headlines_of_bodies(course: Course) -> tuple[Headline, ...]:
    """Of the motion of all bodies of a course."""
    found: list[Headline] = []
    for name in course.body_names:
        found += motion_of(name, free=name not in course.guided, turns=name in course.turning)
    return tuple(found)


def books_of_bodies(course: Course) -> tuple[Headline, ...]:
    """The books of momentum and energy of a scene with bodies; none without."""
    if not course.body_names:
        return ()
    found: list[Headline] = []
    for name in course.body_names:
        found += given_by(name) if name in course.guided else gained_by(name)
    for name in course.outside:
        found += given_from_outside(name)
    return (*found, *OF_A_SCENE)


def _of(course: Course, name: str, quantity: str) -> Floats | None:
    """(2, ...) of a body, or the net, at the start and at the end."""
    names = (*course.body_names, *map(_line, course.outside), NET)
    if name not in names or not course.ends.shape[1]:
        return None
    return np.asarray(course.ends[quantity][:, names.index(name)])


def _at_end(course: Course, name: str, quantity: str) -> Floats | None:
    found = _of(course, name, quantity)
    return None if found is None else found[1]


def _change(course: Course, name: str, quantity: str) -> Floats | None:
    found = _of(course, name, quantity)
    return None if found is None else found[1] - found[0]


def _size(course: Course, name: str, quantity: str) -> float:
    """What a change is small against."""
    found = _of(course, name, quantity)
    if found is None:
        return 0.0
    own = max(float(np.linalg.norm(item)) for item in found)
    return max(_OF_OWN * own, _OF_BOOK * _largest(course, quantity))


def _largest(course: Course, quantity: str) -> float:
    """The largest change among bodies that move freely and the net; of energies also those of other kinds."""
    changes = (
        _change(course, name, quantity) for name in (*course.body_names, NET) if name not in course.guided
    )
    found = [float(np.linalg.norm(change)) for change in changes if change is not None]
    if quantity == "kinetic":
        found += [
            abs(item) for item in (_elastic(course), _potential(course), course.ejection) if item is not None
        ]
    return max(found, default=0.0)


def _number(value: Floats | None) -> float | None:
    return None if value is None else float(value)


def _turned(course: Course, name: str) -> float | None:
    found = _of(course, name, "attitude")
    if found is None or not found.any():
        return None
    back = found[0] * [1.0, -1.0, -1.0, -1.0]
    return float(np.linalg.norm(rotation_vector(product(found[1], back))))


Made = Callable[[str], tuple[Headline, ...]]
OF_A_BODY: tuple[Made, ...] = (motion_of, gained_by, given_by)
OF_AN_EFFECT: tuple[Made, ...] = (given_from_outside,)
