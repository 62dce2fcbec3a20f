"""Processes that hold one contestant each, stay alive, and work only when told to.

XLA's options hold for a whole process, so contestants need their own; told one after another, they never overlap.
"""

from __future__ import annotations

import importlib
import math
import multiprocessing
import os
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from sweeps.peers.particle.peers_scene import Contestant, Setting, Truth

_TRIAL_SECONDS = 0.6  # processor time of the trial by which the forms of one peer are compared
_MOST_TRIALS = 4
_SPAWN = multiprocessing.get_context("spawn")
# What would make a stock installation something else; jaxnh's `configure` sets its own.
_UNSET = ("XLA_FLAGS", "EQX_ON_ERROR", "JAX_NUM_CPU_DEVICES")


class Sample(NamedTuple):
    """One timed sample: lane-periods a second of wall time, and a second of processor time."""

    rate: float
    processor_rate: float


class Peer:
    """A contestant in one process pinned to all the cores, or in one process a core, each with all the lanes."""

    def __init__(self, kind: str, scene: Truth, cores: Sequence[Sequence[int]]) -> None:
        self.kind = kind
        self._connections: list[Any] = []  # ends of pipes, whose type differs between platforms
        self._processes = []
        for share in cores:
            here, there = _SPAWN.Pipe()
            process = _SPAWN.Process(target=_serve, args=(there, kind, scene, tuple(share)), daemon=True)
            process.start()
            there.close()
            self._connections.append(here)
            self._processes.append(process)

    def enter(self, scene: Truth) -> None:
        """Go on with another scene."""
        _ask(self._connections, "enter", self.kind, scene)

    def tune(self, target: float, hints: Sequence[Setting] = (), only: bool = False) -> list[Setting]:
        """The contestant's settings for a target, each with the rate of a short trial."""
        return _ask(self._connections[:1], "tune", target, tuple(hints), only)[0]

    def sample(self, setting: Setting, seconds: float, **program: Any) -> Sample:
        """One timed sample of at least so many seconds, summed over the processes, which run at the same time."""
        samples = _ask(self._connections, "sample", setting, seconds, program)
        processor = sum(s.processor_rate for s in samples) / len(samples)
        return Sample(sum(s.rate for s in samples), processor)

    def close(self) -> None:
        """End the processes."""
        for connection, process in zip(self._connections, self._processes, strict=True):
            connection.close()
            process.join()


def _ask(connections: Sequence[Any], task: str, *args: Any) -> list[Any]:
    for connection in connections:
        connection.send((task, args))
    replies = []
    for connection in connections:
        try:
            done, reply = connection.recv()
        except EOFError:
            raise RuntimeError(f"a process of the study ended while it was asked to {task}") from None
        if not done:
            raise RuntimeError(reply)
        replies.append(reply)
    return replies


def module(kind: str) -> str:
    """The module that holds the contestant of a kind; those on users' flows are of kinds `flow_...`."""
    return f"sweeps.peers.{'flows' if kind.startswith('flow_') else 'particle'}.peers_{kind}"


def _serve(connection: Any, kind: str, scene: Truth, cores: tuple[int, ...]) -> None:
    """Body of a process."""
    os.sched_setaffinity(0, cores)
    for name in _UNSET:
        os.environ.pop(name, None)
    os.environ["JAX_PLATFORMS"] = "cpu"
    desk: _Desk | None = None
    while True:
        try:
            task, args = connection.recv()
        except EOFError:
            return
        try:
            if task == "enter":
                desk = _Desk(*args)
                connection.send((True, None))
                continue
            desk = desk or _Desk(kind, scene)
            connection.send((True, desk.tune(*args) if task == "tune" else desk.sample(*args)))
        except (Exception, SystemExit):
            connection.send((False, traceback.format_exc()))


class _Desk:
    """Answers of a process; programs are kept, warmed up."""

    def __init__(self, kind: str, scene: Truth) -> None:
        self._contestant: Contestant = importlib.import_module(module(kind)).Contestant(scene)
        self._programs: dict[Any, Callable[[], float]] = {}

    def tune(self, target: float, hints: Sequence[Setting], only: bool) -> list[Setting]:
        return [replace(s, rate=self._trial(s)) for s in self._contestant.tune(target, hints, only)]

    def sample(self, setting: Setting, seconds: float, program: dict[str, Any]) -> Sample:
        run = self._warm(setting, program)
        done = 0.0
        began, processor = time.perf_counter(), time.process_time()
        while time.perf_counter() < began + seconds or not done:
            done += run()
        return Sample(done / (time.perf_counter() - began), done / (time.process_time() - processor))

    def _warm(self, setting: Setting, program: dict[str, Any]) -> Callable[[], float]:
        key = (setting, tuple(program.items()))
        if key not in self._programs:
            self._programs[key] = self._contestant.program(setting, **program)
            self._programs[key]()
        return self._programs[key]

    def _trial(self, setting: Setting) -> float:
        """Lane-periods a second of processor time in the best of a few runs; the first is not counted."""
        run = self._contestant.program(setting)
        run()
        fastest, spent = math.inf, 0.0
        for _ in range(_MOST_TRIALS):
            began = time.process_time()
            done = run()
            seconds = time.process_time() - began
            fastest, spent = min(fastest, seconds / done), spent + seconds
            if spent > _TRIAL_SECONDS:
                break
        return 1 / fastest
