"""One file an analysis, one analysis a quantity. The table below is the only place that lists them."""

from jaxnh.analyses import chaos01, diagram, doubling, lyapunov, period, poincare, portrait, verdict
from jaxnh.analyses.base import Analysis

ANALYSES: dict[str, Analysis] = {
    analysis.name: analysis
    for analysis in (
        Analysis("doubling", doubling.DoublingOptions, doubling.periods, doubling.run, splits=doubling.splits),
        Analysis("lyapunov", lyapunov.LyapunovOptions, lyapunov.periods, lyapunov.run, choose=lyapunov.choose),
        Analysis("period", period.PeriodOptions, period.periods, period.run, numbers=period.numbers),
        Analysis(
            "portrait",
            portrait.PortraitOptions,
            portrait.periods,
            portrait.run,
            numbers=portrait.numbers,
            count=poincare.count,
        ),
        Analysis(
            "poincare",
            poincare.PoincareOptions,
            poincare.periods,
            poincare.run,
            numbers=poincare.numbers,
            count=poincare.count,
        ),
        Analysis(
            "diagram",
            diagram.DiagramOptions,
            diagram.periods,
            diagram.run,
            splits=diagram.splits,
            numbers=diagram.numbers,
            count=poincare.count,
        ),
        Analysis("chaos01", chaos01.Chaos01Options, chaos01.periods, chaos01.run),
        Analysis(
            "verdict",
            verdict.VerdictOptions,
            verdict.periods,
            verdict.run,
            needs=("period", "lyapunov", "chaos01"),
            count=verdict.count,
        ),
    )
}
"""Every analysis by its key in YAML."""
