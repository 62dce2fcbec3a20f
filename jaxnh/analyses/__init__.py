"""One file an analysis, one analysis a quantity. The table below is the only place that lists them."""

from jaxnh.analyses import doubling, lyapunov, period
from jaxnh.analyses.record import Analysis

ANALYSES: dict[str, Analysis] = {
    analysis.name: analysis
    for analysis in (
        Analysis("doubling", doubling.DoublingOptions, doubling.periods, doubling.run),
        Analysis("lyapunov", lyapunov.LyapunovOptions, lyapunov.periods, lyapunov.run),
        Analysis("period", period.PeriodOptions, period.periods, period.run),
    )
}
"""Every analysis by its key in YAML."""
