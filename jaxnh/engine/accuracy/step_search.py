"""The fewest steps whose error meets a target, by the errors of few numbers of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

_ROUNDS = 8


def search_steps(
    error_of: Callable[[int], float], target: float, first: int, most: int, order: float, precise: float
) -> Iterator[tuple[int, float]]:
    """Numbers of steps on the way to the fewest that meet the target, each with its error; none below one.

    Args:
        error_of: error of so many steps.
        target: error that is met.
        first, most: the first number that is tried, and the most.
        order: that the error falls with, at first.
        precise: error below which slow convergence may be rounding.
    """
    if most < 1:
        return
    failed, met, steps = 0, most + 1, min(most, first)
    previous = math.inf
    tried: dict[int, float] = {}
    for _ in range(_ROUNDS):
        error = error_of(steps)
        yield steps, error
        if failed and error > target:
            order = _effective_order(failed, tried[failed], steps, error, order)
        tried[steps] = error
        least = 0
        if error <= target:
            met = min(met, steps)
        else:
            slow = error > 0.5 * previous and error < precise
            if steps == most or (slow and steps >= 2 * failed):
                return  # no better than a cheaper solver, or rounding
            least = 2 * failed if slow else 0  # which tell slow convergence from rounding
            failed, previous = max(failed, steps), error
        factor = (error / (0.9 * target)) ** (1.0 / order) if 0 < error < math.inf else 2.0
        guess = math.ceil(steps * min(max(factor, 0.3), 4.0))
        steps = min(max(guess, failed + 1, least), met - 1, most)
        if steps <= failed or met - steps <= met // 50:
            return


def _effective_order(few: int, before: float, many: int, after: float, order: float) -> float:
    """Return the power of the steps with which errors fall, at least one and at most the method's order."""
    if many <= few or not 0.0 < after < before < math.inf:
        return order
    return min(max(math.log(before / after) / math.log(many / few), 1.0), order)
