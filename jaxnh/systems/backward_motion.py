"""Piecewise smooth motions back in time: ẏ = −f(y, t₀ − t), its walls and surfaces those of f.

Steps that end at events meet them on the way back as well. At a wall that the flow has come to, a jump is undone; where
the flow passes it the other way, nothing is. Of jumps at one time the last is undone first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxnh.systems.chart import Chart
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.piecewise_smooth import PiecewisePoint, PiecewiseSmooth
from jaxnh.systems.state import Number


class BackwardMotion(PiecewiseSmooth):
    """A flow back in time; made by `backward_motion`.

    Attributes:
        forward: the flow.
        instant: time t₀ of the flow at which this begins.
    """

    forward: PiecewiseSmooth
    instant: Number

    def with_parameters(self, values: Parameters) -> BackwardMotion:
        """Return the motion with other values of some of the flow's own parameters."""
        return dataclasses.replace(self, values={**self.values, **values}, forward=self.forward.with_parameters(values))

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of a start state."""
        return self.forward.coordinates

    @property
    def exponents(self) -> int:
        """Number of Lyapunov exponents."""
        return self.forward.exponents

    @property
    def chart(self) -> Chart:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Section coordinates of the flow."""
        return self.forward.chart

    @property
    def many_surfaces(self) -> bool:
        """Return whether steps treat heights as one vector."""
        return self.forward.many_surfaces

    @property
    def constrained(self) -> bool:
        """Return whether states are brought back to constraints after each step."""
        return self.forward.constrained

    def heights(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...] | None = None
    ) -> tuple[Number, ...]:
        """Heights above the walls of the states before jumps, the last wall first, and above the surfaces."""
        heights = self.forward.heights_before_jumps(self.instant - t, y, p, sides and self._forward_order(sides))
        return self._forward_order(heights)

    def branch(self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]) -> PiecewisePoint:
        """Time derivative of a state by a branch of the field."""
        rates = self.forward.branch(self.instant - t, y, p, self._forward_order(sides))
        return jax.tree.map(lambda rate: -rate, rates)

    def on_constraints(
        self, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state brought back to the constraints."""
        return self.forward.on_constraints(self.instant - t, y, p, self._forward_order(sides))

    def _forward_order(self, each: tuple[Any, ...]) -> tuple[Any, ...]:
        """Numbers of walls and surfaces in the order of the flow, or back: walls from last to first."""
        walls = len(self.jumps)
        return *each[:walls][::-1], *each[walls:]

    @property
    def arrives_at_ends(self) -> bool:
        """Return false: a jump at the end of the stretch forward, where this begins, is undone, and no other."""
        return False

    def jumped(
        self, number: int, t: ArrayLike, y: PiecewisePoint, p: Parameters, sides: tuple[Number, ...]
    ) -> PiecewisePoint:
        """The state before a jump of the flow; as it is where the flow passes the wall the way that is no jump."""
        now, number, sides = self.instant - t, len(self.jumps) - 1 - number, self._forward_order(sides)
        before = self.forward.before_jump(number, now, y, p, sides)
        if self.forward.jumps[number] == "both":
            return before
        moving = self.forward.rhs(now, before, p)
        _, rate = jax.jvp(
            lambda z, t: self.forward.heights(t, z, p)[number], (before, now), (moving, jnp.ones_like(now))
        )
        return jax.tree.map(lambda b, x: jnp.where(rate > 0.0, b, x), before, y)


def backward_motion(flow: PiecewiseSmooth, instant: float) -> BackwardMotion:
    """The motions of a flow, which is invertible, back in time from an instant of its clock on."""
    parts: dict[str, Any] = {field.name: getattr(flow, field.name) for field in dataclasses.fields(PiecewiseSmooth)}
    return BackwardMotion(**{**parts, "jumps": ("both",) * len(flow.jumps)}, forward=flow, instant=instant)


def check_invertible(flow: Flow) -> None:
    """Check that motions are known to come from one state each.

    Raises:
        TypeError: different ones become one where they stick, rest or meet a constraint, or where a jump came from is
            not known.
    """
    if not isinstance(flow, PiecewiseSmooth):
        return
    if flow.holding or any(flow.begins):
        raise TypeError("motions that stick, rest or meet constraints, where several become one, have no way back")
    if flow.loses_rank or not flow.has_linear_jumps:
        raise TypeError(
            "where a motion came from is not known of jumps that are not linear in the state or take several states to "
            "one, and in mechanics of those by then"
        )


def check_jumps(flow: Flow, p: Mapping[str, Float[np.ndarray, " lanes"]]) -> None:
    """Check that jumps, which are linear, take no two motions to one in any lane.

    Args:
        flow: whose motions are followed back.
        p: parameters of lanes.

    Raises:
        TypeError: derivatives of a jump are singular, as of an impact whose restitution is zero.
    """
    if not isinstance(flow, PiecewiseSmooth) or not flow.jumps:
        return
    for slopes in jax.vmap(flow.jump_slopes)(dict(p)) if p else flow.jump_slopes({}):
        each = np.asarray(slopes)
        each = each[np.isfinite(each).all(axis=(-2, -1))]
        if np.any(np.linalg.matrix_rank(each) < each.shape[-1]):
            raise TypeError(
                "a jump takes several motions to one in a lane, as an impact of restitution zero does, "
                "and there is no way back"
            )
