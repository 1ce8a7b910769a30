"""Free rigid bodies of reference_impl: closed forms of the free top, conservation, results."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from reference_impl import BodyStates, Refused, energy, integrate, read_document
from reference_impl.arrays import skew, turned
from reference_impl.bodies import orthonormal, rotation

TOP = {"mass": 3.0, "inertia": [2.0, 2.0, 3.0], "angular_velocity": [0.5, 0.0, 4.0]}
BOX = {
    "mass": 2.0,
    "inertia": [1.0, 2.0, 2.5],
    "angular_velocity": [0.05, 3.0, 0.02],
    "position": [1.0, 2.0, 3.0],
    "velocity": [0.5, -0.25, 0.125],
    "attitude": [1.0, 2.0, -1.0, 0.5],
}
METHODS = [
    ({}, 1e-8),
    ({"method": "RK45", "rtol": 1e-8, "atol": 1e-10}, 1e-5),
    ({"method": "RK4", "step": 4e-3}, 1e-6),
    ({"method": "Verlet", "step": 2e-3}, 1e-3),
    ({"method": "EM", "step": 4e-3}, 2e-3),
]
NAMES = ["DOP853", "RK45", "RK4", "Verlet", "EM"]


def by_eulers_equations(inertia, spin, times):
    """Angular velocities (t, 3) [rad/s] of a body on which no torque acts: J w' = (J w) x w."""
    return solve_ivp(
        lambda t, w: np.linalg.solve(inertia, np.cross(inertia @ w, w)),
        (times[0], times[-1]),
        spin,
        rtol=1e-12,
        atol=1e-14,
        method="DOP853",
        t_eval=times,
    ).y.T


@pytest.fixture(scope="module")
def beside(explicit, scene):
    """beside(**bodies): the bodies beside a single element at rest."""
    return lambda **bodies: scene({**explicit([[0.0, 0, 0], [1.0, 0, 0]], [[0, 1]]), "bodies": bodies})


@pytest.mark.ci_for("Verlet")
@pytest.mark.slow_for("EM", "RK4", "Verlet")
@pytest.mark.parametrize(("options", "bound"), METHODS, ids=NAMES)
def test_symmetric_top_precesses(beside, options, bound):
    """Goldstein, 5.6: the top turns about h with |h|/J1 and about its own axis with (J1 - J3)/J1 w3."""
    made = beside(top=TOP)
    times = np.linspace(0.0, 2.0, 5)
    run = made.integrate(times, **options)
    h = np.array([1.0, 0.0, 12.0])
    for k, t in enumerate(times.tolist()):
        own = (2.0 - 3.0) / 2.0 * 4.0
        expected = expm(t * skew(h / 2.0)) @ expm(t * skew(np.array([0.0, 0.0, own])))
        assert run.bodies.attitude[k, 0] == pytest.approx(expected, abs=bound)
        spin = [0.5 * math.cos(own * t), -0.5 * math.sin(own * t), 4.0]
        assert run.bodies.angular_velocity[k, 0] == pytest.approx(spin, abs=10.0 * bound)


@pytest.mark.ci_for("Verlet")
@pytest.mark.slow_for("EM", "RK4", "Verlet")
@pytest.mark.parametrize(("options", "bound"), METHODS, ids=NAMES)
def test_asymmetric_top_agrees_with_eulers_equations(beside, options, bound):
    """The unstable axis (Dzhanibekov): J w' = J w x w in the body's axes, integrated by SciPy."""
    made = beside(box=BOX)
    run = made.integrate([0.0, 1.0, 2.5], **options)
    other = by_eulers_equations(np.diag(BOX["inertia"]), BOX["angular_velocity"], [0.0, 1.0, 2.5])
    assert run.bodies.angular_velocity[:, 0] == pytest.approx(other, abs=100.0 * bound)
    assert run.bodies.position[-1, 0] == pytest.approx([2.25, 1.375, 3.3125], abs=1e-12)


