"""The maps between orthonormalisations: a period of the flow in equal parts, stacked."""

from __future__ import annotations

import functools

import jax
import numpy as np
from jax.typing import ArrayLike

from jaxnh.analyses.batch import LaneBatch
from jaxnh.maps.build import cut_strobe, prepare_tables
from jaxnh.maps.family import Maps
from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.single_precision import in_precision
from jaxnh.solvers import AdaptiveMethod


def period_parts(batch: LaneBatch, parts: int, refinement: int = 1) -> Maps:
    """Return the stacked maps between orthonormalisations, `parts` a period, with `refinement` times the steps."""
    if batch.family is not None:
        return batch.family.maps(
            batch.system,
            (parts, refinement),
            lambda system: cut_period(batch.with_system(system), parts, refinement),
            lambda systems: prepare_tables(systems, batch.solver, refinement * batch.steps, parts),
        )
    return cut_period(batch, parts, refinement)


def cut_period(batch: LaneBatch, parts: int, refinement: int = 1) -> ReturnMap:
    """Return the stacked maps between orthonormalisations for lanes with one system."""
    solver, steps = batch.solver, refinement * batch.steps
    if isinstance(solver, AdaptiveMethod):
        solver = solver.with_least(refinement * solver.least)
    strobe = cut_strobe(batch.flow, solver, steps, parts, compensated=batch.compensated)
    return in_precision(strobe, batch.precision)


def split_stack(strobes: ReturnMap, roomy: ReturnMap) -> list[ReturnMap]:
    """Split a stack into stacks of one map, padded like those of `roomy`, so that one program serves both."""

    def row(leaf: ArrayLike, like: ArrayLike, k: int) -> np.ndarray:
        part = np.asarray(leaf)[k : k + 1]
        more = [(0, full - own) for full, own in zip(np.shape(like), part.shape, strict=True)]
        return np.pad(part, more, mode="edge")

    count = len(np.asarray(jax.tree.leaves(strobes)[0]))
    return [jax.tree.map(functools.partial(row, k=k), strobes, roomy) for k in range(count)]


def one_part(strobes: Maps) -> tuple[Maps, int]:
    """Return the parts of a period, equal without a clock, as one, and their number: one program serves any."""
    if not isinstance(strobes, ReturnMap) or not strobes.system.autonomous:
        return strobes, 1
    parts = len(np.asarray(jax.tree.leaves(strobes)[0]))
    # Of one part it is the same object, of which programs are at hand.
    return strobes if parts == 1 else first_part(strobes), parts


def first_part(stack: ReturnMap) -> ReturnMap:
    """Return the first map of a stack, as a stack of one."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:1], stack)
