"""The strobe period of a user's system as parameters of a sweep decide it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from jaxnh.systems.flow import Flow
from jaxnh.systems.rows import spread_indices
from jaxnh.systems.user_file import UserFile

_MOST = 1000  # values of a parameter at which the period is looked at


def decides_clock(file: UserFile, flow: Flow, name: str, values: Float[np.ndarray, " n"]) -> bool:
    """Return whether the strobe period depends on a parameter: anywhere near its value, or between these."""
    picked = values[spread_indices(len(values), _MOST)]
    own = {key: value for key, value in flow.parameters.items() if key in file.parameters}
    return flow.roles.is_shared(name) or len({file.period({**own, name: float(value)}) for value in picked}) > 1


def scales_time(file: UserFile, parameters: Mapping[str, float], swept: Mapping[str, Float[np.ndarray, " n"]]) -> bool:
    """Return whether some parameter that is swept decides the period, and time can be over it.

    Args:
        file: the system.
        parameters: values of all parameters.
        swept: values of those that are axes.
    """
    if not file.can_scale_time:
        return False
    flow = file.flow({**parameters, **{name: float(values[0]) for name, values in swept.items()}})
    return any(decides_clock(file, flow, name, values) for name, values in swept.items())
