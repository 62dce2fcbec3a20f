"""All analyses by name, the only place that lists them."""

from jaxnh.analyses import chaos01, verdict
from jaxnh.analyses.base import Analysis
from jaxnh.analyses.basins import basins
from jaxnh.analyses.cascade import doubling
from jaxnh.analyses.continuation import branches, curves, homoclinic
from jaxnh.analyses.covariant import covariant
from jaxnh.analyses.exponents import lyapunov
from jaxnh.analyses.manifolds import manifolds
from jaxnh.analyses.orbits import orbits
from jaxnh.analyses.periodic import period
from jaxnh.analyses.reversal import reversal
from jaxnh.analyses.rotation import rotation
from jaxnh.analyses.tori import tori
from jaxnh.analyses.trajectories import diagram, poincare, portrait
from jaxnh.analyses.transients import transients
from jaxnh.analyses.transport import transport
from jaxnh.analyses.windows import windows

_MODULES = (
    doubling,
    lyapunov,
    period,
    portrait,
    poincare,
    diagram,
    chaos01,
    verdict,
    basins,
    branches,
    curves,
    windows,
    reversal,
    orbits,
    covariant,
    transients,
    rotation,
    tori,
    transport,
    manifolds,
    homoclinic,
)

ANALYSES: dict[str, Analysis] = {module.ANALYSIS.name: module.ANALYSIS for module in _MODULES}
"""Every analysis by its key in YAML."""

GROUPS: dict[str, Analysis] = {
    group: analysis
    for name, analysis in ANALYSES.items()
    for group in (name, *(analysis.whole.brings if analysis.whole else ()))
}
"""The analysis that makes a group of a result, by its name."""
