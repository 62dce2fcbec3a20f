"""The protocol of a system, which the particle, systems of T, Q and f, and any ẏ = rhs(y, t) implement.

A flow says what moves; a lane says with which numbers; a chart (`chart`) on which of them maps act. A lane is a start
state and a mapping `p` of the parameters that differ between lanes to its own values; all other parameters are the
flow's.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from jaxnh.systems.chart import Chart
from jaxnh.systems.readout import Readout
from jaxnh.systems.state import Number, State, error_components
from jaxnh.systems.tracing import jacobian_trace

Parameters = Mapping[str, ArrayLike]
"""Name to value, of the parameters that a lane has of its own; of lanes side by side each (lanes,)."""


class ParameterRoles(NamedTuple):
    """The parts that the parameters of a flow play.

    Attributes:
        of_lanes: names of those that lanes may have of their own; all that only the flow has may decide a table.
        of_equations: names of those that the equations have, those that lanes have of their own left out.
        is_shared: name to whether all lanes of a program share its value: it changes their clock or table. On the host.
    """

    of_lanes: tuple[str, ...]
    of_equations: tuple[str, ...]
    is_shared: Callable[[str], bool]


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
    @abc.abstractmethod
    def roles(self) -> ParameterRoles:
        """The parts that the parameters play."""

    @abc.abstractmethod
    def with_parameters(self, values: Parameters) -> Flow:
        """Return the flow with other values of some of its own parameters, of the same structure."""

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
        return jacobian_trace(lambda z: self.rhs(t, z, p), y, error_components)

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
    def reduction(self) -> Reduction:
        """The part of a state that steps carry."""
        return Reduction(self)

    # ---- host: start states and results

    @abc.abstractmethod
    def start(self, coordinates: Mapping[str, ArrayLike]) -> State:
        """The state at t = 0 with coordinates by name, floats or (lanes,); what the constraint decides is left out."""

    @property
    @abc.abstractmethod
    def readout(self) -> Readout:
        """States as results have them."""


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

    def divergence_of(self, rate: Callable[[State], State], z: State) -> Number:
        """Divergence of a rate of what steps carry: Σ ∂ż_i/∂z_i over the components that are compared."""
        return jacobian_trace(rate, z, error_components)

    def restore(self, t: ArrayLike, z: State, y: State, p: Parameters) -> State:
        """The state of what steps carry; what only reports is as in a state y before."""
        return z
