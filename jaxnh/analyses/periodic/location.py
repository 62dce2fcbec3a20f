"""Location of a doubling of a batch: `bifurcations.doubling_points` on lanes, with the map in several refinements."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxnh.analyses.batch import LaneBatch, LaneRunner
from jaxnh.analyses.options.base import Options
from jaxnh.analyses.periodic.newton_on_lanes import ORBIT_TILE, images
from jaxnh.analyses.price import Price, newton_price
from jaxnh.maps.family import Maps, padded_like
from jaxnh.maps.iterate import Derivatives, section_map
from jaxnh.orbits.bifurcations.doubling_points import DoublingPoint, doubling_point, follow_branch, refine_doubling
from jaxnh.orbits.shooting import Period

REFINEMENTS = (1, 2, 4)
"""Share of the steps that the accuracy asks for, in maps that a doubling is located with."""

_SAFETY = 8.0
_ROUNDINGS = 10.0
_LEAST = 32.0  # 2ᵖ at order 5; methods that are chosen have more


class LocatedDoubling(NamedTuple):
    """A doubling of a batch, by maps with the steps that the accuracy asks for and with twice and four times as many.

    Attributes:
        refined: the doubling of each of these maps.
        roundings: of the value, that its error is at least.
    """

    refined: tuple[DoublingPoint, DoublingPoint, DoublingPoint]
    roundings: float = 0.0

    @property
    def point(self) -> DoublingPoint:
        """The doubling of the map with twice the steps."""
        return self.refined[1]

    @property
    def error(self) -> float:
        """Bound of the error of its value, by truncation of the map, interpolation and rounding.

        With steps h, h/2 and h/4 values are off by C hᵖ and so on: the second by little more than it is from the third,
        which is `_SAFETY` times that with what the leading term leaves out. The difference of the first two, the error
        of the first, is 2ᵖ of that; a `_LEAST` part of it is kept where the other two happen to agree. Where the values
        do not converge as an order has it, the bound is the sum of both differences. Roundings of the field have one
        part in common at all nodes, which no misfit shows, and where the three values agree by chance neither do they:
        by other steps a value is another one by some five of its own roundings.
        """
        first, second, third = (point.value for point in self.refined)
        coarse, fine = abs(second - first), abs(third - second)
        rounding = self.roundings * float(np.spacing(abs(second)))
        return max(min(max(_SAFETY * fine, coarse / _LEAST), coarse + fine) + self.point.error, rounding)


def locate(
    batch: LaneBatch, lanes: LaneRunner, points: Float[np.ndarray, "some d"], start: float, stop: float, n: int
) -> LocatedDoubling | None:
    """The doubling between two values of the first axis of the period-n orbit that is stable at the first.

    Args:
        points: of the orbit at the first value, in order: one or more of them.

    Returns:
        None where the orbit does not double before `stop`.
    """
    wrap = batch.chart.wrap
    coarse, fine, finest = (period_map(batch, lanes, strobe) for strobe in refined_maps(batch))
    branch = follow_branch(coarse, walk(batch, lanes, points, start, n), start, stop, wrap)
    first = branch and doubling_point(coarse, branch, wrap)
    second = first and refine_doubling(fine, first, wrap)
    third = second and refine_doubling(finest, second, wrap)
    if first is None or second is None or third is None:
        return None
    return LocatedDoubling((first, second, third), _ROUNDINGS)


def refined_maps(batch: LaneBatch) -> tuple[Maps, ...]:
    """The map with 1, 2 and 4 times the steps, all of one shape, so that they run through one program.

    Sums are compensated where they can be, whatever the accuracy needs: doublings deep in a cascade are as near to each
    other as plain sums scatter them.
    """
    exact = replace(batch, compensated=True)
    strobes = [exact.strobe(refinement) for refinement in REFINEMENTS]
    return tuple(padded_like(strobe, strobes[-1]) for strobe in strobes)


def period_map(batch: LaneBatch, lanes: LaneRunner, strobe: Maps) -> Period:
    """P and ∂P/∂u at points and values of the first axis."""

    def period(u: Float[np.ndarray, "lanes d"], values: Float[np.ndarray, " lanes"]) -> Derivatives:
        once = np.ones(len(u), np.int32)  # as in `orbits`, whose program it shares where maps have like tables
        return images(lanes, strobe, batch.at_values(values).p, once)(u, np.arange(len(u)))

    return period


def walk(
    batch: LaneBatch, lanes: LaneRunner, points: Float[np.ndarray, "some d"], value: float, n: int
) -> Float[np.ndarray, "n d"]:
    """The n points of an orbit from its first ones: all that there are go on by as many periods as they are."""
    strobe = batch.strobe()
    while len(points) < n:
        block = points[: n - len(points)]
        p = batch.at_values(np.full(len(block), value)).p
        image = lanes(section_map, (strobe, np.int32(len(points))), (block, p), tile=ORBIT_TILE)
        points = np.concatenate([points, image])
    return points


def price_of_orbits(options: Options, batch: LaneBatch) -> Price:
    """Orbits and their multipliers, at several values of a parameter, need the derivatives of a period."""
    return newton_price(batch, ORBIT_TILE)
