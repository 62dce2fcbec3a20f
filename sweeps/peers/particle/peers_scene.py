"""Scene of all contestants of `sweeps.peers.particle.peers` and `sweeps.peers.flows.peers_flows`: lanes and true
results, errors, settings.

The search for a setting is here as well; no integrator is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

TRANSIENT = 30
"""Periods after the start at which the second state of every value of b is taken."""
WHOLE = "jaxnh, the whole analysis"
"""Row of all that the analysis `lyapunov` does: averages, the orbits of lanes that are on one, and errors."""
PERIODS = 64
"""Periods a call of the timed programs of jaxnh and of heyoka."""

TANGENT_PERIODS = 256
"""Periods a call of the timed programs of spectra."""

_CLOSE = 0.9  # an error in [0.9, 1] of the target meets it closely enough to stop the search
_MOST_TRIES = 14


class Errors(NamedTuple):
    """Error of one period's map, the largest component of (x1, y1, n1, n2) in each lane: over all lanes."""

    max: float
    median: float


class Truth:
    """Lanes with what is true of them: each value of a parameter at the start state, then all TRANSIENT periods on.

    Attributes:
        b: (lanes,) parameter of each lane.
        states: (lanes, d) start states.
        ends: (lanes, k) true components one period later, in long double.
        period: strobe period, or unit of time.
    """

    b: np.ndarray
    states: np.ndarray
    ends: np.ndarray
    period: float

    @property
    def values(self) -> np.ndarray:
        """The values of the parameter."""
        return self.b[: len(self.b) // 2]

    def timed(self, count: int | None = None) -> np.ndarray:
        """Indices (count,) of the lanes that are timed: those past the transient, repeated as needed."""
        lanes = np.arange(len(self.values), len(self.b))
        return lanes if count is None else np.resize(lanes, count)

    def errors(self, ends: np.ndarray) -> Errors:
        """Errors of computed ends (lanes, k); a lane that is not finite counts as infinitely wrong."""
        error = np.abs(ends - self.ends).max(axis=1).astype(float)
        error[~np.isfinite(error)] = np.inf
        return Errors(float(error.max()), float(np.median(error)))


class TangentTruth(Truth):
    """The same with the true derivative of one period's map in every timed lane.

    Attributes:
        derivatives: (timed lanes, d, d) ∂(state one period later)/∂(state).
    """

    derivatives: np.ndarray

    def derivative_errors(self, derivatives: np.ndarray) -> Errors:
        """Frobenius norms of the errors of computed derivatives (timed lanes, d, d), relative to those of the true."""
        norm = np.sqrt((self.derivatives**2).sum(axis=(1, 2)))
        error = (np.sqrt(((derivatives - self.derivatives) ** 2).sum(axis=(1, 2))) / norm).astype(float)
        error[~np.isfinite(error)] = np.inf
        return Errors(float(error.max()), float(np.median(error)))


@dataclass(frozen=True)
class Scene(Truth):
    """The lanes everybody integrates: every value of b at the start state, then all of them TRANSIENT periods on.

    Attributes:
        a, c, d: parameters of the system (ω = 1).
        b: (lanes,) parameter of each lane.
        states: (lanes, 3) start states (x1, y1, θ), θ the direction of the velocity.
        ends: (lanes, 4) true (x1, y1, n1, n2) one period later, in long double.
    """

    a: float
    c: float
    d: float
    b: np.ndarray
    states: np.ndarray
    ends: np.ndarray

    period = 2.0 * math.pi

    @property
    def unit_states(self) -> np.ndarray:
        """(lanes, 4) start states (x1, y1, n1, n2)."""
        return unit(self.states)


@dataclass(frozen=True)
class TangentScene(Scene, TangentTruth):
    """The same with the true derivative of one period's map in every timed lane.

    Attributes:
        derivatives: (timed lanes, 3, 3) ∂(x1, y1, θ) one period later/∂(x1, y1, θ).
    """

    derivatives: np.ndarray


def unit(states: np.ndarray) -> np.ndarray:
    """(x1, y1, n1, n2) of shape (lanes, 4) from (x1, y1, θ) of shape (lanes, 3)."""
    return np.column_stack([states[:, :2], np.cos(states[:, 2]), np.sin(states[:, 2])])


@dataclass(frozen=True)
class Setting:
    """One way of one peer to reach a target, with the error it was measured to have.

    Attributes:
        peer: row of the table that it competes for.
        form: what distinguishes the program, in words.
        knob: the tuned number: steps a period, tolerance, or order.
        label: the knob in words.
        errors: measured.
        key: whatever the contestant needs to build the program, besides the knob.
        kicks: forces a period where that alone decides the cost; else None, and the rate decides.
        rate: lane-periods a second of processor time in a short trial; 0 before it.
        parts: orthonormalisations a period; 0 where there are no tangents.
    """

    peer: str
    form: str
    knob: float
    label: str
    errors: Errors
    key: tuple[Any, ...] = field(default=())
    kicks: int | None = None
    rate: float = 0.0
    parts: int = 0


class Contestant(Protocol):
    """One integrator in a process of its own."""

    def __init__(self, scene: Any) -> None: ...

    def tune(self, target: float, hints: Sequence[Setting], only: bool = False) -> list[Setting]:
        """All its ways to a largest error of `target`, tuned to just meet it.

        Hints are settings whose knobs are tried first; with `only`, their forms are the only ones tried.
        """
        ...

    def program(self, setting: Setting) -> Callable[[], float]:
        """A call that integrates once over several periods and says how many lane-periods these were.

        heyoka's takes `idle=True`: the same calls with no time to integrate over, for the share that Python has.
        """
        ...


def best(settings: Sequence[Setting]) -> Setting:
    """The setting of fewest kicks, or where that does not decide, the fastest in the trial."""
    return min(settings, key=lambda s: (s.kicks or 0, -s.rate))


def least_effort(
    measure: Callable[[float], Errors],
    target: float,
    guess: float,
    *,
    factor: float,
    most: float,
    whole: bool = False,
) -> tuple[float, Errors] | None:
    """The least effort (steps, or 1/tolerance) whose largest error meets the target, and its errors; None if none does.

    Brackets by steps of a factor, then interpolates in the logarithms, where an error is nearly a straight line.
    """
    tried: dict[float, Errors] = {}

    def at(effort: float) -> float:
        if effort not in tried:
            tried[effort] = measure(effort)
        return tried[effort].max

    low, high = 0.0, math.inf
    effort = min(guess, most)
    while len(tried) < _MOST_TRIES:
        effort = float(round(effort)) if whole else effort
        if effort in tried:
            break
        if at(effort) <= target:
            high = effort
            if at(high) >= _CLOSE * target:
                break
        else:
            low = effort
        if high == math.inf:
            if low >= most:
                return None
            effort = min(low * factor, most)
        elif low == 0.0:
            effort = high / factor
        elif high <= 1.005 * low:
            break
        else:
            effort = low * (high / low) ** _fraction(at(low), at(high), target)
            if whole:
                effort = min(max(effort, low + 1), high - 1)
    return (high, tried[high]) if high < math.inf else None


def _fraction(above: float, below: float, target: float) -> float:
    """Return where, in the logarithm of the effort, to look between a too large error and one that meets the target."""
    if not math.isfinite(above) or below <= 0.0 or below >= above:
        return 0.5
    aimed = math.log(above / (0.96 * target)) / math.log(above / below)
    return min(max(aimed, 0.1), 0.9)