@pytest.mark.slow_for("EM", "Verlet")
@pytest.mark.parametrize(("options", "bound"), METHODS, ids=NAMES)
def test_energy_and_angular_momentum_are_kept(beside, unbalanced, options, bound):
    made = beside(box=BOX, top=TOP)
    run = made.integrate(np.linspace(0.0, 2.0, 9), **options)
    books = energy.books(made.system, run)
    assert np.abs(books.angular_momentum - books.angular_momentum[0]).max() < 1e-11
    assert unbalanced(made, run) < (1e-12 if options.get("method") == "EM" else bound)
    spins = 0.5 * (2.0 * 3.0**2 + 1.0 * 0.05**2 + 2.5 * 0.02**2 + 2.0 * 0.25 + 3.0 * 16.0)
    moves = 0.5 * 2.0 * (0.25 + 0.0625 + 0.015625)
    assert books.kinetic[0] == pytest.approx(spins + moves)
    assert books.momentum[0] == pytest.approx([1.0, -0.5, 0.25])
    product = np.einsum("tbij,tbkj->tbik", run.bodies.attitude, run.bodies.attitude)
    assert product == pytest.approx(np.broadcast_to(np.eye(3), product.shape), abs=1e-12)


@pytest.mark.slow
def test_order_2_of_verlet_and_energy_momentum(beside):
    made = beside(box=BOX)
    exact = made.integrate([0.0, 1.0], rtol=1e-12, atol=1e-13).bodies.attitude[-1]
    for method in ("Verlet", "EM"):
        wrong = [
            np.abs(made.integrate([0.0, 1.0], method=method, step=h).bodies.attitude[-1] - exact).max()
            for h in (4e-3, 2e-3, 1e-3)
        ]
        assert np.log2(wrong[0] / wrong[1]) == pytest.approx(2.0, abs=0.1)
        assert np.log2(wrong[1] / wrong[2]) == pytest.approx(2.0, abs=0.1)


def test_large_steps_of_energy_momentum_keep_the_energy(beside, unbalanced):
    made = beside(box=BOX)
    run = made.integrate(np.linspace(0.0, 5.0, 11), method="EM", step=0.1)
    assert unbalanced(made, run) < 1e-12


def test_attitude_of_a_quaternion():
    """A quarter turn about z carries x to y, a third about (1, 1, 1) permutes the axes; length is free."""
    half = math.sqrt(0.5)
    assert rotation((half, 0.0, 0.0, half)) @ [1, 0, 0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    assert rotation((5.0, 5.0, 5.0, 5.0)) == pytest.approx(
        np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]), abs=1e-15
    )
    assert rotation((-2.0, 0.0, 0.0, 0.0)) == pytest.approx(np.eye(3))
    assert rotation((0.0, 1e-300, 0.0, 0.0)) == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-15)
    # by the textbook's polynomial (Goldstein, eq. 4.47'), of a quaternion without symmetry
    w, x, y, z = np.array([1.0, 2.0, -1.0, 0.5]) / math.sqrt(6.25)
    expected = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    assert rotation((1.0, 2.0, -1.0, 0.5)) == pytest.approx(np.array(expected), abs=1e-15)


def test_turns_by_the_exponential():
    rng = np.random.default_rng(3)
    start = orthonormal(rng.standard_normal((2, 3, 3)))
    for size in (0.0, 1e-9, 0.3, 4.0):
        angle = size * rng.standard_normal((2, 3))
        expected = [expm(skew(a)) @ r for a, r in zip(angle, start, strict=True)]
        assert turned(start, angle) == pytest.approx(np.array(expected), abs=1e-12)


SKEWED = {
    **BOX,
    "inertia": [1.5, 2.0, 2.5],
    "products_of_inertia": [0.2, -0.3, 0.25],
    "centre_of_mass": [0.5, -1.0, 2.0],
    "angular_velocity": [3.0, -1.0, 2.0],
}


@pytest.mark.slow
def test_full_inertia_keeps_its_books_over_ten_turns(beside, unbalanced):
    """No axis of the frame is a principal one, the principal moments differ: energy and h to 1e-10."""
    made = beside(box=SKEWED)
    run = made.integrate(np.linspace(0.0, 20.0 * math.pi / 14.0**0.5, 41), rtol=1e-12, atol=1e-13)
    books = energy.books(made.system, run)
    assert unbalanced(made, run) < 1e-10
    h = books.angular_momentum - np.cross(run.bodies.position[:, 0], 2.0 * run.bodies.velocity[:, 0])
    assert np.abs(h - h[0]).max() < 1e-10 * np.linalg.norm(h[0])
    assert np.abs(books.angular_momentum - books.angular_momentum[0]).max() < 1e-10
    # the first rows by hand: h = R J w, and 1/2 w.J w + 1/2 m v^2
    inertia = np.array([[1.5, 0.2, -0.3], [0.2, 2.0, 0.25], [-0.3, 0.25, 2.5]])
    w, turn = np.array([3.0, -1.0, 2.0]), rotation(tuple(BOX["attitude"]))
    assert h[0] == pytest.approx(turn @ inertia @ w, rel=1e-13)
    assert books.kinetic[0] == pytest.approx(0.5 * w @ inertia @ w + 0.328125, rel=1e-14)


