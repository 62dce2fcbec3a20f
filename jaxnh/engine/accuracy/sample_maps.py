"""Maps of the flows of a sweep on sample states of it, and how far apart images are."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import ADAPTIVE_SCHEME, EXPLICIT_ADAPTIVE_SCHEME, Scheme, make_return_map, scheme_of
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import Section, System, flow_of
from jaxnh.solvers import AdaptiveMethod, Solver
from jaxnh.solvers.adaptive import in_loop
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.rows import select, write_rows
from jaxnh.systems.state import State, error_components

Image = list[np.ndarray]
"""States of samples, component by component, each (samples,), without what flows only report."""

_MAPS_KEPT = 64  # of flows, while a number of steps is looked at
_SILENT_SECONDS = 10.0


class Samples(NamedTuple):
    """Sample states of lanes, at several times, of one flow or of several.

    Attributes:
        states: components (samples,).
        p: parameters of the lane, each (samples,).
        row: number of the flow, (samples,).
        where: value of every axis, each (samples,).
    """

    states: State
    p: Parameters
    row: Int[np.ndarray, " samples"]
    where: Mapping[str, Float[np.ndarray, " samples"]]

    def take_lanes(self, subset: Int[np.ndarray, " subset"]) -> Samples:
        """Return a subset of the samples."""
        return select(self, subset)

    def place(self, number: int) -> str:
        """Return where in the sweep a sample lies, in values of its axes."""
        return ", ".join(f"{name} = {values[number]:.9g}" for name, values in self.where.items())


class SampleMaps:
    """Maps of the flows of a sweep, in loops, and the lanes that run them.

    Attributes:
        flows: on their section where they have no clock, those of each value of the shared axes.
        scheme: their way to integrate.
        parts: maps go over one of so many parts of a unit of time, of flows that have neither clock nor section.
        tried: evaluations of the field a period in the finest map that was looked at.
    """

    def __init__(
        self, flows: Sequence[System], lanes: LaneExecutor, parts: int = 1, scheme: Scheme | None = None
    ) -> None:
        """Take flows of one kind, which no map has been made of; by default in their kind's own way."""
        self.flows, self.scheme, self.parts = flows, scheme or scheme_of(flows[0]), parts
        self.tried = 0
        self._lanes, self._said = lanes, time.monotonic()

    @property
    def sectioned(self) -> bool:
        """Return whether maps go from crossing to crossing of a section."""
        return isinstance(self.flows[0], Section)

    @property
    def flow(self) -> Flow:
        """The first of the flows in continuous time."""
        return flow_of(self.flows[0])

    @property
    def may_be_cut(self) -> bool:
        """Return whether maps are over a unit of time that says nothing of the motion, as without clock and section."""
        return self.flow.autonomous and not self.sectioned and not self.flow.chart.dimensionless

    def in_parts(self, parts: int) -> SampleMaps:
        """Return maps of the same flows over one of so many parts of a unit of time."""
        return SampleMaps(self.flows, self._lanes, parts, self.scheme)

    @property
    def adaptive(self) -> bool:
        """Return whether each lane has steps of its own."""
        return isinstance(self.scheme.reference, AdaptiveMethod)

    def with_own_steps(self, *, explicit: bool = False) -> SampleMaps:
        """Return maps of the same flows over whole units of time, in which each lane has steps of its own."""
        return SampleMaps(self.flows, self._lanes, scheme=EXPLICIT_ADAPTIVE_SCHEME if explicit else ADAPTIVE_SCHEME)

    def tell(self, text: str) -> None:
        """Report the progress of a long calibration."""
        if time.monotonic() - self._said > _SILENT_SECONDS:
            self._said = time.monotonic()
            self._lanes.note(f"accuracy: {text}")

    def of(self, solver: Solver, steps: int, *, compensated: bool = False) -> Callable[[int], ReturnMap]:
        """The maps of all flows, by their numbers."""
        if isinstance(solver, Solver):  # and none of diffrax, as costs has them beside ours
            self.tried = max(self.tried, solver.total_kicks(steps))

        @functools.lru_cache(_MAPS_KEPT)
        def map_of(row: int) -> ReturnMap:
            flow = self.flows[row]
            span = (0.0, self.flow.period / self.parts) if self.parts > 1 else None
            return make_return_map(flow, in_loop(solver), steps, compensated=compensated, span=span)

        return map_of

    def by_flow(
        self, function: Callable[..., Any], shared: Callable[[int], tuple[Any, ...]], samples: Samples, periods: int
    ) -> Any:
        """function(*shared, state, p) of every sample, with what its own flow shares; periods a lane."""
        whole: Any = None
        for k in np.unique(samples.row):
            members = np.flatnonzero(samples.row == k)
            part = samples.take_lanes(members)
            values = self._lanes(function, shared(int(k)), (part.states, part.p), periods=periods)
            if len(members) == len(samples.row):
                return values
            if whole is None:
                whole = jax.tree.map(lambda leaf: np.empty((len(samples.row), *leaf.shape[1:]), leaf.dtype), values)
            write_rows(whole, members, values)
        return whole

    def image(self, maps: Callable[[int], ReturnMap], samples: Samples) -> Image:
        """Images of the samples under maps."""
        return image_of(self.by_flow(iterate, lambda row: (maps(row), np.int32(1)), samples, 1))


def image_of(states: State) -> Image:
    """The components of states that errors are measured in."""
    return [np.array(leaf) for leaf in jax.tree.leaves(error_components(states))]


def differences(first: Image, second: Image) -> Float[np.ndarray, "components samples"]:
    """Moduli of the differences of images."""
    with np.errstate(invalid="ignore", over="ignore"):  # of lanes that escape
        return np.abs(np.stack(first) - np.stack(second))


def gaps_between(
    differing: Float[np.ndarray, "components ..."], sizes: Float[np.ndarray, " components"]
) -> Float[np.ndarray, ...]:
    """Largest difference of any component in units of its size; infinite where one is not a number."""
    with np.errstate(invalid="ignore", over="ignore"):
        largest = np.max(differing / sizes.reshape(-1, *(1,) * (differing.ndim - 1)), axis=0)
    return np.where(np.isfinite(largest), largest, np.inf)
