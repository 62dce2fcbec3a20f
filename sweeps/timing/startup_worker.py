"""One run of `jaxnh.sweep` in a process of its own, with the seconds of its parts; of whatever checkout is imported.

    python -P startup_worker.py RECORD ARGUMENTS OF jaxnh.sweep

RECORD is written as JSON: the package's folder, the exit code and the seconds. Parts are told apart where the engine
hands over: nothing within a part is slower for being timed. Nothing of jaxnh is imported at the top.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

# What the command imports on its way, whether at its top or in its body.
_MODULES = ("sweep", "cli.arguments", "cli.report", "cli.terminal", "engine.dask_workers", "engine.run")


class Clock:
    """Seconds by the name of a part."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its time added to a part."""

        def call(*arguments: Any, **options: Any) -> Any:
            began = time.perf_counter()
            try:
                return function(*arguments, **options)
            finally:
                self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began

        return call


def main() -> None:
    record, arguments = Path(sys.argv[1]), sys.argv[2:]
    began = time.perf_counter()
    modules: list[Any] = [import_module(f"jaxnh.{name}") for name in _MODULES]
    sweep, run = modules[0], modules[-1]
    imported = time.perf_counter() - began

    import jax

    clock, runners = Clock(), list[Any]()
    in_calibration = {"compiling": 0.0, "programs": 0.0, "run": 0.0}

    name = "LaneExecutor" if hasattr(run, "LaneExecutor") else "Lanes"  # of a checkout from before it was called so

    class WatchedExecutor(getattr(run, name)):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            runners.append(self)

    def spent() -> dict[str, float]:
        return {
            "compiling": clock.seconds.get("compiling", 0.0),
            "programs": sum(getattr(one, "accounts", one).compile_seconds for one in runners),
            "run": sum(getattr(one, "accounts", one).run_seconds for one in runners),
        }

    def decide(*arguments: Any, **options: Any) -> Any:
        before = spent()
        try:
            return plain(*arguments, **options)
        finally:
            in_calibration.update({key: value - before[key] for key, value in spent().items()})

    plain = run.decide
    setattr(run, name, WatchedExecutor)
    run.decide = clock.timed("calibration", decide)
    run.merge = clock.timed("writing", run.merge)
    jax.stages.Lowered.compile = clock.timed("compiling", jax.stages.Lowered.compile)  # pyright: ignore[reportAttributeAccessIssue]
    sys.argv = ["jaxnh.sweep", *arguments]
    code = sweep.main()
    outside = {key: value - in_calibration[key] for key, value in spent().items()}
    seconds = {
        "import": imported,
        "calibration": clock.seconds.get("calibration", 0.0),
        "tracing": outside["programs"] - outside["compiling"],
        "compiling": outside["compiling"],
        "run": outside["run"],
        "writing": clock.seconds.get("writing", 0.0),
    }
    package = str(Path(str(import_module("jaxnh").__file__)).parent)
    record.write_text(json.dumps({"package": package, "code": code, "seconds": seconds}), encoding="utf-8")


if __name__ == "__main__":
    main()
