"""The kicks of a map as a table that all lanes share. The loop over them is `kicks.KickStrobe`."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import threading
from collections.abc import Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxnh.maps.step_grids import SmoothGrid, along_first
from jaxnh.solvers import IsokineticSplitting
from jaxnh.systems.particle import IsokineticParticle

Table = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rows (..., capacity, 3, without forcing 2) for `KickStrobe`, how many are in use, and the last drift (...,)."""

_KEPT = 2048  # tables of whole periods, some tens of KiB each: those of the values of all batches in hand
_TOGETHER = 32  # tables made at once, in 2.2 ms each where one alone takes 3.9; more need tens of megabytes
_GRIDS = 64  # of groups of clocks, a megabyte each at most

_TABLES: dict[tuple[_Clock, IsokineticSplitting, int], Table] = {}  # the last `_KEPT`, in this order
_READING, _MAKING = threading.Lock(), threading.Lock()


class _Clock(NamedTuple):
    """A particle as far as tables go: its speed and forcing alone, whatever its lanes are."""

    c: float
    d: float
    omega: float
    without: frozenset[str]

    def particle(self) -> IsokineticParticle:
        return IsokineticParticle(0.0, *self[:3], None, self.without)


class _ParticleClocks:
    """Clocks that differ in c and d alone, at times that have the particles as first axis."""

    def __init__(self, clocks: Sequence[_Clock]) -> None:
        self._first, self._count = clocks[0].particle(), len(clocks)
        self.period = self._first.period
        self._c, self._d = np.array([clock[:2] for clock in clocks]).T

    def at(self, dimensions: int) -> IsokineticParticle:
        """The particle whose c and d go with times of so many dimensions."""
        if self._count == 1:
            return self._first
        c, d = (along_first(values, dimensions) for values in (self._c, self._d))
        return replace(self._first, c=c, d=d)

    def density(self, t: np.ndarray) -> np.ndarray:
        return self.at(t.ndim).density(t)


def kick_table(
    system: IsokineticParticle, solver: IsokineticSplitting, grid: np.ndarray, *, smallest: int = 1
) -> Table:
    """Kicks of all steps in a row, grid (..., steps + 1); the last drift of each step joins the first of the next."""
    rows = solver.schedule(system, grid[..., :-1], grid[..., 1:])
    before = np.array(rows.drift[..., :-1])
    before[..., 1:, 0] += rows.drift[..., :-1, -1]
    kicks = np.stack([before, rows.weight, *([rows.forcing] if system.forced else [])], axis=-1)
    kicks = kicks.reshape(*grid.shape[:-1], -1, kicks.shape[-1])
    return _table(kicks, np.asarray(rows.drift[..., -1, -1]), max(smallest, kicks.shape[-2]))


def processed_table(
    system: IsokineticParticle,
    solver: IsokineticSplitting,
    steps: int,
    ends: tuple[ArrayLike, ArrayLike],
    *,
    smallest: int = 1,
) -> Table:
    """Kicks of maps of so many steps between ends (...,), with the processor before and its inverse after.

    Every node is on the smooth grid: the steps are then of one constant length in its time, and what the processor
    reaches beyond the ends is there as well.
    """
    first, last = (np.asarray(end)[None] for end in ends)
    return _processed_tables((_clock_of(system),), solver, steps, (first, last), smallest)[0]


def whole_period(system: IsokineticParticle, solver: IsokineticSplitting, steps: int, *, smallest: int = 1) -> Table:
    """`processed_table` of the period from 0, made once for the maps of a period and of its parts."""
    rows, count, rest = whole_periods([system], solver, steps)[0]
    capacity = 1 << (smallest - 1).bit_length()
    if capacity <= len(rows):
        return rows, count, rest
    roomy = np.zeros((capacity, rows.shape[1]))
    roomy[: len(rows)] = rows
    return roomy, count, rest


def whole_periods(systems: Sequence[IsokineticParticle], solver: IsokineticSplitting, steps: int) -> list[Table]:
    """The table of `whole_period` of each system; those that differ in c and d alone are made together, and kept."""
    with _MAKING if len(systems) > 1 else contextlib.nullcontext():  # batches side by side may need the same ones
        return _whole_periods(systems, solver, steps)


