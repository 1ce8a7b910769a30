"""Every tolerance of the verification suite and of the hard cases: value, unit and reason.

Two kinds of limits stand with what they limit: those of `exunet compare` and `--check` in
`exunet.results.comparison`, and those of the guards in `exunet.simulation.guards`.
"""

from __future__ import annotations

from dataclasses import dataclass

from exunet.simulation.guards import ENERGY_BOUND


@dataclass(frozen=True)
class Tolerance:
    """Largest error that counts as agreement: value in a unit ("" of a ratio), and its reason."""

    value: float
    reason: str
    unit: str = ""


TOPOLOGY = Tolerance(1e-14, "the same arithmetic in another order: a few last bits of the net's size")
CONNECTIVITY = Tolerance(0.0, "nodes and elements are counted, not measured")
FORCES = Tolerance(
    1e-12,
    "of the largest of a kind: round-off of lengths over strains >= 1e-3; lever arms, attitudes and w x J w "
    "add that of a few products",
)
MEASURES = Tolerance(1e-12, "of the largest value of a kind of states: the round-off of FORCES, summed")
BODY_PLACES = Tolerance(1e-14, "of the largest of a kind: one product with a rotation, and a sum")
CONTACT = Tolerance(1e-9, "of the largest of a kind: quadrature across seams of parts; 3e-12 was seen")
ACTIVE = Tolerance(0.0, "the states are drawn so that contacts penetrate and lines are taut", "states")
CONTACT_RUN = Tolerance(
    1e-7,
    "of the net's size: a hundredth of TRAJECTORY, as kinks of contact cost RK44 its order; 6e-8 was seen",
)
CLOSING = Tolerance(1e-12, "of the largest of a kind: as FORCES, one law of one length")
CLOSED_RUN = Tolerance(
    1e-6, "of the net's size, and of the largest length: a tenth of TRAJECTORY; 1e-9 was seen"
)
CLOSED_WORK = Tolerance(1e-6, "of the largest work: as CLOSED_RUN; 3e-9 was seen")
CLOSED_ENERGY = Tolerance(1e-8, "of the largest kinetic energy: as ENERGY; 4e-10 was seen")
RAN = Tolerance(0.0, "a run that stops leaves nothing to compare")
CONVERGED = Tolerance(1e-6, "of size and v0: what ten times the tolerance changes; a tenth of TRAJECTORY")
LEFT_OUT = Tolerance(
    0.5,
    "of the time to the horizon of one round-off, for positions: where the errors of all steps exceed "
    "CONVERGED there is nothing to compare, and a row says so; if that is so for more of the time, it fails",
)
TRAJECTORY = Tolerance(
    1e-5,
    "of the net's size, of the launch speed and of the time to cross it: ten times each code's own error",
)
DISSIPATED = Tolerance(1e-5, "of the largest kinetic energy: what TRAJECTORY leaves of the speeds' squares")
SNAP = Tolerance(1e-8, "of the known value, which is exact: what the tolerances of the integrators leave")
FREQUENCY = Tolerance(1e-6, "of the known one: (w h)^4 / 120 < 1e-7 of RK4, 1e-8 of the stretch by 1e-6 m")
AREA = Tolerance(1e-14, "of the known area: a few last bits, as round-off of a dozen triangles leaves")
EIGENVALUE = Tolerance(1e-6, "eigenvalues of the same matrix, for the larger nets by Lanczos' method to 1e-6")
FIELD_DIGITS = Tolerance(5e-4, "half a unit in the last digit of the values known for 5, 10 and 25 meshes")
STABLE = Tolerance(100.0, "bounded below the stable step, by about 1/sqrt(1 - 0.99^2) = 7", "x")
UNSTABLE = Tolerance(1e-3, "above it the highest mode grows by a third each step, by 1e7 in 60 steps")
HANGING = Tolerance(1e-8, "of the length: what 14 s of damping leave of the fall, exp(-35), and round-off")
PENDULUM = Tolerance(1e-6, "of the frequency: angle^4 and the pumping of the stretch are left out, 1e-8 each")
TURNED = Tolerance(
    1e-8,
    "of an axis's length and of the largest rate, over ten turns: 1e-12 in each of some 1e3 steps, which a "
    "turn-over multiplies by about 1e2; 2e-11 seen",
)
FLIP = Tolerance(1e-6, "of the time from one turn-over to the next: TURNED over the largest slope of a rate")
FREELY_KEPT = Tolerance(
    1e-9, "of its value: without a torque, what the tolerance of 1e-12 leaves in 1e4 steps"
)
LIBRATION = Tolerance(
    1e-4,
    "of the frequency: the square of an angle of 1e-3, and (n / w)^2 = 1e-5 of a tether that stretches at w",
)
BRAKED = Tolerance(1e-9, "of the largest value: what the tolerance of 1e-11 leaves in some 100 steps")
WHIRLED = Tolerance(1e-9, "of the radius: what the tolerance of 1e-11 leaves in some 1e3 steps, one turn")
REELED = Tolerance(
    5e-4,
    "of the largest value: while it is taut the line gets 0.03 % shorter, and as much stiffer, and the "
    "formulas take its strain of 1e-4 for small",
)
LOCKED = Tolerance(0.0, "the work of a drum that does not turn", "J")
THROWN_BACK = Tolerance(0.0, "they have met the end of the tether, and come closer", "m/s")
MOMENTUM = Tolerance(1e-12, "of the sum of the nodes' shares: linear invariants are kept to round-off")
PRESCRIBED = Tolerance(
    1e-8,
    "of the sum of the nodes' shares: what a prescribed body gives has the accuracy of the integration",
)
ANGULAR = Tolerance(1e-8, "of the sum of the nodes' shares: kept by the accuracy of the integration only")
ENERGY = Tolerance(
    1e-8,
    "of the energy at the start, with bodies of the largest kinetic one: kept by the accuracy of the "
    "integration only",
)
BOOKED = Tolerance(
    1e-7,
    "of the largest kinetic energy: exunet sums viscous work by Simpson's rule, of which a step in which the "
    "stress of a taut thread ends misses 1 part in 300; two such steps of 1e-5 s made 2e-8 of a launch, and "
    "few of the steps of a run are such",
)
BRAKING = Tolerance(1e-4, "of the loss: the formula has a constant distance of the masses; it is to 5e-6")
ORDER = Tolerance(0.5, "half an order: observed orders approach the declared one only for small steps")
ADAPTIVE_ORDER = Tolerance(1.0, "one order: adaptive steps are unequal, few, and the last is cut short")
SAME_STATISTICS = Tolerance(
    5.0,
    "of the largest of ten times: by Student's t with 54 degrees of freedom (48 and 8 runs), 30 comparisons "
    "of equal codes exceed it once in 5200 suites; an offset of 1.9 standard deviations of the runs fails",
    "standard errors",
)

