"""jaxnh as a contestant, as its users have it: `LaneExecutor` with `configure`, every splitting tried, fewest kicks
win."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.xla_options import configure
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.maps.protocol import ReturnMap
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import State, disturbed_speed
from sweeps.peers.particle.peers_scene import PERIODS, Errors, Scene, Setting, least_effort

_FIRST_GUESS = 1500  # kicks a period
_MOST_KICKS = 20000
_HOPELESS = 3.0  # times the fewest kicks so far: not followed any further


SceneT = TypeVar("SceneT", bound=Scene)


class Splittings(Generic[SceneT]):
    """All splittings on constant steps, over all devices, each tuned by the errors of its map."""

    def __init__(self, scene: SceneT) -> None:
        configure()
        self.scene = scene
        self.system = disturbed_speed(scene.a, scene.c, scene.d)
        self.lanes = LaneExecutor()

    def errors(self, strobe: ReturnMap) -> Errors:
        """Errors of a map, of the kind that it is tuned by."""
        raise NotImplementedError

    def tune(self, target: float, hints: Sequence[Setting] = (), only: bool = False) -> list[Setting]:
        settings: list[Setting] = []
        fewest = float(_MOST_KICKS)
        for name, solver in sorted(SPLITTINGS.items(), key=lambda item: -item[1].convergence_order):

            def measure(steps: float, name: str = name) -> Errors:
                return self.errors(make_return_map(self.system, SPLITTINGS[name], int(steps)))

            guess = max(2.0, min(_FIRST_GUESS, fewest) / solver.stages)
            most = max(2.0, min(_MOST_KICKS, _HOPELESS * fewest) / solver.stages)
            found = least_effort(measure, target, guess, factor=1.5, most=most, whole=True)
            if found is None:
                continue
            steps, errors = found
            kicks = solver.total_kicks(int(steps))
            fewest = min(fewest, kicks)
            label = f"{steps:.0f} steps, {kicks} kicks a period"
            settings.append(Setting("jaxnh", name, steps, label, errors, (name,), kicks))
        return settings


class Contestant(Splittings[Scene]):
    """Tuned by the ends of a period."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._one_device = LaneExecutor(devices=self.lanes.devices[:1])

    def errors(self, strobe: ReturnMap) -> Errors:
        (x, y), (n1, n2) = self._iterate(self.lanes, strobe, np.arange(len(self.scene.b)), 1)
        return self.scene.errors(np.stack([x, y, n1, n2], axis=-1))

    def program(
        self, setting: Setting, count: int | None = None, periods: int = PERIODS, one_device: bool = False
    ) -> Callable[[], int]:
        """Return the program, as every contestant; with a number of lanes (default: 256 a device), or on one device."""
        pool = self._one_device if one_device else self.lanes
        lanes = self.scene.timed(count or len(self.scene.values) * len(pool.devices))
        strobe = make_return_map(self.system, SPLITTINGS[setting.form], int(setting.knob))

        def run() -> int:
            self._iterate(pool, strobe, lanes, periods)
            return len(lanes) * periods

        return run

    def _iterate(self, pool: LaneExecutor, strobe: ReturnMap, lanes: np.ndarray, periods: int) -> State:
        x, y, n1, n2 = self.scene.unit_states[lanes].T
        start = ((x, y), (n1, n2)), {"b": self.scene.b[lanes]}
        return pool(iterate, (strobe, np.int32(periods)), start, periods=periods)
