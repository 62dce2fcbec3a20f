"""The block at each key of a config, so that a fault is told in the words of the block that has it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, get_args

from pydantic import BaseModel

from jaxnh.analyses.options import OPTIONS
from jaxnh.config.blocks import EvenGrid, PublishedValues, ValueGrid
from jaxnh.config.messages import Layout
from jaxnh.config.yaml_tree import KeyPath


def layout(whole: type[BaseModel], axes: Iterable[str]) -> Layout:
    """Blocks of a config whose sweep may have these axes."""
    blocks: dict[KeyPath, type[BaseModel]] = {(): whole}
    blocks |= {("analyses", name): options for name, options in OPTIONS.items()}
    blocks |= {("compare", name): PublishedValues for name in OPTIONS}
    grids = {"start, stop, count": EvenGrid, "values": ValueGrid}
    variants: dict[KeyPath, Any] = {("sweep", name): grids for name in axes}
    selectors = dict.fromkeys(variants, "values")
    for name, field in whole.model_fields.items():
        models = _blocks(field.annotation)
        if isinstance(field.discriminator, str):
            tag = field.discriminator
            variants[name,] = {get_args(model.model_fields[tag].annotation)[0]: model for model in models}
            selectors[name,] = tag
        elif models:
            blocks[name,] = models[0]
    return Layout(blocks, variants, selectors)


def _blocks(annotation: Any) -> list[type[BaseModel]]:
    kinds = (annotation, *get_args(annotation))
    return [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
