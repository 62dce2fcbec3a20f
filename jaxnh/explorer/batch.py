"""A view as the config of a batch job, and the configs that a view is computed by. Nothing is computed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxnh.config.values import Content, with_values, without_values
from jaxnh.config.yaml_source import from_dict, from_text
from jaxnh.engine.experiment import Experiment
from jaxnh.explorer.view import View


def content_of(experiment: Experiment) -> dict[str, Any]:
    """Return the content of the config of an experiment."""
    return dict(from_text(experiment.text).data)


def with_sweep(content: Content, grids: Mapping[str, Any], analyses: Mapping[str, Any]) -> dict[str, Any]:
    """A config with other axes and analyses, without the keys that belong to the old ones.

    Args:
        grids: name to start, stop and count, or values.
    """
    config = {key: value for key, value in content.items() if key not in ("compare", "explore", "levels", "title")}
    config = without_values(config, grids)
    return {**config, "sweep": dict(grids), "analyses": dict(analyses)}


def even_axis(low: float, high: float, count: int) -> dict[str, Any]:
    """The block of an axis of evenly spaced values."""
    return {"start": low, "stop": high, "count": count}


def batch_text(
    content: Content,
    view: View,
    analyses: Mapping[str, Any],
    coordinates: tuple[str, ...],
    integrals: tuple[str, ...],
    solver: tuple[str, int] | None,
    title: str,
) -> str:
    """The YAML of a batch job that computes a view again.

    Args:
        content: the config that the view is of.
        analyses: with options.
        coordinates: of the start state.
        integrals: of the system, that starts are put on a level of.
        solver: solver and steps a period of the view; None leaves them to the target.
        title: of the job.
    """
    grids = {name: even_axis(*ends, view.counts[name]) for name, ends in view.ranges.items()}
    base = with_values(with_sweep(content, grids, analyses), view.fixed, coordinates, integrals)
    accuracy = dict(base.get("accuracy") or {})
    if view.target is not None:
        accuracy["target"] = view.target
    if solver is not None:
        accuracy.pop("target", None)
        accuracy |= {"solver": solver[0], "steps": solver[1]}
    ranges = ", ".join(f"{name} from {low!r} to {high!r}" for name, (low, high) in view.ranges.items())
    whole = {"title": f"{title}: {ranges}", **base, **({"accuracy": accuracy} if accuracy else {})}
    return from_dict(whole).text
