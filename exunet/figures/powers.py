"""Powers of ten of very small and very large numbers at an axis: in its label, with the unit."""

from __future__ import annotations

import math

from matplotlib.axis import Axis
from matplotlib.ticker import ScalarFormatter

SMALLEST, LARGEST = -2, 4  # powers of the largest number at an axis that is written out


def tell_power_of_ten(axis: Axis) -> None:
    """Numbers from 1 to 10 at a linear axis whose limits are set, where they would have many digits.

    "force [N]" becomes "force [10^-6 N]". Matplotlib puts the power beyond the axis, where it is overlooked.
    """
    largest = max(abs(limit) for limit in axis.get_view_interval())
    power = math.floor(math.log10(largest)) if largest > 0.0 else 0
    if SMALLEST <= power <= LARGEST:
        return
    formatter = ScalarFormatter(useOffset=False)
    formatter.set_powerlimits((power, power))
    axis.set_major_formatter(formatter)
    axis.get_offset_text().set_visible(False)
    if not axis.get_label_text():  # of stacked axes all but the lowest
        return
    words, bracket, unit = axis.get_label_text().partition("[")
    unit = f" {unit}" if bracket else "]"
    axis.set_label_text(f"{words}{'' if bracket else ' '}[$10^{{{power}}}${unit}")
