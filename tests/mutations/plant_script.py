"""Errors in scripts of missions, for the list in `plant`; each makes the test fail that is named."""

from __future__ import annotations

from plant import of_text

from exunet.backends import events
from exunet.case import script
from exunet.system import script_events
from exunet.system.script_events import ScriptEvents

LOCATED = "a_crossing_is_located_whatever_the_steps"
ORDER = "what_is_due_at_one_time_comes_in_the_order_of_the_script"


def _of_text(name, what, owner, function, old, new, test, arguments=(), users=()):
    case = f"test_script:test_{test}"
    of_text(name, None, what, owner, function, old, new, case, users=users, arguments=arguments)


_of_text(
    "script_a_step_late",
    "a script acts at the end of the step in which its condition came true",
    ScriptEvents,
    "crossing",
    "root = min(roots.values())",
    "return last",
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
    "return condition.sign *",
    "return -condition.sign *",
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