# Of the hard cases (`exunet verify --hard`); E0 is the energy at the start, v0 the launch speed.
HARD_ADAPTIVE = Tolerance(1e-3, "accuracy 1e-5 of v0, with the errors of all snaps; 1.6e-4 was seen", "of E0")
HARD_FIXED = Tolerance(1e-3, "a tenth of the stable step and less; 5e-5 was seen", "of E0")
HARD_LONG = Tolerance(1e-2, "speeds are right to 0.5 %; a fifth of what makes the guards stop a run", "of E0")
HARD_SMOOTH = Tolerance(1e-4, "taut throughout: RK44 has its order; 1.4e-5 in 1e5 steps was seen", "of E0")
HARD_NEAR_LIMIT = Tolerance(
    2.5e-5, "all of E0 but 3.3e-7 is the prestress; the rest may swing by 62.6 (see HARD_GROWTH)", "of E0"
)
HARD_MOMENTUM = Tolerance(1e-12, "internal forces cancel in pairs: round-off, 6e-15 seen", "of sum m|v|")
HARD_ANGULAR = Tolerance(1e-10, "central forces: moments cancel; 6e-14 seen", "of sum m|x||v|")
HARD_ANGULAR_FIXED = Tolerance(1e-8, "RK44 at a hundred steps a period; 7e-10 seen", "of sum m|x||v|")
HARD_TREND = Tolerance(3.0, "mean change in a second over its standard error: less without a trend", "sigma")
HARD_REVOLUTIONS = Tolerance(0.5, "of 100: radius and rate swing by 2e-3 as it stretches", "revolutions")
HARD_TAUT = Tolerance(0.0, "its rotation holds every element taut at every stored time")
HARD_GROWTH = Tolerance(
    63.0,
    "largest energy beside the prestress over that of the start, which is all kinetic, in the fastest mode: "
    "velocity Verlet keeps v^2 + w^2 (1 - (w h / 2)^2) x^2, so it may swing by 1 / (1 - (w h / 2)^2). At the "
    "strain of 1e-3, w^2 is (3 lambda^2 - 1) / 2 + N / EA = 1.004 times that of the just taut net: 62.6 at "
    "0.99 of the limit",
    "x",
)
HARD_DAMPING_SETS = Tolerance(0.5, "the step over the one that the frequencies alone would allow", "x")
HARD_STOPPED = Tolerance(1e-6, "exp(-50) = 2e-22 is left, beside errors of the tolerance", "of v0")
HARD_NO_STATE_LOST = Tolerance(0.0, "one for each step, and the start", "states")
HARD_EXACT_TIMES = Tolerance(0.0, "stored times are the requested ones, to the last bit", "s")
HARD_POSITIONS = Tolerance(1e-3, "RK44 at a tenth of its stable step, 0.08 s after a snap; 2e-4 seen", "m")
HARD_BOUND = Tolerance(ENERGY_BOUND, "the guards' own bound: a run that ends is within it", "of E0")
HARD_BY_GUARD = Tolerance(0.0, "a run that does not end was stopped by a guard, for its energy")
HARD_REFUSED = Tolerance(0.0, "a step above the stable one does not run, unless it is forced")
HARD_CAUGHT = Tolerance(0.0, "forced, it grows by 1.2 a step: the guards stop it")
HARD_REBOUND = Tolerance(2e-5, "the law is exact, RK44 takes 60 steps an impact; 2e-6 was seen", "of v0")
HARD_UNSEEN = Tolerance(
    0.0, "a bullet that moves by the plate's thickness in a step is not detected: the run stops"
)
HARD_EDGE = Tolerance(1e-6, "at rest but for exp(-18) of the start; 2e-9 was seen", "of the force")
HARD_PARTED = Tolerance(0.0, "threads push only, and damping takes: bodies part, slower than they came")
HARD_WOUND = Tolerance(0.9, "the net winds up and takes at least a tenth of the spin", "of the start's")
HARD_AT_ONCE = Tolerance(1.0, "what presses in from the start is seen in the first step", "steps")
HARD_INSIDE = Tolerance(0.0, "threads deeper than contact allows: refused, with file and line")
