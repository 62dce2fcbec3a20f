"""Functions over any number of lanes, by tiles on devices: the runner of all analyses."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np

from jaxnh.analyses.batch import Link
from jaxnh.engine.executor.accounts import Accounts
from jaxnh.engine.executor.grouped_blocks import evaluate_block, evaluate_in_group, group_into_blocks
from jaxnh.engine.executor.programs import Programs
from jaxnh.engine.executor.recorded_states import observe_states, record_beside
from jaxnh.engine.executor.tiles import Call, DeviceTiles, Tiles, count_of
from jaxnh.engine.progress import NullProgress, Progress
from jaxnh.engine.xla_options import machine
from jaxnh.maps.family import Maps, ParameterFamily
from jaxnh.maps.iterate import iterate, record
from jaxnh.systems.rows import concatenate, select

TILE = 256
"""Lanes a tile: large enough to hide what a kernel call costs, small enough for a core's first cache."""

_FEW = 8  # lanes a tile where each value of shared parameters has calls of its own: most have one lane

_LONGEST = 1 << 15
"""Lane-periods of a map's iterates in one call and on one device: a program that runs can neither be stopped nor kept.

They take a tenth of a second of the fast maps and some seconds of slow ones, and a call a millisecond of its own. It is
no measured rate that decides, so that a later run makes the same calls.
"""

_ON_CARD = (1 << 12, 1 << 15, 1 << 17, 1 << 19)
"""Lanes a tile on a graphics card, where every lane is a thread of its own whose bits depend on no other: the least of
these that holds a call's lanes. Those that fill it up end at once."""

_LONGEST_ON_CARD = 1 << 28  # lane-periods in place of `_LONGEST`: seconds

_ROOM = 128  # periods recorded in a call; what is not needed of it takes a hundredth of the time of 64

_RUNNERS_A_CARD = 3
_RUNNERS_A_CORE = 2  # of a chart over b and d, 256 values of d: 70 s in place of 77


