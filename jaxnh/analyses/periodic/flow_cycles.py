"""Cycles of the flow of a batch, for collocation: its field, and first paths from points on a section or at strobes."""

from __future__ import annotations

from collections.abc import Mapping

import jax
import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.section_points import states_at
from jaxnh.maps.build import make_parts, make_return_map
from jaxnh.maps.section import Section, System
from jaxnh.orbits.collocation.equations import FieldValues, Problem
from jaxnh.orbits.collocation.fields import point_rates, timed_rates
from jaxnh.orbits.collocation.paths import PiecewisePath, path_through, values_at
from jaxnh.systems.flow import Flow
from jaxnh.systems.piecewise_smooth import PiecewiseSmooth
from jaxnh.systems.state import State
from jaxnh.systems.switched_mechanics import SwitchedMechanics

_SAMPLES = 64  # of a return
_INTERVALS = 20  # of the mesh, a return
_STILL = 1e-5  # of the size of motions: Newton leaves orbits changes below, of coordinates that stay where they are
_LEAST = 0.1  # of that size, that a cycle is measured in
_CORNER = 0.1  # of the size: states further apart have others between them
_FINER = 16  # parts of what is between them
_LEVELS = 4
_TILE = 8
_LOOKED_AT = 8  # places of an interval where the sign of the height is looked at
_ROUNDING = 1e-16  # of the duration
_POINTS, _FEW = 512, 8  # of paths and of equilibria, a tile


def no_collocation(flow: Flow) -> str:
    """Return why cycles and equilibria of a system are no isolated solutions of a smooth field; "" where they are."""
    if not flow.continuous:
        return "collocation is of flows, and this is a map"
    if isinstance(flow, PiecewiseSmooth | SwitchedMechanics):
        return "collocation is of smooth motions, without jumps or switches"
    if flow.chart.dimension > flow.exponents:
        return "cycles and equilibria of a flow with constraints are not isolated"
    return ""


def flow_problem(
    batch: LaneBatch,
    lanes: LaneRunner,
    size: Float[np.ndarray, " d"],
    names: tuple[str, ...],
    widths: np.ndarray,
    timed: bool = False,
) -> Problem:
    """The flow of a batch over parameters that lanes may have of their own, for collocation.

    Args:
        batch: lanes of one system.
        lanes: runs lanes.
        size: of the motion in each coordinate.
        names: of the parameters.
        widths: of their ranges.
        timed: whether the time when paths begin is a parameter before these.
    """
    rates = timed_rates if timed else point_rates

    def field(
        y: Float[np.ndarray, "points d"], t: Float[np.ndarray, " points"], values: Float[np.ndarray, "points q"]
    ) -> FieldValues:
        p = batch.parameters_at(names, values[:, int(timed) :])
        t, tile = t + values[:, 0] if timed else t, _POINTS if len(y) > _FEW else _FEW
        known = lanes(rates, (batch.flow,), (y, t, p), tile=tile, static=(names,))
        return FieldValues(*map(np.asarray, known))

    return Problem(field, size, widths, not batch.flow.autonomous)


def cycle_guess(
    batch: LaneBatch, lanes: LaneRunner, points: Float[np.ndarray, "n d"]
) -> tuple[PiecewisePath, float] | None:
    """The path of an orbit and its duration; None of one that does not come back.

    Args:
        batch: of one lane.
        lanes: runs lanes.
        points: of the orbit on the section, or at strobes; the first one is where it begins.
    """
    times, states = _times_and_states(batch, lanes, points)
    if np.isfinite(states).all() and times[-1] > 0.0:
        return path_through(times, states, _INTERVALS * len(points))
    return None


def cycle_size(system: System, path: PiecewisePath, unit: Float[np.ndarray, " e"]) -> Float[np.ndarray, " d"]:
    """Half the extent of a path of one lane in each coordinate; of one that stays where it is the size of motions.

    The path of a small cycle, as at a Hopf point, is the beginning of a branch of larger ones: its extent is taken as
    many times as makes it a share of the size of motions in the coordinate in which it is the largest.

    Args:
        system: of the path.
        path: of a cycle.
        unit: size of motions in each section coordinate.
    """
    whole = np.insert(unit, system.number, 0.0) if isinstance(system, Section) else unit
    extent = 0.5 * np.ptp(path.ends[0], axis=0)
    moves = extent > _STILL * whole
    shares = extent[moves] / (_LEAST * np.where(whole[moves] > 0.0, whole[moves], np.inf))
    largest = np.max(shares, initial=0.0)
    size = np.where(moves, extent / largest if 0.0 < largest < 1.0 else extent, whole)
    return np.where(size > 0.0, size, size.max() or 1.0)


def path_lift(flow: Flow, path: PiecewisePath) -> Float[np.ndarray, " d"]:
    """Whole turns of angles from the beginning of a path of one lane to its end."""
    turns = np.round((path.ends[0, -1] - path.ends[0, 0]) / (2 * np.pi))
    return np.where(flow.chart.angles, 2 * np.pi * turns, 0.0)


def duration_of(batch: LaneBatch, lanes: LaneRunner, points: Float[np.ndarray, "n d"]) -> float:
    """Time that the orbit of a batch of one lane takes, by its points."""
    if not batch.on_section:
        return len(points) * batch.flow.period
    start = (states_at(batch, lanes, points[:1]), dict(batch.p))
    return float(np.asarray(lanes.iterate(batch.strobe(), len(points), start, tile=_TILE).t)[0])


