"""A journal around the tiles of a lane executor: what a stopped run has computed is not computed again."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax

from jaxnh.analyses.batch import Link
from jaxnh.engine.cache.fingerprints import CallFingerprints
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.executor.programs import signature
from jaxnh.engine.executor.tiles import Call, TileResults, Tiles, count_of
from jaxnh.storage.calls import CallJournal, JournalEntry

_WORTH_KEEPING = 0.002
"""Seconds of a tile: what takes less is computed again in the time in which it would be written and read."""

_CALLS = 1 << 32  # of a slice of the lanes, at most


class _JournaledTiles:
    """Tiles whose results are kept in a journal, or taken from it where it has them.

    Of a call the tiles before the first that takes too little time are kept.
    """

    def __init__(self, tiles: Tiles, journal: CallJournal, structures: _ResultStructures, number: int) -> None:
        """Those of a slice of the lanes, or 0 of all, whose calls have numbers of their own."""
        self._tiles, self._journal, self._structures = tiles, journal, structures
        self._fingerprints, self._calls = CallFingerprints(), number * _CALLS

    def run(self, call: Call, first: int = 0) -> Iterator[TileResults]:
        number, self._calls = self._calls, self._calls + 1
        name = self._name_of(call)
        if entries := self._journal.take_entries(number, name):
            structure = self._structures.of(call)
            for entry in entries:
                yield TileResults(first, jax.tree.unflatten(structure, entry.leaves), 0.0)
                first = entry.first + len(entry.leaves[0])
        if first == count_of(call.lanes):
            return
        worth_keeping = True
        for tile in self._tiles.run(call, first):
            worth_keeping &= tile.seconds >= _WORTH_KEEPING
            if worth_keeping:
                self._journal.add(JournalEntry(number, tile.first, name, tuple(jax.tree.leaves(tile.each))))
            yield tile

    def _name_of(self, call: Call) -> str:
        """Fingerprint of all links and of what the first is given."""
        name, (first, *others) = self._fingerprints, call.links
        digest = name.of(first.function, first.shared, call.lanes, first.static, call.tile)
        for link in others:
            digest = name.of(link.function, link.shared, digest, link.static)
        return digest


class _ResultStructures:
    """Structures of the results of calls: a function is traced once for all calls with arguments of the same shapes."""

    def __init__(self) -> None:
        self._known: dict[Any, Any] = {}

    def of(self, call: Call) -> Any:
        """The structure of the results of a call for a lane."""
        lanes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), call.lanes)
        (carried, *others), kept = lanes, []
        for link in call.links:
            carried, read = link.keep(self._result(link, (carried, *others)))
            kept.append(read)
        return jax.tree.structure(kept)

    def _result(self, link: Link, lanes: tuple[Any, ...]) -> Any:
        """The shapes of the result of a link."""
        key = signature(link.function, link.static, (link.shared, lanes))
        if key not in self._known:
            self._known[key] = jax.eval_shape(lambda *lane: link.function(*link.shared, *lane, *link.static), *lanes)
        return self._known[key]


@contextmanager
def with_journal(lanes: LaneExecutor, journal: CallJournal) -> Iterator[LaneExecutor]:
    """The executor with a journal of its calls, which has to be the same calls in every run.

    Where an exception ends it, all results are written to the journal.
    """
    try:
        slices, structures = itertools.count(), _ResultStructures()
        yield lanes.through(lambda tiles: _JournaledTiles(tiles, journal, structures, next(slices)))
    except BaseException:
        journal.close(remove=False)
        raise
