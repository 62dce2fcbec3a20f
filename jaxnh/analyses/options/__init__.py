"""Options of the analyses, by the key of each in YAML: modules that import no JAX, so that a config is read at once."""

import re

from jaxnh.analyses.options.base import Options
from jaxnh.analyses.options.basins import BasinsOptions, EdgesOptions
from jaxnh.analyses.options.chaos import (
    Chaos01Options,
    CovariantOptions,
    LyapunovOptions,
    ReversalOptions,
    RotationOptions,
    ToriOptions,
    TorusBranchesOptions,
    TransientsOptions,
    VerdictOptions,
)
from jaxnh.analyses.options.orbits import (
    AtlasOptions,
    BranchesOptions,
    CurvesOptions,
    DoublingOptions,
    HomoclinicOptions,
    ManifoldsOptions,
    OrbitsOptions,
    PeriodOptions,
    WindowsOptions,
)
from jaxnh.analyses.options.trajectories import DiagramOptions, PoincareOptions, PortraitOptions, TransportOptions

OPTIONS: dict[str, type[Options]] = {
    re.sub("(?<!^)(?=[A-Z])", "_", options.__name__.removesuffix("Options")).lower(): options
    for options in (
        DoublingOptions,
        LyapunovOptions,
        PeriodOptions,
        PortraitOptions,
        PoincareOptions,
        DiagramOptions,
        Chaos01Options,
        VerdictOptions,
        BasinsOptions,
        BranchesOptions,
        CurvesOptions,
        WindowsOptions,
        ReversalOptions,
        OrbitsOptions,
        CovariantOptions,
        TransientsOptions,
        RotationOptions,
        ToriOptions,
        TorusBranchesOptions,
        TransportOptions,
        ManifoldsOptions,
        EdgesOptions,
        HomoclinicOptions,
        AtlasOptions,
    )
}
"""Options of every analysis, in the order in which messages list them."""
