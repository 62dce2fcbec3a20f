"""Warnings on trajectories that fail, in words."""

from __future__ import annotations

from collections.abc import Mapping

_FAILURES = {
    "singular": "meet a singular matrix",
    "off_constraint": "leave the constraint",
    "not_finite": "are not finite at their end",
    "no_return": "do not return to the section",
    "escaped": "escape",
    "chattering": "end in chattering, ever more impacts in finite time",
    "codimension_two": "come to a point where the way on is not unique",
    "out_of_steps": "run out of steps",
}


def count_warnings(name: str, counts: Mapping[str, int]) -> tuple[str, ...]:
    """Warnings on the trajectories of an analysis over the whole sweep, one for each reason of a failure."""
    return tuple(
        f"{name}: {counts[reason]} of {counts['trajectories']} trajectories {words}"
        for reason, words in _FAILURES.items()
        if counts.get(reason)
    )
