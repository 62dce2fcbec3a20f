"""What a system is: the one protocol that the particle, systems of T, Q and f, and sections of them implement.

A flow says what moves; a lane says with which numbers. A lane is a start state and a mapping `p` of the parameters that
differ between lanes to its own values; all other parameters are the flow's.
"""

from __future__ import annotations

import abc
import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.systems.tracing import jacobian_trace

Number = Any
"""A number, or many of any one shape (...,): a JAX array in a lane, a NumPy array or a float on the host.

Python has no type for what arithmetic takes of all three; this name says what is meant.
"""

Vector = tuple[Number, ...]
"""Cartesian components."""

State = Any
"""A pytree of components of shape (...,): (q, n) of a particle at a prescribed speed, `Motion`, `Crossing`."""

Parameters = Mapping[str, ArrayLike]
"""Name to value, of the parameters that a lane has of its own; of lanes side by side each (lanes,)."""


FAULTS = ("none", "singular", "off_constraint", "not_finite")
"""Why a lane has failed, by number; 0 where it has not."""


UNSAID = "unknown"
"""Units of what has units, or none, that the user has not said."""


class Output(NamedTuple):
    """A named coordinate of states as results have it: numbers, words for it, and attributes."""

    data: Number
    long_name: str
    attrs: Mapping[str, Any] = {}


