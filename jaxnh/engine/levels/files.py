"""Levels of a sweep in the folder of its tiles: the result of each but the last, which the next one is made from."""

from __future__ import annotations

from pathlib import Path

from jaxnh.engine.levels.levels import Level, level_of
from jaxnh.exceptions import DamagedError, ResultError
from jaxnh.jobs.cutting import Cutting
from jaxnh.storage.hdf5 import open_result, verify
from jaxnh.storage.merge import gather


def path_of(folder: Path, stage: Cutting) -> Path:
    """File of the result of a level."""
    return folder / f"level-{stage.level}.h5"


def is_there(folder: Path, stage: Cutting) -> bool:
    """Return whether the result of a level is there, and sound."""
    try:
        verify(path_of(folder, stage))
    except (DamagedError, ResultError):
        return False
    return True


def read(folder: Path, whole: Cutting, stage: Cutting) -> Level | None:
    """Lanes that a level computes, from the one before; data are read from its file where they are used.

    Args:
        whole: of all levels.

    Raises:
        ResultError: the level before is not there or damaged.
    """
    if stage.level < 2:
        return level_of(stage, {}, {})
    before = whole.stages()[stage.level - 2]
    tree = open_result(path_of(folder, before))
    results = {name: tree[name].to_dataset() for name in before.groups}
    of_lanes = {names[0]: gather(folder, before, names[0]) for names in before.wholes}
    return level_of(stage, results, {**results, **of_lanes})