@pytest.mark.parametrize("options", [options for options, _ in METHODS], ids=NAMES)
def test_full_inertia_is_principal_axes_turned(beside, options):
    """One body in the frame of its principal axes, and in a frame turned by Q against it.

    J' = Q^T J Q, R' = R Q, w' = Q^T w, c' = Q^T c: both start, and stay, in the same places.
    """
    q = rotation((3.0, -1.0, 2.0, 0.5))
    full = q.T @ np.diag(BOX["inertia"]) @ q
    other = {
        "mass": BOX["mass"],
        "inertia": np.diag(full).tolist(),
        "products_of_inertia": [full[0, 1], full[0, 2], full[1, 2]],
        "centre_of_mass": (q.T @ [0.5, -1.0, 2.0]).tolist(),
        "position": BOX["position"],
        "velocity": BOX["velocity"],
        "attitude": product(BOX["attitude"], [3.0, -1.0, 2.0, 0.5]),
        "angular_velocity": (q.T @ BOX["angular_velocity"]).tolist(),
    }
    made = beside(one={**BOX, "centre_of_mass": [0.5, -1.0, 2.0]}, other=other)
    run = made.integrate(np.linspace(0.0, 1.0, 5), **options)
    one, turned_one = np.moveaxis(run.bodies.attitude, 1, 0)
    assert one @ q == pytest.approx(turned_one, abs=1e-10)  # the same steps: far below the methods' errors
    w, turned_w = np.moveaxis(run.bodies.angular_velocity, 1, 0)
    assert w @ q == pytest.approx(turned_w, abs=1e-10)
    assert run.bodies.position[:, 0] == pytest.approx(run.bodies.position[:, 1], abs=1e-14)


@pytest.mark.parametrize(("options", "bound"), METHODS, ids=NAMES)
def test_full_inertia_agrees_with_eulers_equations(beside, options, bound):
    """J w' = J w x w in the axes of the frame, integrated by SciPy."""
    run = beside(box=SKEWED).integrate([0.0, 0.5, 1.0], **options)
    inertia = np.array([[1.5, 0.2, -0.3], [0.2, 2.0, 0.25], [-0.3, 0.25, 2.5]])
    other = by_eulers_equations(inertia, SKEWED["angular_velocity"], [0.0, 0.5, 1.0])
    assert run.bodies.angular_velocity[:, 0] == pytest.approx(other, abs=100.0 * bound)


def product(a, b):
    """Of two quaternions [w, x, y, z] (Hamilton): b turns first."""
    a0, a1, b0, b1 = a[0], np.array(a[1:]), b[0], np.array(b[1:])
    return [float(a0 * b0 - a1 @ b1), *(a0 * b1 + b0 * a1 + np.cross(a1, b1)).tolist()]


def test_a_frame_turns_about_the_centre_of_mass(beside):
    """A disc's spin about its axis through c: the frame's origin circles c, which flies straight."""
    disc = {
        "mass": 1.0,
        "inertia": [1.0, 1.0, 2.0],
        "centre_of_mass": [0.5, 0.0, 0.0],
        "angular_velocity": [0.0, 0.0, math.pi],
        "velocity": [0.0, 0.0, 1.0],
    }
    made = beside(disc=disc)
    run = made.integrate([0.0, 0.5, 1.0], rtol=1e-11)
    origin = run.bodies.position[:, 0] - run.bodies.attitude[:, 0] @ made.system.bodies.centre_of_mass[0]
    expected = [[0.0, 0.0, 0.0], [0.5, -0.5, 0.5], [1.0, 0.0, 1.0]]
    assert origin == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.ci
