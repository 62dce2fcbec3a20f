"""All analyses by name, the only place that lists them. Each is imported when it is first asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module

from jaxnh.analyses.base import Analysis

_HOMES = {
    "doubling": "cascade.doubling",
    "lyapunov": "exponents.lyapunov",
    "period": "periodic.period",
    "portrait": "trajectories.portrait",
    "poincare": "trajectories.poincare",
    "diagram": "trajectories.diagram",
    "chaos01": "chaos01",
    "verdict": "verdict",
    "basins": "basins.basins",
    "branches": "continuation.branches",
    "curves": "continuation.curves",
    "windows": "windows.windows",
    "reversal": "reversal.reversal",
    "orbits": "orbits.orbits",
    "covariant": "covariant.covariant",
    "transients": "transients.transients",
    "rotation": "rotation.rotation",
    "tori": "tori.tori",
    "torus_branches": "tori.torus_branches",
    "transport": "transport.transport",
    "manifolds": "manifolds.manifolds",
    "edges": "edges.edges",
    "homoclinic": "continuation.homoclinic",
    "atlas": "atlas.atlas",
}


class _Registry(Mapping[str, Analysis]):
    """Analyses by their key in YAML, in the order in which a run makes them."""

    def __getitem__(self, name: str) -> Analysis:
        return import_module(f"jaxnh.analyses.{_HOMES[name]}").ANALYSIS

    def __iter__(self) -> Iterator[str]:
        return iter(_HOMES)

    def __len__(self) -> int:
        return len(_HOMES)

    def __contains__(self, name: object) -> bool:
        return name in _HOMES


ANALYSES: Mapping[str, Analysis] = _Registry()
"""Every analysis by its key in YAML."""


def analysis_of(group: str) -> Analysis | None:
    """Return the analysis that makes a group of a result, by the name of the group; None where none does."""
    if group in ANALYSES:
        return ANALYSES[group]
    return next((each for each in ANALYSES.values() if each.whole and group in each.whole.brings), None)
