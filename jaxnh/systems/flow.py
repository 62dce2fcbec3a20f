"""The protocol of a system, which the particle, systems of T, Q and f, and any ẏ = rhs(y, t) implement.

A flow says what moves; a lane says with which numbers; a chart (`chart`) on which of them maps act. A lane is a start
state and a mapping `p` of the parameters that differ between lanes to its own values; all other parameters are the
flow's.
"""

from __future__ import annotations

import abc
import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.typing import ArrayLike

from jaxnh.systems.chart import Chart
from jaxnh.systems.state import Number, State, error_components, status_in_nan
from jaxnh.systems.tracing import jacobian_trace

Parameters = Mapping[str, ArrayLike]
"""Name to value, of the parameters that a lane has of its own; of lanes side by side each (lanes,)."""


STATUS = (
    "ok",
    "singular",
    "off_constraint",
    "not_finite",
    "no_return",
    "escaped",
    "chattering",
    "codimension_two",
    "out_of_steps",
)
"""Status of a lane, by number."""

NOT_FINITE, NO_RETURN = STATUS.index("not_finite"), STATUS.index("no_return")
CHATTERING, CODIMENSION_TWO = STATUS.index("chattering"), STATUS.index("codimension_two")
OUT_OF_STEPS = STATUS.index("out_of_steps")


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


class Flow(eqx.Module):
    """A flow with named coordinates and parameters; its lanes keep one clock, or none."""

    # ---- names

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of a start state, in the order of results."""

    @property
    @abc.abstractmethod
    def parameters(self) -> Parameters:
        """All parameters by name, with the value of lanes that have none of their own."""

    @property
    def lane_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that lanes may have of their own; all that only the flow has may decide a table."""
        return tuple(self.parameters)

    @property
    def equation_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that the equations have, those among them that lanes have of their own left out."""
        return tuple(self.parameters)

    @abc.abstractmethod
    def with_parameters(self, values: Parameters) -> Flow:
        """Return the flow with other values of some of its own parameters, of the same structure."""

    @abc.abstractmethod
    def is_shared(self, name: str) -> bool:
        """Return whether all lanes of a program share the value of a parameter: it changes their clock or table."""

    @property
    @abc.abstractmethod
    def labels(self) -> Labels:
        """Words and units of what has a name."""

    # ---- time

    @property
    @abc.abstractmethod
    def period(self) -> float:
        """Strobe period; without a clock the unit that lengths of time are counted in. On the host alone."""

    @property
    @abc.abstractmethod
    def autonomous(self) -> bool:
        """Return whether there is no clock."""

    @property
    def continuous(self) -> bool:
        """Return whether time is continuous; that of a map counts its iterates."""
        return True

    @property
    def loses_rank(self) -> bool:
        """Return whether different motions may become one in finite time, so that tangents vanish."""
        return False

    def density(self, t: np.ndarray) -> np.ndarray:
        """Steps a unit of time, up to a factor, that suit all lanes; t of any shape."""
        return np.ones_like(t)

    # ---- motion

    @abc.abstractmethod
    def rhs(self, t: ArrayLike, y: State, p: Parameters) -> State:
        """Time derivative of a state; components (...,) in and out."""

    def reversal(self, p: Parameters) -> Any:
        """The involution that takes motions to motions backwards, as `systems.reversal` reads it; None: unsaid."""
        return None

    def divergence(self, t: ArrayLike, y: State, p: Parameters) -> Number:
        """Divergence of the flow; its mean is the sum of the Lyapunov exponents."""
        return self.divergence_of(lambda z: self.rhs(t, z, p), y)

    def divergence_of(self, rate: Callable[[State], State], y: State) -> Number:
        """Divergence at a state, or at what steps carry of one, of a rate that is this flow's.

        Σ ∂ẏ_i/∂y_i over the components that are compared.
        """
        return jacobian_trace(rate, y, error_components)

    @property
    def contraction(self) -> str:
        """Symbols for the mean contraction of volume, where maps give it at no cost and twice of it acts off f = 0.

        Empty elsewhere.
        """
        return ""

    @property
    @abc.abstractmethod
    def exponents(self) -> int:
        """Number of Lyapunov exponents of motions that keep the constraints."""

    def project(self, t: ArrayLike, y: State, p: Parameters) -> State:
        """The state brought back to the constraints, where there are some that a step leaves."""
        return y

    def nearest(self, y: State, p: Parameters, t: ArrayLike = 0.0) -> State:
        """The state near one that is on the constraints at a time, where there are some."""
        return y

    # ---- what maps act on, and what steps carry

    @property
    @abc.abstractmethod
    def chart(self) -> Chart:
        """Section coordinates."""

    @property
    def flow(self) -> Flow:
        """The flow in continuous time, as a section has one (`maps.section.Section.flow`)."""
        return self

    @property
    def reduction(self) -> Reduction:
        """The part of a state that steps carry."""
        return Reduction(self)

    # ---- host: start states and results

    @abc.abstractmethod
    def start(self, coordinates: Mapping[str, ArrayLike]) -> State:
        """The state at t = 0 with coordinates by name, floats or (lanes,); what the constraint decides is left out."""

    @abc.abstractmethod
    def outputs(self, y: State, t: np.ndarray) -> dict[str, Output]:
        """Coordinates of states by name; times t repeat along their last axis."""

    def reports(self, y: State) -> dict[str, Output]:
        """Return the `status` of each trajectory, from the last of its states (..., points)."""
        last = [np.asarray(leaf)[..., -1] for leaf in jax.tree.leaves(y)]
        finite = np.all(np.isfinite(last), axis=0)
        reason = np.max([status_in_nan(x) for x in last], axis=0)
        known = (reason > 0) & (reason < len(STATUS))
        return {"status": status(np.where(finite, 0, np.where(known, reason, NOT_FINITE)))}

    def fault_at(self, t: ArrayLike, y: State, p: Parameters) -> str:
        """Describe why a state has no time derivative; "" where no reason is known."""
        return ""

    def near_degeneracy(self, t: ArrayLike, y: State, p: Parameters) -> str:
        """Describe a near degeneracy along a motion, states (points,) at times t; "" where there is none."""
        return ""


class Reduction:
    """The part of a flow's states that steps carry: all of it, or less where constraints give the rest.

    Attributes:
        flow: whose states.
        leaves_constraints: whether steps may leave the constraints, so that each is projected.
    """

    leaves_constraints = True

    def __init__(self, flow: Flow) -> None:
        self.flow = flow

    def reduce(self, y: State) -> State:
        """The part of a state that steps carry."""
        return y

    def rhs(self, t: ArrayLike, z: State, p: Parameters) -> State:
        """Time derivative of what steps carry."""
        return self.flow.rhs(t, z, p)

    def restore(self, t: ArrayLike, z: State, y: State, p: Parameters) -> State:
        """The state of what steps carry; what only reports is as in a state y before."""
        return z


def pairs(names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """All pairs of coordinates, to be drawn over; of one coordinate itself."""
    return tuple(itertools.combinations(names, 2)) or ((names[0], names[0]),)


def unit_of_time(definition: Mapping[str, Any]) -> float:
    """The period that a definition says; where it has no clock its unit of time, 1 unless it says."""
    return float(definition["period"] if "period" in definition else definition.get("time_unit", 1.0))
