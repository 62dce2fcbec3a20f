"""One file an analysis, one analysis a quantity. The table below is the only place that lists them."""

from jaxnh.analyses import doubling
from jaxnh.analyses.record import Analysis

ANALYSES: dict[str, Analysis] = {
    analysis.name: analysis
    for analysis in (Analysis("doubling", doubling.DoublingOptions, doubling.periods, doubling.run),)
}
"""Every analysis by its key in YAML."""