class Flow(eqx.Module):
    """A flow with named coordinates and parameters; its lanes keep one clock, or none.

    Section coordinates are those that a Poincaré map acts on: of shape (dimension,), or (..., dimension) on the host.
    """

    # ---- names

    @property
    @abc.abstractmethod
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of a start state, in the order of results."""

    @property
    @abc.abstractmethod
    def parameters(self) -> Parameters:
        """All parameters by name, with the value of lanes that have none of their own."""

    @abc.abstractmethod
    def words(self, name: str) -> str:
        """What a parameter or coordinate is called in results, its name included: "coupling b"."""

    def units(self, name: str) -> str:
        """Units of a parameter, a coordinate or the time t: "1" where it has none, `UNSAID` where nobody says which."""
        return "1"

    @property
    @abc.abstractmethod
    def plane(self) -> tuple[str, str]:
        """The two coordinates that portraits are drawn over: the first position and its velocity."""

    @property
    def planes(self) -> tuple[tuple[str, str], ...]:
        """All planes that a motion may be drawn over, the first choice first."""
        return (self.plane, *itertools.combinations(self.coordinates, 2))

    @property
    def flow(self) -> Flow:
        """The flow in continuous time: itself, or of a section the flow that it is of."""
        return self

    @property
    def section(self) -> str:
        """Where the flow is a section of another: in words, else ""."""
        return ""

    # ---- time

    @property
    @abc.abstractmethod
    def period(self) -> float:
        """Strobe period; without a clock the unit that lengths of time are counted in. On the host alone."""

    @property
    @abc.abstractmethod
    def autonomous(self) -> bool:
        """Whether there is no clock."""

    @abc.abstractmethod
    def shares(self, name: str) -> bool:
        """Whether all lanes of a program must have the same value of a parameter: it changes their clock or table."""

    @property
    def own(self) -> tuple[str, ...]:
        """Names of the parameters that lanes may have of their own; all that only the flow has may decide a table."""
        return tuple(self.parameters)

    def density(self, t: np.ndarray) -> np.ndarray:
        """Steps a unit of time, up to a factor, that suit all lanes; t of any shape."""
        return np.ones_like(t)

    # ---- motion

    @abc.abstractmethod
    def rhs(self, t: ArrayLike, y: State, p: Parameters) -> State:
        """Time derivative of a state; components (...,) in and out."""

    def fault_at(self, t: ArrayLike, y: State, p: Parameters) -> str:
        """Why one state has no time derivative, in words; "" where nothing is known of that. On the host alone."""
        return ""

    def lost_on_the_way(self, t: ArrayLike, y: State, p: Parameters) -> str:
        """What a motion nearly loses, in words: states (points,) at times t; "" where that is nothing. On the host."""
        return ""

    def divergence(self, t: ArrayLike, y: State, p: Parameters) -> Number:
        """Divergence of the flow; its mean is the sum of the Lyapunov exponents."""
        return self.divergence_of(lambda z: self.rhs(t, z, p), y)

    def divergence_of(self, rate: Callable[[State], State], y: State) -> Number:
        """Divergence at a state of a rate that is this flow's: Σ ∂ẏ_i/∂y_i over the components that are compared."""
        return jacobian_trace(rate, y, self.compared)

    @property
    def contraction(self) -> str:
        """Symbols for the mean contraction of volume, where maps give it at no cost and twice of it acts off f = 0.

        Empty elsewhere.
        """
        return ""

    def project(self, t: ArrayLike, y: State, p: Parameters) -> State:
        """The state brought back to the constraints, where there are some that a step leaves."""
        return y

    # ---- what steps carry

    def stepped(self, y: State) -> State:
        """What steps carry of a state: less of it where constraints give the rest."""
        return y

    def stepped_rate(self, t: ArrayLike, z: State, p: Parameters) -> State:
        """Time derivative of what steps carry."""
        return self.rhs(t, z, p)

    def restored(self, t: ArrayLike, z: State, y: State, p: Parameters) -> State:
        """The state of what steps carry; what only reports is as in a state y before."""
        return z

    @property
    def drifts(self) -> bool:
        """Whether steps may leave the constraints, so that each is projected."""
        return True

    # ---- comparing states

    def compared(self, y: State) -> State:
        """The components of a state that an error is a difference of: all but those that only report."""
        return y

    def blanked(self, y: State, kept: Number) -> State:
        """The state of a lane that is kept, and not a number of one that is not."""

        def component(x: Array) -> Array:
            return jnp.where(kept, x, jnp.nan)

        return jax.tree.map(component, y)

    # ---- section coordinates

    @property
    def dimensionless(self) -> bool:
        """Whether section coordinates are of order one as they are, so that what is near needs no other measure."""
        return False

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """Number of section coordinates."""

    @property
    @abc.abstractmethod
    def exponents(self) -> int:
        """Number of Lyapunov exponents of motions that keep the constraints."""

    @abc.abstractmethod
    def chart(self, y: State) -> Float[Array, " dimension"]:
        """Section coordinates of a state."""

    @abc.abstractmethod
    def unchart(self, u: Float[Array, " dimension"]) -> State:
        """The state with section coordinates."""

    @abc.abstractmethod
    def wrap(self, difference: Number) -> Number:
        """A difference of section coordinates (..., dimension), its angles in [−π, π)."""

    @abc.abstractmethod
    def apart(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Largest difference of positions between section points (..., dimension): (...,)."""

    @abc.abstractmethod
    def signal(self, y: State) -> Vector:
        """The observables that stand for a motion where few are enough: one position, or of an angle cosine and sine.

        An angle itself is no observable: it may grow for ever, and whole turns of it are no motion.
        """

    # ---- tangents

    @abc.abstractmethod
    def directions(self, k: int) -> tuple[Vector, ...]:
        """k tangents in section coordinates to begin with."""

    @abc.abstractmethod
    def lift(self, y: State, tangent: Vector) -> State:
        """The tangent of a state with these section coordinates."""

    @abc.abstractmethod
    def lower(self, y: State, tangent: State) -> Vector:
        """Section coordinates of a tangent of a state."""

    # ---- host: start states and results

    @abc.abstractmethod
    def start(self, coordinates: Mapping[str, ArrayLike]) -> State:
        """The state at t = 0 with coordinates by name, floats or (lanes,); what the constraint decides is left out."""

    @abc.abstractmethod
    def section_point(self, y: State) -> Float[np.ndarray, "... dimension"]:
        """Section coordinates of states (...,) on the host."""

    @abc.abstractmethod
    def random_states(self, draws: np.ndarray, box: float, p: Parameters) -> State:
        """Start states (lanes,) from even draws (lanes, d) in [−1, 1]: positions within the box, any direction."""

    @abc.abstractmethod
    def outputs(self, y: State, t: np.ndarray) -> dict[str, Output]:
        """Coordinates of states by name; times t repeat along their last axis."""

    def reports(self, y: State) -> dict[str, Output]:
        """What there is to report of each trajectory (..., points), such as why it has failed."""
        return {}


def turned(angle: Number) -> Number:
    """An angle in [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def unit_of_time(definition: Mapping[str, Any]) -> float:
    """The period that a definition says; where it has no clock its unit of time, 1 unless it says."""
    return float(definition["period"] if "period" in definition else definition.get("time_unit", 1.0))
