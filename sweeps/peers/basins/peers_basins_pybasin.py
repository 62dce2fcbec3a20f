"""pybasin on its own pendulum, in an interpreter of its own: the shares of rest and rotation, and seconds, as JSON.

    PYTHON -P peers_basins_pybasin.py ACROSS UP

As its benchmark has it: Dopri5 to t = 1000 at rtol 1e-8 and atol 1e-6, and a classifier that is given both attractors.
The starts are a grid of ACROSS angles and UP rates, those of `configs/flows/torque_pendulum.yaml`, in single precision,
as its samplers draw them. Nothing of jaxnh is imported.
"""
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

from __future__ import annotations

import json
import sys
import time

BEGAN = time.perf_counter()

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402
from pybasin.basin_stability_estimator import BasinStabilityEstimator  # noqa: E402
from pybasin.feature_extractors.feature_extractor import FeatureExtractor  # noqa: E402
from pybasin.sampler import Sampler  # noqa: E402
from pybasin.solvers import JaxSolver  # noqa: E402
from pybasin.solvers.jax_ode_system import JaxODESystem  # noqa: E402
from pybasin.template_integrator import TemplateIntegrator  # noqa: E402
from sklearn.neighbors import KNeighborsClassifier  # noqa: E402

PARAMETERS = {"damping": 0.1, "torque": 0.5}
REST = np.arcsin(0.5)
KINDS = ("rest", "rotation")


class Pendulum(JaxODESystem):
    """theta'' = −damping theta' + torque − sin theta."""

    def ode(self, t, y, p):
        return jnp.array([y[1], p[1] - p[0] * y[1] - jnp.sin(y[0])])


class Spread(FeatureExtractor):
    """A feature: whether the rate still varies over the last fifty units of time, one-hot."""

    @property
    def feature_names(self):
        return list(KINDS)

    def extract_features(self, solution):
        rate = self.filter_time(solution)[..., 1]
        still = (rate.max(dim=0).values - rate.mean(dim=0)).abs() < 0.01
        return torch.stack([still, ~still], dim=1).to(torch.float64)


class GridSampler(Sampler):
    """The points of the study, in its order."""

    def __init__(self, across: int, up: int) -> None:
        super().__init__([REST - np.pi, -10.0], [REST + np.pi, 10.0], device="cpu")
        theta, rate = np.linspace(REST - np.pi, REST + np.pi, across), np.linspace(-10.0, 10.0, up)
        self.points = torch.tensor(np.stack(np.meshgrid(theta, rate, indexing="ij"), axis=-1).reshape(-1, 2))

    def sample(self, n):
        return self.points[:n].to(torch.float32)


def main() -> None:
    across, up = map(int, sys.argv[1:])
    loaded = time.perf_counter()
    estimator = BasinStabilityEstimator(
        n=across * up,
        ode_system=Pendulum(PARAMETERS),
        sampler=GridSampler(across, up),
        solver=JaxSolver(t_span=(0, 1000), t_steps=1000, device="cpu", rtol=1e-8, atol=1e-6, cache_dir=None),
        feature_extractor=Spread(time_steady=950.0),
        predictor=KNeighborsClassifier(n_neighbors=1),
        template_integrator=TemplateIntegrator([[0.5, 0.0], [2.7, 0.0]], list(KINDS), PARAMETERS),
        feature_selector=None,
        detect_unbounded=False,
        output_dir=None,
    )
    found = estimator.run()
    shares = found["basin_stability"]
    ended = time.perf_counter()
    seconds = {"import": loaded - BEGAN, "run": ended - loaded}
    print(json.dumps({"shares": {kind: float(shares.get(kind, 0.0)) for kind in KINDS}, "seconds": seconds}))


if __name__ == "__main__":
    main()
