"""The kicks of a map as a table that all lanes share. The loop over them is `kicks.KickStrobe`."""

from __future__ import annotations

import functools
import itertools

import numpy as np
from numpy.typing import ArrayLike

from jaxnh.maps.step_grids import SmoothGrid
from jaxnh.solvers import IsokineticSplitting
from jaxnh.systems.particle import IsokineticParticle

Table = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rows (..., capacity, 3, without forcing 2) for `KickStrobe`, how many are in use, and the last drift (...,)."""

_KEPT = 256  # tables of whole periods, some tens of KiB each: those of the rows of all batches in hand


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
    grid, (t0, t1) = _smooth_grid(_clock_of(system)), map(np.asarray, ends)
    at, length = solver.sequence(steps)
    start = grid.share(t0)
    step = (grid.share(t1) - start) / steps
    t = grid.time(start[..., None] + step[..., None] * at)
    weight = step[..., None] * length * grid.rate(t) / system.speed(t)
    nodes = np.concatenate([t0[..., None], t, t1[..., None]], axis=-1)
    drift = np.asarray(system.path_length(nodes[..., :-1], nodes[..., 1:]))
    kicks = np.stack([drift[..., :-1], weight, *([system.forcing(t) * weight] if system.forced else [])], axis=-1)
    return _table(kicks, drift[..., -1], max(smallest, kicks.shape[-2]))


def whole_period(system: IsokineticParticle, solver: IsokineticSplitting, steps: int, *, smallest: int = 1) -> Table:
    """`processed_table` of the period from 0, made once for the maps of a period and of its parts."""
    rows, count, rest = _whole_period(_clock_of(system), solver, steps)
    missing = (1 << (smallest - 1).bit_length()) - len(rows)
    return (np.pad(rows, [(0, missing), (0, 0)]) if missing > 0 else rows), count, rest


@functools.lru_cache(_KEPT)
def _whole_period(clock: IsokineticParticle, solver: IsokineticSplitting, steps: int) -> Table:
    table = processed_table(clock, solver, steps, (0.0, clock.period))
    for leaf in table:
        leaf.flags.writeable = False
    return table


@functools.lru_cache(_KEPT)
def _smooth_grid(clock: IsokineticParticle) -> SmoothGrid:
    return SmoothGrid(clock)


def _clock_of(system: IsokineticParticle) -> IsokineticParticle:
    """The system as far as tables go: its speed and forcing alone, whatever its lanes are."""
    c, d, omega = (float(value) for value in (system.c, system.d, system.omega))
    return IsokineticParticle(0.0, c, d, omega, None, system.without)


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
