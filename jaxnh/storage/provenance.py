"""Root attributes of what is written: how it was made, by which versions, and at what cost."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from jaxnh.storage.tiles import Spent


def provenance(
    *,
    title: str,
    config: str,
    config_sha256: str,
    versions: Mapping[str, str],
    solver: str,
    steps: int,
    compensated: bool,
    precision: str,
    error_estimate: float,
    spent: Spent,
    command: str = "",
    user_file: tuple[Path, str, str] | None = None,
) -> dict[str, object]:
    """Root attributes of a result.

    Args:
        versions: of the package, as "jaxnh", and of the libraries that the numbers rest on.
        command: what was run; "" for a call from Python.
        user_file: path, text and SHA-256 of the user's file that the system is from.
    """
    made = datetime.now(UTC).isoformat(timespec="seconds")
    path, text, digest = user_file or (None, "", "")
    return {
        "title": title,
        "Conventions": "CF-1.11",
        "history": f"{made} {command or 'jaxnh.run'}",
        "config": config,
        "config_sha256": config_sha256,
        "jaxnh_version": versions["jaxnh"],
        "versions": json.dumps({name: number for name, number in versions.items() if name != "jaxnh"}),
        "solver": solver,
        "steps_per_period": steps,
        "summation": "compensated" if compensated else "plain",
        "precision": precision,
        "error_estimate": error_estimate,
        "wall_seconds": spent.seconds,
        "compile_seconds": spent.compile_seconds,
        "lane_periods": spent.lane_periods,
        "device": spent.device,
        **({"system_file": text, "system_file_path": str(path), "system_file_sha256": digest} if path else {}),
    }
