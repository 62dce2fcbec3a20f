"""Windows whose cascade coexists with another attractor, against the analysis `doubling` and heyoka."""

from __future__ import annotations

import heyoka as hy
import numpy as np
import pytest

from jaxnh.engine.experiment import Experiment
from tests.helpers.heyoka_newton import bifurcation, strobe_map
from tests.helpers.kept_programs import session_of


def pendulum(x, v, drive, t):
    """x'' = −sin x − x'/2 + A cos 2t/3."""
    return v, -hy.sin(x) - 0.5 * v + drive * hy.cos(2 * t / 3)


@pytest.mark.slow
def test_a_cascade_beside_another_attractor_is_one_window(tmp_path):
    """From A = 1.0765 on some lanes settle on an orbit of period 3, and the cascade of period 1 has gaps.

    It is one row, with its doublings up to those of period 4, each by Newton on heyoka's map as well; none is the end of
    another row.
    """
    (tmp_path / "flow.py").write_text(
        "import jax.numpy as jnp\n\ndef system(drive=1.0):\n    def rhs(y, t):\n        x, v = y\n"
        "        return v, -jnp.sin(x) - 0.5 * v + drive * jnp.cos(2 * t / 3)\n\n"
        '    return {"rhs": rhs, "coordinates": ("x", "v"), "angles": ("x",), "period": 3 * jnp.pi}\n'
    )
    text = f"""\
system: {{file: {tmp_path / "flow.py"}}}
initial: {{x: 0.0, v: 0.0}}
sweep: {{drive: {{start: 1.0625, stop: 1.08265625, count: 130}}}}
accuracy: {{target: 1.0e-8}}
analyses:
  windows: {{max_period: 4, levels: 3, crisis: 0}}
"""
    data = session_of(Experiment.from_text(text)).run("windows")
    assert data["period"].values.tolist() == [1, 3]
    found, errors = data["doubling"].values[0], data["doubling_error"].values[0]
    u, period = np.zeros(2), 3 * np.pi
    for n, value, error in zip((1, 2, 4), found, errors, strict=True):
        for _ in range(400):
            u, _ = strobe_map(pendulum, 2, period, n)(value - 2e-4, u)
        exact, multipliers = bifurcation(strobe_map(pendulum, 2, period, n), "period_doubling", value, u)
        assert np.abs(multipliers + 1).min() < 1e-6
        assert abs(value - exact) < error + 1e-12
        assert not np.any(np.abs(data["end"].values[1:] - exact) < 1e-3)
