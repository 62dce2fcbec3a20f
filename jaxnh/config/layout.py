"""Which block stands at which key of a config, so that a fault is told in the words of the block that has it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel

from jaxnh.config.blocks import Accuracy, Analyses, EvenGrid, Levels, PublishedValues, ValueGrid
from jaxnh.config.messages import Layout
from jaxnh.config.options import OPTIONS
from jaxnh.config.particle import ConstantSpeed, DisturbedSpeed, Free, Initial, PoincareSection, Sweep
from jaxnh.config.user_system import UserInitial, UserSection, UserSweep, UserSystem
from jaxnh.config.yaml_tree import KeyPath

_GRIDS: Mapping[str, type[BaseModel]] = {"start, stop, count": EvenGrid, "values": ValueGrid}
_SHARED: Mapping[KeyPath, type[BaseModel]] = {
    ("accuracy",): Accuracy,
    ("analyses",): Analyses,
    ("levels",): Levels,
    **{("analyses", name): options for name, options in OPTIONS.items()},
    **{("compare", name): PublishedValues for name in OPTIONS},
}
_SYSTEMS: Mapping[str, type[BaseModel]] = {
    "constant_speed": ConstantSpeed,
    "disturbed_speed": DisturbedSpeed,
    "free": Free,
}


def layout(whole: type[BaseModel], axes: Iterable[str]) -> Layout:
    """Of a config of the particle, whose sweep may have these axes."""
    blocks = {**_SHARED, (): whole, ("initial",): Initial, ("sweep",): Sweep, ("section",): PoincareSection}
    grids = _grids(axes)
    selectors = {("system",): "constraint", **dict.fromkeys(grids, "values")}
    return Layout(blocks, {("system",): _SYSTEMS, **grids}, selectors)


def user_layout(whole: type[BaseModel], axes: Iterable[str]) -> Layout:
    """Of a config of a user's system, whose sweep has these axes."""
    blocks = {**_SHARED, (): whole, ("system",): UserSystem, ("initial",): UserInitial, ("sweep",): UserSweep}
    blocks[("section",)] = UserSection
    grids = _grids(axes)
    return Layout(blocks, grids, dict.fromkeys(grids, "values"))


def _grids(axes: Iterable[str]) -> dict[KeyPath, Any]:
    return {("sweep", name): _GRIDS for name in axes}