def _times_and_states(
    batch: LaneBatch, lanes: LaneRunner, points: Float[np.ndarray, "n d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k e"]]:
    """Times and states around an orbit, close together where it turns; all coordinates of the flow."""
    n, p, flow = len(points), dict(batch.p), batch.without_section()
    state, duration = states_at(batch, lanes, points[:1]), duration_of(batch, lanes, points)
    if batch.on_section:
        state = state.state
    if not np.isfinite(duration) or duration <= 0.0:
        return np.zeros(1), np.zeros((1, batch.flow.chart.dimension))
    if not batch.flow.autonomous:
        path = _through_periods(flow, lanes, state, p, n)
        return np.linspace(0.0, duration, len(path)), path
    step, count = duration / (n * _SAMPLES), n * _SAMPLES
    states = np.concatenate([flow.chart.host_points(state), _record(flow, lanes, state, p, step, count)[0]])
    return _with_corners(flow, lanes, p, np.linspace(0.0, duration, count + 1), states)


def _with_corners(
    flow: LaneBatch, lanes: LaneRunner, p: Mapping[str, np.ndarray], times: np.ndarray, states: np.ndarray
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k d"]]:
    """States at even times with others between them where they are far apart, and so on."""
    size, step = np.maximum(np.ptp(states, axis=0), np.finfo(float).tiny), times[1] - times[0]
    for _ in range(_LEVELS):
        jump = np.linalg.norm(np.diff(states, axis=0) / size, axis=1)
        wide = np.flatnonzero((jump > _CORNER) & (np.diff(times) > 0.5 * step))
        if not len(wide):
            break
        step /= _FINER
        many = {name: np.repeat(value, len(wide)) for name, value in p.items()}
        between = _record(flow, lanes, states_at(flow, lanes, states[wide], _TILE), many, step, _FINER - 1)
        more = times[wide][:, None] + step * np.arange(1, _FINER)
        times = np.concatenate([times, more.ravel()])
        order = np.argsort(times, kind="stable")
        states = np.concatenate([states, between.reshape(-1, states.shape[1])])[order]
        times = times[order]
    return times, states


def _record(
    flow: LaneBatch, lanes: LaneRunner, state: State, p: Mapping[str, np.ndarray], step: float, count: int
) -> Float[np.ndarray, "lanes count d"]:
    """States of lanes after 1, 2, … steps of time, without a clock."""
    moved = make_return_map(flow.flow, flow.solver, flow.steps, compensated=flow.compensated, span=(0.0, step))
    return flow.chart.host_points(lanes.record(moved, count, (state, dict(p)), tile=_TILE))


def _through_periods(
    batch: LaneBatch, lanes: LaneRunner, state: State, p: Mapping[str, np.ndarray], n: int
) -> Float[np.ndarray, "k d"]:
    """States of one lane at even times over n periods of a clock."""
    parts = make_parts(batch.flow, batch.solver, batch.steps, _SAMPLES, compensated=batch.compensated)
    maps = [jax.tree.map(lambda leaf, k=k: leaf[k], parts) for k in range(_SAMPLES)]
    path = [batch.chart.host_points(state)]
    for _ in range(n):
        for part in maps:
            state = lanes.iterate(part, 1, (state, dict(p)), tile=_TILE)
            path.append(batch.chart.host_points(state))
    return np.concatenate(path)


def section_normal(section: Section) -> Float[np.ndarray, " d"]:
    """Weights of the coordinates in the height above the value of a section."""
    weights = np.eye(section.flow.chart.dimension)[section.number]
    if section.normal is not None:
        weights[: len(section.normal)] = section.normal
    return weights


def passages(section: Section, path: PiecewisePath) -> Float[np.ndarray, " k"]:
    """Places of the path of a cycle where it passes a section in its direction.

    One that begins on the section ends there as well, and on which side is rounding: it passes the section once.
    """
    shares = np.arange(_LOOKED_AT) / _LOOKED_AT
    places = np.append((path.mesh[0, :-1, None] + path.steps[0][:, None] * shares).ravel(), 1.0)
    heights = section_heights(section, values_at(path, places[None])[0])
    heights[-1] = heights[0]
    up, down = (heights[:-1] <= 0.0) & (heights[1:] > 0.0), (heights[:-1] >= 0.0) & (heights[1:] < 0.0)
    wanted = {"up": up, "down": down, "both": up | down}[section.direction]
    jumps = np.abs(np.diff(heights)) > 0.5 * (section.turn or np.inf)
    ends = zip(places[:-1][wanted & ~jumps], places[1:][wanted & ~jumps], strict=True)

    def height(place: float) -> float:
        return float(section_heights(section, values_at(path, np.array([[place]]))[0])[0])

    def place_between(low: float, high: float) -> float:
        if height(low) * height(high) > 0.0:
            return high
        return float(np.asarray(brentq(height, low, high, xtol=_ROUNDING)))

    return np.array([place_between(low, high) for low, high in ends])


def section_heights(section: Section, states: Float[np.ndarray, "k d"]) -> Float[np.ndarray, " k"]:
    """Heights of states above the value of the section, whichever way it is passed."""
    heights = states @ section_normal(section) - section.value
    return heights - section.turn * np.round(heights / section.turn) if section.turn else heights