@pytest.mark.slow
def test_full_inertia_among_other_bodies(beside):
    """Rows of matrices stay with their bodies: each moves as it does alone."""
    together = beside(top=TOP, skewed=SKEWED, box=BOX).integrate([0.0, 1.0], method="RK4", step=5e-3)
    for k, body in enumerate((TOP, SKEWED, BOX)):
        alone = beside(body=body).integrate([0.0, 1.0], method="RK4", step=5e-3)
        assert together.bodies.attitude[:, k] == pytest.approx(alone.bodies.attitude[:, 0], abs=1e-13)


def test_filled_shapes_fly_as_their_moments_say(beside):
    """A brick by size and one by its textbook moments are the same top."""
    spin = {"angular_velocity": [0.1, 2.0, 0.3]}
    sized = {"shape": "box", "size": [2.0, 3.0, 5.0], "mass": 12.0, **spin}
    made = beside(sized=sized, listed={"mass": 12.0, "inertia": [34.0, 29.0, 13.0], **spin})
    run = made.integrate([0.0, 1.0, 5.0])
    assert run.bodies.attitude[:, 0] == pytest.approx(run.bodies.attitude[:, 1], abs=1e-12)


@pytest.mark.ci
@pytest.mark.slow
def test_books_of_a_full_matrix_with_any_method(beside, unbalanced):
    made = beside(box=SKEWED)
    for options, bound in METHODS:
        run = made.integrate(np.linspace(0.0, 1.0, 5), **options)
        books = energy.books(made.system, run)
        assert unbalanced(made, run) < (1e-12 if options.get("method") == "EM" else bound)
        assert np.abs(books.angular_momentum - books.angular_momentum[0]).max() < 1e-11


@pytest.mark.slow
def test_free_bodies_leave_the_net_alone(document, scene):
    """No effect of the case format acts on them, nor they on the net; only the control of steps sees both."""
    without = scene(document("square", size=2.0), {"initial.packing": 0.9})
    beside = scene(document("square", size=2.0), {"initial.packing": 0.9, "bodies": {"box": BOX}})
    options = {"method": "RK4", "step": 1e-4}
    one, other = (made.integrate([0.0, 0.1], **options) for made in (without, beside))
    assert np.array_equal(one.x, other.x)
    assert beside.system.bodies.names == ("box",)


def test_bodies_without_a_state_are_refused(beside):
    made = beside(box=BOX)
    with pytest.raises(ValueError, match="bodies must be given: the states of box"):
        integrate(made.system, made.x0, made.v0, [0.0, 1.0])
    wrong = BodyStates(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"bodies\.position must be finite and have the shape"):
        made.integrate([0.0, 1.0], bodies0=wrong)


@pytest.mark.parametrize(
    ("name", "change", "fault"),
    [
        ("a b", {}, "bodies.a b: the name must be of letters, digits, _ and -"),
        ("box", {"mass": 0.0}, "bodies.box.mass: must be greater than 0, not 0"),
        ("box", {"inertia": [1.0, 2.0]}, "bodies.box.inertia: must be a list of 3 numbers"),
        ("box", {"inertia": [1.0, 2.0, 3.1]}, "bodies.box.inertia: no moment may be above the sum"),
        ("box", {"inertia": [1.0, 0.0, 1.0]}, "bodies.box.inertia: must be greater than 0, not 0"),
        ("box", {"attitude": [0.0] * 4}, "bodies.box.attitude: must not be zero"),
        ("box", {"spin": 1.0}, "reference_impl does not know bodies.box.spin"),
        ("box", {"velocity": [1.0, "fast", 0.0]}, "bodies.box.velocity: must be a number"),
    ],
)
def test_refuses_bodies_by_name(document, name, change, fault):
    with pytest.raises(Refused) as refused:
        read_document({**document(), "bodies": {name: {**BOX, **change}}})
    assert len(refused.value.faults) == 1
    assert refused.value.faults[0].startswith(fault)


def test_flat_bodies_are_bodies(document):
    """A plate's greatest moment is the sum of the others: 0.1 + 0.2 and 0.3 differ by a rounding."""
    for inertia in ([0.1, 0.2, 0.3], [0.1, 0.2, 0.1 + 0.2], [0.7, 0.1, 0.6]):
        read_document({**document(), "bodies": {"plate": {"mass": 1.0, "inertia": inertia}}})


def test_bodies_must_be_tables(document):
    for bodies, fault in (({"box": 3}, "bodies.box: must be a table"), (3, "bodies: must be a table")):
        with pytest.raises(Refused) as refused:
            read_document({**document(), "bodies": bodies})
        assert refused.value.faults == (fault,)
