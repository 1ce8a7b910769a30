"""Errors in scripts of missions, for the list in `plant`; each makes the test fail that is named."""

from __future__ import annotations

from own_terms import FORMS
from plant import of_text

from exunet.backends import events
from exunet.case import script
from exunet.system import bodies, script_events, set_parameters
from exunet.system.script_events import ScriptEvents

LOCATED = "a_crossing_is_located_whatever_the_steps"
ORDER = "what_is_due_at_one_time_comes_in_the_order_of_the_script"


COMPILED = FORMS["compiled"]
RELEASED = ("engine.loop=compiled",)


def _of_text(name, what, owner, function, old, new, test, arguments=(), users=(), module="test_script"):
    case = f"{module}:test_{test}"
    of_text(name, None, what, owner, function, old, new, case, users=users, arguments=arguments)


_of_text(
    "script_a_step_late",
    "a script acts at the end of the step in which its condition came true",
    ScriptEvents,
    "crossing",
    "return root - 0.5 * within if",
    "return last if",
    LOCATED,
    ((), 0.05),
)
_of_text(
    "script_seen_late",
    "a condition is looked at in the last of many states only",
    ScriptEvents,
    "comes_true",
    "if found.any():",
    "if found[-1]:",
    "a_state_between_two_looks_is_seen",
)
_of_text(
    "script_not_heard",
    "what a script commands does not come to the drive",
    events,
    "_memories",
    "**change.others, ",
    "",
    "a_script_commands_a_reel_as_a_case_does",
    ("compiled",),
)
_of_text(
    "script_delay_lost",
    "a delay after another entry does not count",
    ScriptEvents,
    "_moment",
    "other.since + entry.delay",
    "other.since",
    ORDER,
)
_of_text(
    "script_above_for_below",
    "below and above swapped",
    ScriptEvents,
    "_beyond",
    "beyond = condition.sign *",
    "beyond = -condition.sign *",
    LOCATED,
    ((), 0.05),
)
_of_text(
    "script_never_barred",
    "an entry happens although the one has come that forbids it",
    ScriptEvents,
    "_is_barred",
    "entry.unless is not None and",
    "False and",
    "an_entry_that_another_one_forbids",
)
_of_text(
    "script_winds_the_wrong_way",
    "what is to pay out winds up",
    script,
    "drive_of",
    "-entry.rate",
    "entry.rate",
    "a_script_commands_a_reel_as_a_case_does",
    ("compiled",),
    (script_events,),
)
_of_text(
    "release_moves_the_body",
    "a body that lets a node go later moves with the velocity of the centre of both",
    bodies,
    "_parted",
    "velocity + turn @ np.cross(spin, lever)",
    "velocity",
    "a_node_leaves_a_turning_body_along_its_tangent",
    (RELEASED,),
    module="test_release",
)
_of_text(
    "release_forgotten",
    "what a script releases stays fixed",
    ScriptEvents,
    "_release",
    "np.zeros(1)",
    "np.ones(1)",
    "a_node_leaves_a_turning_body_along_its_tangent",
    (RELEASED,),
    module="test_release",
)
_of_text(
    "set_softer_than_asked",
    "a tether becomes softer than the script says",
    set_parameters,
    "changed",
    "np.where(after[elements] > 0.0, part, 0.0)",
    "np.where(after[elements] > 0.0, 0.9 * part, 0.0)",
    "a_tether_becomes_softer_while_it_is_stretched",
    (COMPILED,),
    (script_events,),
    module="test_set",
)
_of_text(
    "set_slip_gives_energy",
    "a line that slides as its friction falls gives energy instead of losing it",
    set_parameters,
    "_slid",
    "x[first + 2] += taken",
    "x[first + 2] -= taken",
    "friction_of_a_closing_line_changes",
    (COMPILED,),
    module="test_set",
)
_of_text(
    "set_friction_twice",
    "a coefficient of friction that is set counts twice",
    set_parameters,
    "changed",
    "np.array([value])",
    "np.array([2.0 * value])",
    "friction_of_contact_changes",
    (COMPILED,),
    (script_events,),
    module="test_set",
)
_of_text(
    "set_rate_turns_round",
    "a rate that is set turns a drive round",
    set_parameters,
    "_asked",
    "np.copysign(value, asked[1])",
    "-np.copysign(value, asked[1])",
    "what_a_drive_does_goes_on_with_another_force_or_rate",
    module="test_set",
)
