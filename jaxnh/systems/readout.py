"""States of a flow as results have them: coordinates by name, with words and units, and the status of a lane.

Nothing moves here. What is computed of states on request, as energies, is in `mechanical_outputs`.
"""

from __future__ import annotations

import abc
import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxnh.systems.state import Number, State, status_in_nan
from jaxnh.systems.status import NOT_FINITE, STATUS

UNSAID = ""
"""Units that the user has not said: results have none then."""


class Output(NamedTuple):
    """A named coordinate of states as results have it: numbers, words for it, and attributes."""

    data: Number
    long_name: str
    attrs: Mapping[str, Any] = {}


def status(code: Number) -> Output:
    """Numbers in `STATUS` as results have them."""
    flags = {"flag_values": np.arange(len(STATUS), dtype=np.int8), "flag_meanings": " ".join(STATUS)}
    return Output(np.asarray(code, np.int8), "whether the lane was followed to its end, or why not", flags)


class Labels(NamedTuple):
    """Names and units of a flow's parameters, coordinates and time in results.

    Attributes:
        long_names: in words, the name included: "coupling b".
        units: "1" where there is none, `UNSAID` where nobody says which.
        planes: pairs of coordinates that a motion may be drawn over, the first choice first: the first position and its
            velocity.
        iterates: the unit that iterates count without a clock, in the plural.
    """

    long_names: Mapping[str, str]
    units: Mapping[str, str]
    planes: tuple[tuple[str, str], ...]
    iterates: str = "units of time"


class Readout(abc.ABC):
    """Form of the states of a flow in results.

    Attributes:
        contraction: symbols for the mean contraction of volume, where maps give it at no cost and twice of it acts off
            f = 0; empty elsewhere.
    """

    contraction = ""

    @property
    @abc.abstractmethod
    def labels(self) -> Labels:
        """Words and units of what has a name."""

    @abc.abstractmethod
    def coordinates(self, y: State, t: np.ndarray) -> dict[str, Output]:
        """Coordinates of states by name; times t repeat along their last axis."""

    def reports(self, y: State) -> dict[str, Output]:
        """Return the `status` of each trajectory, from the last of its states (..., points)."""
        last = [np.asarray(leaf)[..., -1] for leaf in jax.tree.leaves(y)]
        finite = np.all(np.isfinite(last), axis=0)
        reason = np.max([status_in_nan(x) for x in last], axis=0)
        known = (reason > 0) & (reason < len(STATUS))
        return {"status": status(np.where(finite, 0, np.where(known, reason, NOT_FINITE)))}


def pairs(names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """All pairs of coordinates, to be drawn over; of one coordinate itself."""
    return tuple(itertools.combinations(names, 2)) or ((names[0], names[0]),)