class LaneExecutor:
    """Runs per-lane functions over any number of lanes.

    Attributes:
        devices: the JAX devices tiles go to.
        tile: lanes a tile where a call does not say.
        programs: compiled so far.
        accounts: what its calls have cost.
        progress: of its stages.
    """

    def __init__(
        self,
        progress: Progress | None = None,
        devices: list[Any] | None = None,
        tile: int = TILE,
        programs: Programs | None = None,
        accounts: Accounts | None = None,
    ) -> None:
        """Take all devices and no programs, unless told otherwise; accounts may be those of another."""
        self.devices: list[Any] = jax.devices() if devices is None else devices
        self.tile = tile
        self.programs = Programs() if programs is None else programs
        self.accounts = Accounts() if accounts is None else accounts
        self.progress = progress or NullProgress()
        self._on_devices = DeviceTiles(self.devices, self.programs, self.accounts)
        self._tiles: Tiles = self._on_devices
        self._in_stage, self._wraps = False, tuple[Callable[[Tiles], Tiles], ...]()

    @property
    def on_card(self) -> bool:
        """Answer whether its devices are graphics cards."""
        return self.devices[0].platform != "cpu"

    def on_host(self) -> LaneExecutor:
        """This executor on a core of the machine, where few lanes take less time; accounts are shared."""
        if not self.on_card:
            return self
        return LaneExecutor(self.progress, jax.devices("cpu")[:1], accounts=self.accounts)

    def split(self) -> list[LaneExecutor]:
        """Executors to be used side by side, each with accounts of its own: some for each device.

        CPU devices are the cores, on which the programs of one device run side by side as well if threads call them:
        none has to be compiled twice, and a device computes for one executor while another is between two calls.
        """
        if self.on_card:
            each = [([device], Programs()) for device in self.devices] * _RUNNERS_A_CARD
        else:
            each = [(self.devices[:1], self.programs)] * (len(self.devices) * _RUNNERS_A_CORE)
        return [LaneExecutor(self.progress, devices, self.tile, programs) for devices, programs in each]

    def share(self, count: int, progress: Progress) -> list[LaneExecutor]:
        """Executors for slices of the lanes side by side, inside a stage, each with its share of the cores.

        Programs are common, and accounts are of each.
        """
        devices, slices = self.devices[: max(1, len(self.devices) // count)], list[LaneExecutor]()
        for _ in range(count):
            one = type(self)(progress, devices, self.tile, self.programs).without_stages()
            for wrap in self._wraps:
                one = one.through(wrap)
            slices.append(one)
        return slices

    def in_tiles(self, tile: int) -> LaneExecutor:
        """This executor with tiles of at most so many lanes; programs and accounts stay common."""
        if self.on_card:
            return self
        smaller = copy.copy(self)
        smaller.tile = min(tile, self.tile)
        return smaller

    def through(self, wrap: Callable[[Tiles], Tiles]) -> LaneExecutor:
        """This executor with a wrapper around its tiles, as a journal of their results; accounts are shared."""
        wrapped = copy.copy(self)
        wrapped._tiles, wrapped._wraps = wrap(self._tiles), (*self._wraps, wrap)
        return wrapped

    def without_stages(self) -> LaneExecutor:
        """This executor inside a stage that is shown already: it begins no others; accounts are shared."""
        silent = copy.copy(self)
        silent._in_stage = True
        return silent

    @property
    def machine(self) -> dict[str, str]:
        """The kind of processor and XLA's options (`xla_options.machine`)."""
        return machine(self.devices[0])

    @contextmanager
    def stage(self, label: str, total: float) -> Iterator[None]:
        """Show the calls inside as one stage of `total` lane-periods."""
        if self._in_stage:
            yield
            return
        self.progress.start(label, total)
        try:
            yield
        finally:
            self.progress.finish()

    def note(self, text: str) -> None:
        """Report a note on the present stage."""
        self.progress.note(text)

    def __call__(
        self,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: tuple[Any, ...],
        *,
        periods: float = 0.0,
        tile: int | None = None,
        static: tuple[Any, ...] = (),
    ) -> Any:
        """function(*shared, *lane, *static) for every lane.

        Args:
            function: pure function of one lane, defined at module level (programs are kept by it).
            shared: pytrees that all lanes see alike, or families, of which a lane sees the tree at its own values.
            lanes: pytrees whose leaves have the lanes as first axis; with a family among them a mapping that has the
                values of its parameters, which the function does not see.
            periods: periods that a lane costs, for progress and accounts.
            tile: lanes a tile where a program has few lanes but much to do in each.
            static: further hashable arguments, part of the program.

        Returns:
            The function's results as NumPy arrays with the lanes as first axis.
        """
        link = Link(function, shared, static, periods)
        return self._results((link,), lanes, tile)[0]

    def chain(self, links: Sequence[Link], lanes: tuple[Any, ...], *, tile: int | None = None) -> list[Any]:
        """Functions one after the other, each of what the one before leaves on the device.

        In several calls where it takes long, between which it can be stopped and is kept, and states go by the host.

        Args:
            links: the functions; in place of the first of the lanes' arguments each but the first takes what the one
                before leaves.
            lanes: as of a single call.
            tile: as of a single call.

        Returns:
            What comes to the host of each.
        """
        longest, results = self._longest([part for link in links for part in link.shared], count_of(lanes), tile), []
        links, (carried, *others) = list(links), lanes
        while links:
            call, left = [links.pop(0)], longest
            while links and (links[0].periods <= (left := left - call[-1].periods) or not links[0].periods):
                call.append(links.pop(0))
            if links:
                call[-1] = call[-1]._replace(keep=lambda result, keep=call[-1].keep: (None, keep(result)))
            results += self._results(tuple(call), (carried, *others), tile)
            if links:
                carried, results[-1] = results[-1]
        return results

    def iterate(self, maps: Maps, n: int, lanes: tuple[Any, Any], *, tile: int | None = None) -> Any:
        """Pⁿ of every lane, in several calls where it takes long, between which it can be stopped and is kept.

        The program is the same, with the count as an argument, and so are the bits.

        Args:
            lanes: states and parameters.
        """
        state, p = lanes
        longest = self._longest((maps,), count_of(lanes), tile)
        while n > 0:
            count = min(n, longest)
            state = self(iterate, (maps, np.int32(count)), (state, p), periods=count, tile=tile)
            n -= count
        return state

    def record(self, maps: Maps, count: int, lanes: tuple[Any, Any], *, tile: int | None = None) -> Any:
        """The states of every lane after 1, 2, …, count periods, their components (lanes, count).

        In calls of at most `_ROOM` periods: one program serves all counts.

        Args:
            lanes: states and parameters.
        """
        (state, p), parts = lanes, list[Any]()
        for n in _counts(count):
            states = self(record, (maps, np.int32(n)), (state, p), periods=n, tile=tile, static=(_ROOM,))
            parts.append(select(states, np.s_[:, :n]))
            if len(parts) < len(_counts(count)):
                state = select(parts[-1], np.s_[:, -1])
        return concatenate(parts, axis=1)

    def observe(
        self,
        maps: Maps,
        count: int,
        lanes: tuple[Any, Any],
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        *,
        tile: int | None = None,
    ) -> tuple[Any, Any]:
        """function(*shared, state) of every lane's states after 1, 2, …, count periods, and the last of these states.

        The other states do not come to the host.

        Args:
            lanes: states and parameters.
        """
        links = list[Link]()
        for n in _counts(count):
            links.append(Link(record, (maps, np.int32(n)), (_ROOM,), n, lambda states: (states, ())))
            links.append(Link(observe_states, shared, (n, function), keep=lambda result: (result[0], result)))
        results = self.chain(links, lanes, tile=tile)[1::2]
        end, values = results[-1]
        if len(results) > 1:
            values = concatenate((part for _, part in results), axis=1)
        return values, end

    def summarise(
        self,
        maps: Maps,
        count: int,
        lanes: tuple[Any, Any],
        beside: Any,
        function: Callable[..., Any],
        static: tuple[Any, ...] = (),
        *,
        tile: int | None = None,
    ) -> Any:
        """function(maps, (states, beside), p, *static) of the states of `record`, which do not come to the host."""
        state, p = lanes
        recording = Link(record_beside, (maps, np.int32(count)), (max(_ROOM, count),), count, lambda z: (z, ()))
        return self.chain([recording, Link(function, (maps,), static)], ((state, beside), p), tile=tile)[1]

    def program(
        self,
        function: Callable[..., Any],
        shared: tuple[Any, ...],
        lanes: Any,
        static: tuple[Any, ...] = (),
        tile: int | None = None,
    ) -> tuple[str, int]:
        """The compiled program that such a call runs, as text, and the lanes of a tile in it."""
        call = self._call((Link(function, shared, static),), lanes, tile)
        return self._on_devices.text(call), call.tile

    def _call(self, links: tuple[Link, ...], lanes: tuple[Any, ...], tile: int | None) -> Call:
        """A call in tiles of the size that all links allow."""
        size = self._tile([part for link in links for part in link.shared], count_of(lanes), tile)
        return Call(links, jax.tree.map(np.asarray, lanes), size)

    def _results(self, links: tuple[Link, ...], lanes: tuple[Any, ...], tile: int | None) -> list[Any]:
        """Results of each link on the host, of lanes of one value of each family or of many."""
        call = self._call(links, lanes, tile)
        families = [part for link in links for part in link.shared if isinstance(part, ParameterFamily)]
        if not families:
            return self._run(call)
        family = families[0]
        values, group = family.groups(_own(family, call.lanes))
        if family.together:
            group = np.array([family.together.index(value) for value in values])[group]
            return (self._in_threads if self.on_card else self._in_blocks)(call, family, group)
        for each in families:
            each.prepare(values)
        results, order = [], []
        for k, value in enumerate(values):
            where = np.flatnonzero(group == k)
            own = _with_shared(links, lambda part, value=value: part.at(value))
            lanes = select(_without_family(family, call.lanes), where)
            results.append(self._run(call._replace(links=own, lanes=lanes)))
            order.append(where)
        return select(concatenate(results), np.argsort(np.concatenate(order)))

    def _run(self, call: Call) -> list[Any]:
        """Results of a call without families."""
        results = []
        for tile in self._tiles.run(call):
            done = call.periods * count_of(tile.each)
            self.accounts.lane_periods += done
            self.progress.advance(done)
            results.append(tile.each)
        return concatenate(results)

    def _in_blocks(self, call: Call, family: ParameterFamily[Any], group: np.ndarray) -> list[Any]:
        """Lanes of several values of a family, block by block through one program."""
        blocks = group_into_blocks(group, _without_family(family, call.lanes), call.tile)
        links = _in_groups(call, evaluate_block, len(blocks.back) / len(blocks.groups))
        result = self._run(Call(links, (*blocks.lanes, blocks.groups), blocks.a_tile))
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[blocks.back], result)

    def _in_threads(self, call: Call, family: ParameterFamily[Any], group: np.ndarray) -> list[Any]:
        """Lanes of several values of a family, each of which looks its own value's tree up."""
        order, lanes = None, _without_family(family, call.lanes)
        if np.any(group[1:] < group[:-1]):  # threads side by side read the same entries of tables
            order = np.argsort(group, kind="stable")
            lanes, group = select((lanes, group), order)
        links = _in_groups(call, evaluate_in_group, 1.0)
        result = self._run(call._replace(links=links, lanes=(*lanes, group.astype(np.int32))))
        return result if order is None else select(result, np.argsort(order))

    def _longest(self, shared: Sequence[Any], count: int, tile: int | None) -> int:
        """Periods of a lane in one call."""
        return max(1, (_LONGEST_ON_CARD if self.on_card else _LONGEST) // self._tile(shared, count, tile))

    def _tile(self, shared: Sequence[Any], count: int, tile: int | None) -> int:
        """Lanes a tile: as many as asked for, but at most as many as the maps in it allow."""
        if self.on_card:
            return next((size for size in _ON_CARD if size >= count), _ON_CARD[-1])
        if any(isinstance(part, ParameterFamily) and not part.together for part in shared):
            return _FEW
        most = [most for part in shared if (most := getattr(part, "most_lanes", None))]
        return min(self.tile, *most, tile or self.tile)


def _counts(count: int) -> list[int]:
    """Periods of each call that records."""
    return [min(_ROOM, count - first) for first in range(0, max(count, 1), _ROOM)]


def _with_shared(links: Sequence[Link], change: Callable[[ParameterFamily[Any]], Any]) -> tuple[Link, ...]:
    """Links with something else in place of each family."""

    def changed(link: Link) -> Link:
        shared = (change(part) if isinstance(part, ParameterFamily) else part for part in link.shared)
        return link._replace(shared=tuple(shared))

    return tuple(map(changed, links))


def _in_groups(call: Call, evaluate: Callable[..., Any], lanes: float) -> tuple[Link, ...]:
    """Links of a call over lanes, or blocks of so many of them, each with its group as last argument."""
    return tuple(
        link._replace(
            function=evaluate, static=((link.function, link.static, len(call.lanes)),), periods=link.periods * lanes
        )
        for link in _with_shared(call.links, lambda part: part.stack)
    )


def _own(family: ParameterFamily[Any], lanes: tuple[Any, ...]) -> Mapping[str, Any]:
    """The mapping among the arguments of lanes that holds the parameters of a family."""
    return next(part for part in lanes if isinstance(part, Mapping) and set(family.names) <= set(part))


def _without_family(family: ParameterFamily[Any], lanes: tuple[Any, ...]) -> tuple[Any, ...]:
    """The arguments of lanes without the parameters of a family."""
    p = _own(family, lanes)
    rest = {name: values for name, values in p.items() if name not in family.names}
    return tuple(rest if part is p else part for part in lanes)
