"""One file an analysis, one analysis a quantity. The table below is the only place that lists them."""

from jaxnh.analyses import chaos01, diagram, doubling, lyapunov, period, poincare, portrait, verdict
from jaxnh.analyses.base import Analysis

_MODULES = (doubling, lyapunov, period, portrait, poincare, diagram, chaos01, verdict)

ANALYSES: dict[str, Analysis] = {module.ANALYSIS.name: module.ANALYSIS for module in _MODULES}
"""Every analysis by its key in YAML."""
