"""Errors in starts from other runs, for the list in `plant`; each makes the test fail that is named."""

from __future__ import annotations

from plant import of_text

from exunet.simulation import begun_from
from exunet.system.begun import Begun

GOES_ON = "test_begun:test_a_run_from_the_middle_of_another_one_goes_on"
CUT = "test_begun:test_an_element_that_was_cut_carries_nothing"
RELEASED = "test_release:test_a_run_goes_on_from_before_and_after_a_release"


def _of_text(name, what, owner, function, old, new, test):
    of_text(name, None, what, owner, function, old, new, test)


_of_text(
    "begun_velocities_of_before",
    "a run begins with the velocities of the stored time before",
    begun_from,
    "_state",
    "place, speed = (np.array(part[row : row + 1][0]) for part in (result.position, result.velocity))",
    "place, speed = result.position[row], result.velocity[row - 1]",
    GOES_ON,
)
_of_text(
    "begun_whole_again",
    "what had been cut carries again",
    begun_from,
    "_broken",
    'found |= {int(one["element"]) for one in done(story)',
    'found -= {int(one["element"]) for one in done(story)',
    CUT,
)
_of_text(
    "begun_books_go_on",
    "the work of drives goes on from that of the other run",
    Begun,
    "goes_on",
    'state.name.endswith("/wound_up")',
    'state.name.endswith(("/wound_up", "/work"))',
    GOES_ON,
)
_of_text(
    "begun_without_spin",
    "bodies begin without the angular velocity that they had",
    Begun,
    "of_body",
    "then.attitude, then.angular_velocity",
    "then.attitude, 0.0 * then.angular_velocity",
    RELEASED,
)
_of_text(
    "begun_all_released",
    "what a script of the other run releases counts as released, whether it had been or not",
    begun_from,
    "_releases",
    'not one["tied"] or',
    "True or",
    RELEASED,
)
