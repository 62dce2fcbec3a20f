"""The protocol of a map of one lane: states and tangents over one period, whatever its flow and solver."""

from __future__ import annotations

import abc
from typing import Any, NamedTuple

import equinox as eqx
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Parameters
from jaxnh.systems.state import State


class Tangent(NamedTuple):
    """A direction in phase and parameter space, each component of shape ().

    Attributes:
        state: δ of the state.
        p: δ of the parameters that change, by name; without any nothing of a derivative in them is computed.
    """

    state: State
    p: Parameters | None = None


class Pushforward(NamedTuple):
    """Result of `ReturnMap.pushforward`.

    Attributes:
        state: the state later.
        tangents: the tangents later, in the order given.
        log_volume: logarithm of the modulus of the determinant of the derivative of the section coordinates, of
            (x1, y1, θ) −∫ n·F/s dt: the determinant itself may underflow.
    """

    state: State
    tangents: tuple[Tangent, ...]
    log_volume: Array


class ReturnMap(eqx.Module):
    """P(z; p) for one lane: state and its own parameters in, the state one strobe period later out.

    Use under `jax.vmap`. For a section, from one crossing to the next; for a map, one iterate.

    Attributes:
        system: a `Flow`, or a `Section` of one.
    """

    system: eqx.AbstractVar[Any]  # Any, as a mutable attribute cannot narrow its type in a subclass

    @property
    def chart(self) -> Chart:
        """Section coordinates that the map acts on."""
        return self.system.chart

    @property
    def most_lanes(self) -> int | None:
        """Lanes a tile at most, where more would be slower."""
        return None

    def as_loop(self) -> ReturnMap:
        """Return this map as the shortest program, which need not be the fastest, nor equal in its last bits."""
        return self

    @property
    @abc.abstractmethod
    def trip_counts(self) -> tuple[float, ...]:
        """Trip counts of the program's loops in a period, outermost first; the mean over stacked maps."""

    @abc.abstractmethod
    def __call__(self, state: State, p: Parameters) -> State:
        """The state one strobe period later."""

    def iterate(self, n: ArrayLike, state: State, p: Parameters) -> State:
        """The state n periods later; n may be traced."""

        def period(_: Array, z: State) -> State:
            return self(z, p)

        return lax.fori_loop(0, n, period, state)  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]

    @abc.abstractmethod
    def pushforward(
        self, state: State, p: Parameters, tangents: tuple[Tangent, ...], volume: bool = True
    ) -> Pushforward:
        """The state and any number of tangents one strobe period later, exact derivatives of `__call__`.

        Args:
            volume: whether the volume is asked for; where it costs a derivative of its own, it is zero else.
        """

    def rescaled_time(self, factor: ArrayLike) -> ReturnMap:
        """The map over so many times the time, of a flow without a clock; of maps of one step alone."""
        raise NotImplementedError

    def compact(self) -> ReturnMap:
        """Return this map in tables no larger than it needs."""
        return self

    def padded_like(self, other: ReturnMap) -> ReturnMap:
        """Return this map in tables as large as another's, which has more steps: both then run through one program."""
        return self
