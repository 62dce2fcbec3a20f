"""Check that a user's equations are the same a period later: comparison at random states and times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.user_functions import COMPILED_FOR_ONE_CALL

_PROBES = 16  # random states and times
_ALIKE = 1e-8  # of the largest number there: a period of ten digits will do


class PeriodFault(NamedTuple):
    """A function that is another one a period later: its name, the number that differs, both values and when."""

    name: str
    number: int
    first: float
    second: float
    t: float


def period_fault(
    functions: Mapping[str, Callable[..., Any]],
    sizes: Sequence[int],
    period: float,
    guarded: Callable[[Callable[[], Any]], Any],
) -> PeriodFault | None:
    """Return the first function that has not the period; None where all have.

    Args:
        functions: of vectors and t, by name.
        sizes: of the vectors.
        period: that is said.
        guarded: calls a body, and says whose line fails.
    """
    draws = np.random.default_rng(0)
    states = [draws.uniform(-1.0, 1.0, (size, _PROBES)) for size in sizes]
    t = draws.uniform(0.0, period, _PROBES)

    def rates(t: Any, states: Any) -> list[Any]:
        results = [function(*map(tuple, states), t) for function in functions.values()]
        return [jnp.stack(jax.tree.leaves(each)) for each in results]

    both = jax.jit(lambda t, y: (rates(t, y), rates(t + period, y)), compiler_options=COMPILED_FOR_ONE_CALL)
    with jax.enable_x64(True):  # whoever loads a config in a script has not started a session yet
        now, later = guarded(lambda: both(t, states))
    for name, first, second in zip(functions, map(np.asarray, now), map(np.asarray, later), strict=True):
        finite = np.isfinite(first) & np.isfinite(second)
        gap = np.abs(np.where(finite, first - second, 0.0))
        number, probe = np.unravel_index(np.argmax(gap), gap.shape)
        if gap[number, probe] > _ALIKE * np.max(np.abs(first), initial=1e-300, where=finite):
            at = number, probe
            return PeriodFault(name, int(number), float(first[at]), float(second[at]), float(t[probe]))
    return None
