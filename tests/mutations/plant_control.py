"""Errors in the control of corner units, for the list in `plant`; each makes the test fail that is named."""

from __future__ import annotations

from plant import of_text

from exunet.forces import control_laws, thrusters
from exunet.forces.thrusters import SamplingSwitch
from exunet.system import script_events

COMPILED = ("engine.loop=compiled",)


def _of_text(name, what, owner, function, old, new, test, arguments=(), users=()):
    case = f"test_corner_units:test_{test}"
    of_text(name, None, what, owner, function, old, new, case, users=users, arguments=arguments)


_of_text(
    "control_sees_the_future",
    "a controller sees where its units will be at the end of the period",
    SamplingSwitch,
    "_sensed",
    "x[places].tolist(), v",
    "(x[places] + keys.period * v[places]).tolist(), v",
    "a_free_unit_follows_the_sampled_system",
    COMPILED,
)
_of_text(
    "control_noise_without_seed",
    "the noise of sensors does not depend on its seed alone",
    control_laws,
    "_errors",
    "np.random.Philox(key=seed)",
    "np.random.Philox()",
    "noise_has_the_bits_of_its_seed",
)
_of_text(
    "control_not_released",
    "thrusters fire on when a script has ended the control",
    thrusters,
    "released",
    "np.zeros(len(memory) - _FORCES)",
    "memory[_FORCES:]",
    "a_script_begins_and_ends_the_control",
    COMPILED,
    (script_events,),
)
