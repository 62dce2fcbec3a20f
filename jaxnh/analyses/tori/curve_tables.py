"""Invariant curves of a batch as variables: their rotation numbers, what is normal to them, their points."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Float

from jaxnh.analyses.base import Entry, flag, number_variable, variable
from jaxnh.analyses.batch import LaneBatch, LaneRunner, iterate_units
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE
from jaxnh.analyses.section_points import states_at
from jaxnh.analyses.tori.invariant_curves import CurveQuality, InvariantCurve
from jaxnh.analyses.tori.normal_growth import normal_growth
from jaxnh.analyses.trajectories.states import state_variables

KINDS = ("attracting", "saddle", "repelling", "neutral", "undecided", "none", "failed")
"""Meanings of the flags 0 to 6 of `kind`."""

NONE = KINDS.index("none")

_GROWTH_POINTS = 2048  # of the orbit along a curve that growth normal to it is averaged over
_NEUTRAL = 1e-6  # largest error of a growth that is called zero
_ONE = {"periods": "period", "iterates": "iterate", "crossings": "crossing"}


class CurveTable:
    """Numbers of invariant curves, each at its place in an array; what has no curve is NaN.

    Args:
        shape: of the array.
        points: of each curve that are kept.
        batch: whose map the curves are of.

    Attributes:
        kind: numbers in `KINDS`, of the array's shape.
    """

    def __init__(self, shape: tuple[int, ...], points: int, batch: LaneBatch) -> None:
        self._k, self._batch = _directions(batch), batch
        self._theta = np.linspace(0.0, 1.0, points)
        self._rotation, self._error, self._residual, self._decay = (np.full(shape, np.nan) for _ in range(4))
        self._growth, self._growth_error = (np.full((*shape, self._k - 1), np.nan) for _ in range(2))
        self._harmonics, self.kind = np.zeros(shape, np.int32), np.full(shape, NONE)
        self._points = np.full((*shape, points, batch.chart.dimension), np.nan)

    def put(self, place: tuple[int, ...], curve: InvariantCurve, quality: CurveQuality, iterates: int = 1) -> None:
        """Enter a curve that so many iterates of the map carry to itself."""
        self._rotation[place], self._error[place] = curve.rotation, quality.rotation_error
        self._residual[place], self._decay[place] = quality.residual, quality.decay
        self._harmonics[place], self._points[place] = curve.harmonics, curve.at(self._theta)
        error = iterates * self._batch.error_estimate
        growth, missed = normal_growth(curve, quality, self._k, _GROWTH_POINTS, error)
        self._growth[place], self._growth_error[place] = growth, missed
        self.kind[place] = KINDS.index(_kind(growth, missed + quality.rotation_error))

    def numbers(self, dims: tuple[str, ...], unit: str = "") -> dict[str, Entry]:
        """All numbers over these dimensions; turns are counted in iterates, or in another unit."""
        unit = unit or _ONE.get(iterate_units(self._batch.system), "unit of time")
        turns, rates, normal = {"counted_in": f"turns per {unit}"}, {"counted_in": f"1/{unit}"}, (*dims, "normal")
        decay = "rate of decay of Fourier coefficients, the half-width of the strip of analyticity"
        residual = "largest distance of the image of the curve from it, in sizes of the curve"
        return {
            "normal": variable("normal", np.arange(1, self._k), "direction normal to the curve, largest growth first"),
            "kind": flag(dims, self.kind, "the invariant curve, by what is normal to it", KINDS),
            "rotation": variable(dims, self._rotation, "rotation number on the curve", **turns),
            "rotation_error": variable(dims, self._error, "error of the rotation number", **turns),
            "growth": variable(normal, self._growth, "growth of the logarithm of lengths normal to the curve", **rates),
            "growth_error": variable(normal, self._growth_error, "error of the growth", **rates),
            "decay": variable(dims, self._decay, decay, "rad"),
            "harmonics": number_variable(dims, self._harmonics, "harmonics of the curve", ("none",)),
            "residual": variable(dims, self._residual, residual),
        }

    def coordinates(self, lanes: LaneRunner, dims: tuple[str, ...]) -> dict[str, Entry]:
        """Coordinates and velocities along the curves, over these dimensions and `theta`."""
        dims = (*dims, "theta")
        flat = self._points.reshape(-1, self._points.shape[-1])
        states = states_at(self._batch, lanes, flat if len(flat) else np.zeros((1, flat.shape[1])), ORBIT_TILE)
        states = jax.tree.map(lambda leaf: np.reshape(leaf[: len(flat)], self._points.shape[:-1]), states)
        variables = state_variables(self._batch.system, states, np.zeros(1), dims)
        along = {name: entry for name, entry in variables.items() if entry[0] == dims and name != "t"}
        return {"theta": variable("theta", self._theta, "place along the curve in turns, both ends the same")} | along


def _directions(batch: LaneBatch) -> int:
    """Exponents of motions on a curve of the map: those of the flow, on a section but for the one along it."""
    return batch.flow.exponents - int(batch.flow.autonomous and batch.on_section)


def _kind(growth: Float[np.ndarray, " k-1"], error: Float[np.ndarray, " k-1"]) -> str:
    if np.all(growth + error < 0):
        return "attracting"
    if np.all(growth - error > 0):
        return "repelling"
    if np.all(np.abs(growth) > error):
        return "saddle"
    return "neutral" if np.max(error[np.abs(growth) <= error]) < _NEUTRAL else "undecided"
