"""jaxnh on any flow, as a user's file gives it: a right-hand side, or T, Q and f, and nothing by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.xla_options import configure
from jaxnh.maps.build import make_return_map, scheme_of
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.systems.first_order import first_order
from jaxnh.systems.flow import Flow
from jaxnh.systems.lagrangian import lagrangian
from sweeps.peers.flows.peers_flow_cases import CASES, FlowCase, FlowScene
from sweeps.peers.particle.peers_scene import Errors, Setting, least_effort

_PERIODS = 512
_FIRST_FIELDS, _MOST_STEPS = 800.0, 20_000.0


class PlacedFlow(NamedTuple):
    """A flow of jaxnh, and where the components of its case are among its section coordinates.

    Attributes:
        flow: it.
        embed: components to section coordinates, of one lane.
        picks: numbers of the components among the section coordinates.
    """

    flow: Flow
    embed: Callable[[jax.Array], jax.Array]
    picks: tuple[int, ...]


def _governor(drive: float = 0.8) -> Mapping[str, Any]:
    """That of `configs/governor.py` at its values."""

    def T(q: Any, v: Any, t: Any) -> Any:
        return 0.5 * (v[0] ** 2 + v[1] ** 2)

    def Q(q: Any, v: Any, t: Any) -> Any:
        return drive * jnp.sin(t) + q[0] - q[0] ** 3 - 0.2 * v[0], -q[1] - 0.2 * v[1]

    def f(q: Any, v: Any, t: Any) -> Any:
        return (v[1] - 0.5 * (v[0] ** 2 - 0.5),)

    return {"T": T, "Q": Q, "f": f, "coordinates": ("x", "y"), "period": CASES["governor"].period}


def _double_pendulum(ratio: float = 1.0) -> Mapping[str, Any]:
    """Two equal arms; the lower weight is `ratio` times the upper one."""

    def T(q: Any, v: Any, t: Any) -> Any:
        return 0.5 * (1 + ratio) * v[0] ** 2 + ratio * v[0] * v[1] * jnp.cos(q[0] - q[1]) + 0.5 * ratio * v[1] ** 2

    def Q(q: Any, v: Any, t: Any) -> Any:
        return -(1 + ratio) * jnp.sin(q[0]), -ratio * jnp.sin(q[1])

    return {"T": T, "Q": Q, "coordinates": ("upper", "lower")}


def placed(case: FlowCase) -> PlacedFlow:
    """A case as jaxnh has it; lanes have its parameter of their own."""
    if case.name == "governor":
        flow = lagrangian(_governor, {"drive": case.low}, ("drive",))
        return PlacedFlow(flow, lambda y: jnp.stack([y[0], y[2], y[1], 0.5 * (y[1] ** 2 - 0.5)]), (0, 2, 1))
    if case.name == "double_pendulum":
        flow = lagrangian(_double_pendulum, {"ratio": case.low}, ("ratio",))
    else:
        flow = first_order(_definition(case), {case.parameter: case.low}, (case.parameter,))
    return PlacedFlow(flow, lambda y: y, tuple(range(len(case.start))))


def _definition(case: FlowCase) -> Callable[..., Mapping[str, Any]]:
    """Return what a user's file would return for a right-hand side."""
    force = {"sin": jnp.sin, "cos": jnp.cos}.get(case.forcing)
    names = tuple(f"y{i}" for i in range(len(case.start)))

    def system(**parameters: Any) -> Mapping[str, Any]:
        def rhs(y: Any, t: Any) -> Any:
            return case.field(jnp, y, force(t) if force else 0.0, parameters[case.parameter])

        return {"rhs": rhs, "coordinates": names, **({"period": case.period} if force else {})}

    return system


class FlowMaps:
    """Solvers on constant steps, over all devices, each tuned by the errors of its map."""

    def __init__(self, scene: FlowScene) -> None:
        configure()
        self.scene = scene
        self.placed = placed(scene.case)
        self.lanes = LaneExecutor()
        self.solvers = {s.name: s for s in scheme_of(self.placed.flow).solvers(self.placed.flow)}

    def errors(self, strobe: ReturnMap) -> Errors:
        """Errors of a map, of the kind that it is tuned by."""
        raise NotImplementedError

    def tune(self, target: float, hints: Sequence[Setting] = (), only: bool = False) -> list[Setting]:
        settings: list[Setting] = []
        for name, solver in self.solvers.items():
            found = least_effort(
                lambda steps, name=name: self.errors(self.strobe(name, steps)),
                target,
                _FIRST_FIELDS / solver.stages,
                factor=1.5,
                most=_MOST_STEPS,
                whole=True,
            )
            if found is not None:
                steps, errors = found
                settings.append(Setting("jaxnh", name, steps, f"{steps:.0f} steps", errors, (name,)))
        return settings

    def strobe(self, name: str, steps: float) -> ReturnMap:
        """The map over a period, or a unit of time."""
        return make_return_map(self.placed.flow, self.solvers[name], int(steps))

    def started(self, lanes: np.ndarray) -> tuple[Any, dict[str, np.ndarray]]:
        """Start states and parameters of lanes."""
        states = jax.vmap(lambda y: self.placed.flow.chart.state(self.placed.embed(y)))(self.scene.states[lanes])
        return jax.tree.map(np.asarray, states), {self.scene.case.parameter: self.scene.b[lanes]}


class Contestant(FlowMaps):
    """Tuned by the ends of a period."""

    def errors(self, strobe: ReturnMap) -> Errors:
        state = self.lanes(iterate, (strobe, np.int32(1)), self.started(np.arange(len(self.scene.b))))
        return self.scene.errors(self.placed.flow.chart.host_points(state)[:, self.placed.picks])

    def program(self, setting: Setting, count: int | None = None, periods: int = _PERIODS) -> Callable[[], int]:
        """Return the program, as every contestant; with a number of lanes (default: 256 a device) and of periods."""
        lanes = self.scene.timed(count or len(self.scene.values) * len(self.lanes.devices))
        strobe, start = self.strobe(setting.form, setting.knob), self.started(lanes)

        def run() -> int:
            self.lanes(iterate, (strobe, np.int32(periods)), start, periods=periods)
            return len(lanes) * periods

        return run