def _whole_periods(systems: Sequence[IsokineticParticle], solver: IsokineticSplitting, steps: int) -> list[Table]:
    """`whole_periods`, of which a thread may make tables that another makes too."""
    keys = [(_clock_of(system), solver, steps) for system in systems]
    with _READING:
        tables = {key: _TABLES[key] for key in keys if key in _TABLES}
    groups = _groups(list(dict.fromkeys(key[0] for key in keys if key not in tables)))

    def made(alike: tuple[_Clock, ...]) -> list[Table]:
        ends = np.zeros(1), np.array([alike[0].particle().period])
        return _processed_tables(alike, solver, steps, ends, 1)

    if len(groups) < 2:
        made_of_groups = list(map(made, groups))
    else:
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            made_of_groups = list(threads.map(made, groups))
    for alike, of_group in zip(groups, made_of_groups, strict=True):
        for clock, table in zip(alike, of_group, strict=True):
            for leaf in table:
                leaf.flags.writeable = False
            tables[clock, solver, steps] = table
    with _READING:
        for key, table in tables.items():
            _TABLES.pop(key, None)
            _TABLES[key] = table
        for key in list(_TABLES)[:-_KEPT]:
            del _TABLES[key]
    return [tables[key] for key in keys]


def _groups(clocks: Sequence[_Clock]) -> list[tuple[_Clock, ...]]:
    """Groups of at most `_TOGETHER` clocks that differ in c and d alone; constant speed has drifts of its own."""
    alike: dict[Hashable, list[_Clock]] = {}
    for clock in clocks:
        key = clock[2:] if clock.d and "disturbance" not in clock.without else clock
        alike.setdefault(key, []).append(clock)
    return [tuple(group[k : k + _TOGETHER]) for group in alike.values() for k in range(0, len(group), _TOGETHER)]


def _processed_tables(
    alike: tuple[_Clock, ...],
    solver: IsokineticSplitting,
    steps: int,
    ends: tuple[np.ndarray, np.ndarray],
    smallest: int,
) -> list[Table]:
    """Tables of clocks between ends (1, …), each the one that its clock has alone, bit for bit."""
    grid, clocks, (t0, t1), (at, length) = _smooth_grid(alike), _ParticleClocks(alike), ends, solver.sequence(steps)
    start = grid.share(t0)
    step = (grid.share(t1) - start) / steps
    t = grid.time(start[..., None] + step[..., None] * at)
    system = clocks.at(t.ndim)
    weight = step[..., None] * length * grid.rate(t) / system.speed(t)
    first, last = (np.broadcast_to(end, start.shape)[..., None] for end in ends)
    nodes = np.concatenate([first, t, last], axis=-1)
    drift = np.asarray(clocks.at(t.ndim + 1).path_length(nodes[..., :-1], nodes[..., 1:]))
    kicks = np.stack([drift[..., :-1], weight, *([system.forcing(t) * weight] if system.forced else [])], axis=-1)
    table, count, rest = _table(kicks, drift[..., -1], max(smallest, kicks.shape[-2]))
    return [(table[k], count[k, ...], rest[k, ...]) for k in range(len(alike))]


@functools.lru_cache(_GRIDS)
def _smooth_grid(clocks: tuple[_Clock, ...]) -> SmoothGrid:
    return SmoothGrid(_ParticleClocks(clocks))


def _clock_of(system: IsokineticParticle) -> _Clock:
    return _Clock(float(system.c), float(system.d), float(system.omega), system.without)


def cut_table(whole: Table, parts: int, kicks: int, *, smallest: int = 1) -> Table:
    """A map's table cut between kicks into tables of so many, (parts, …); what is over goes to the first and the last.

    A part ends with a kick: the drift after it begins the next.
    """
    rows, count, rest = whole
    cuts = (int(count) - parts * kicks) // 2 + kicks * np.arange(parts + 1)
    cuts[0], cuts[-1] = 0, count
    counts = np.diff(cuts)
    capacity = max(smallest, int(counts.max()))
    table = np.zeros((parts, 1 << (capacity - 1).bit_length(), rows.shape[-1]))
    for i, (first, after) in enumerate(itertools.pairwise(cuts)):
        table[i, : after - first] = rows[first:after]
    return table, counts.astype(np.int32), np.append(np.zeros(parts - 1), rest)


def _table(kicks: np.ndarray, rest: np.ndarray, capacity: int) -> Table:
    """Kicks (..., count, columns) in a table whose capacity is a power of two."""
    count, columns = kicks.shape[-2:]
    table = np.zeros((*kicks.shape[:-2], 1 << (capacity - 1).bit_length(), columns))
    table[..., :count, :] = kicks
    return table, np.full(rest.shape, count, np.int32), rest
