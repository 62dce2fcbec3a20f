"""Crises of windows of two textbook flows against heyoka: bands are visited in turn up to the interval, not beyond it."""

from __future__ import annotations

import heyoka as hy
import numpy as np
import pytest

from jaxnh.engine.experiment import Experiment
from tests.helpers.kept_programs import session_of

_LANES, _STROBES = 8, 12_000
_CELLS = 48  # to a side of what all points of a path are in


def duffing(x, v, drive, t):
    """x'' + x'/2 − x + x³ = F cos t."""
    return v, -0.5 * v + x - x**3 + drive * hy.cos(t)


def brusselator(x, z, drive, t):
    """The Brusselator at A = 0.4, B = 1.2, forced at ω = 0.81 (Kai, Tomita, Prog. Theor. Phys. 61 (1979) 54)."""
    return 0.4 - 2.2 * x + x * x * z + drive * hy.cos(0.81 * t), 1.2 * x - x * x * z


FLOWS = {
    "duffing": (duffing, "v, -0.5 * v + x - x**3 + drive * jnp.cos(t)", 1.0, (0.1, 0.0)),
    "brusselator": (
        brusselator,
        "0.4 - 2.2 * x + x * x * v + drive * jnp.cos(0.81 * t), 1.2 * x - x * x * v",
        0.81,
        (0.4, 3.0),
    ),
}
CASES = {
    "duffing, 2, of a doubling": ("duffing", 2, 0.352, 0.363, 89),
    "duffing, 3, of a fold": ("duffing", 3, 0.3626, 0.3662, 73),
    "duffing, 4, of a fold": ("duffing", 4, 0.3733, 0.3748, 61),
    "brusselator, 4, of a doubling": ("brusselator", 4, 0.04, 0.053, 53),
    "brusselator, 10, of a fold": ("brusselator", 10, 0.078, 0.0792, 49),
}


def windows_of(folder, rates, omega, start, low, high, count):
    """Windows of a flow over its drive."""
    (folder / "flow.py").write_text(
        "import jax.numpy as jnp\n\ndef system(drive=0.1):\n    def rhs(y, t):\n        x, v = y\n"
        f"        return {rates}\n\n"
        f'    return {{"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi / {omega}}}\n'
    )
    text = f"""\
system: {{file: {folder / "flow.py"}}}
initial: {{x: {start[0]}, v: {start[1]}}}
sweep: {{drive: {{start: {low}, stop: {high}, count: {count}}}}}
accuracy: {{target: 1.0e-8}}
analyses:
  windows: {{}}
"""
    return session_of(Experiment.from_text(text)).run("windows")


def strobes(rates, omega, drive, start, transient, count):
    """Strobes of lanes by heyoka, (lanes, count, 2), at a drive from starts (2, lanes)."""
    x, v = hy.make_vars("x", "v")
    equations = list(zip((x, v), rates(x, v, hy.par[0], hy.time), strict=True))
    ta = hy.taylor_adaptive_batch(equations, np.array(start), pars=np.full((1, start.shape[1]), drive), tol=1e-12)
    found = np.empty((count, *start.shape))
    for k in range(-transient, count):
        ta.set_time(0.0)
        ta.propagate_until(2 * np.pi / omega)
        found[max(k, 0)] = ta.state
    return found.transpose(2, 0, 1)


def on_the_orbit(rates, omega, drive, start, period):
    """Points of an orbit of a period that attracts, from as many starts about one as it takes: (2, lanes)."""
    about = np.array(start)[:, None] + np.random.default_rng(0).uniform(-1, 1, (2, 64))
    path = strobes(rates, omega, drive, about, 2000, period + 1)
    least = [np.abs(path[:, n] - path[:, 0]).max(axis=1) < 1e-6 for n in range(1, period + 1)]
    there = np.flatnonzero(least[-1] & ~np.any(least[:-1], axis=0))
    assert len(there)
    return np.repeat(path[there[0], 0][:, None], _LANES, axis=1) + 1e-6 * np.arange(_LANES)


def in_cells_of_several_phases(points, period):
    """The share of the points of a path in cells of the plane that hold points of more than one phase."""
    low, high = points.min(axis=0), points.max(axis=0)
    place = np.minimum((points - low) / (high - low) * _CELLS, _CELLS - 1).astype(int)
    cell = place[:, 0] * _CELLS + place[:, 1]
    held = np.unique(cell * period + np.arange(len(points)) % period) // period
    cells, phases = np.unique(held, return_counts=True)
    return np.mean(np.isin(cell, cells[phases > 1]))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "period", "low", "high", "count"), CASES.values(), ids=CASES)
def test_bands_are_in_turn_up_to_the_crisis(tmp_path, name, period, low, high, count):
    """Where the interval begins no lane of heyoka loses its turn, where it ends some do; lanes are eight times ours in all.

    As long as bands are apart only cells between two of them, a tenth at most, hold points of both. Once the turn is
    lost for some time nearly all cells do: half is between the two by far. All eight lanes begin on the window's orbit.
    """
    rates, text, omega, start = FLOWS[name]
    data = windows_of(tmp_path, text, omega, start, low, high, count)
    window = data.isel(window=data["period"].values.tolist().index(period))
    crisis, error = float(window["crisis"]), float(window["crisis_error"])
    beyond = np.sign(float(window["crisis"] - window["limit"]))
    # Most intervals are 1e-5 of a window; where a path happens to leave late there they are up to 2e-3, by six grids each.
    assert error < 1e-2 * abs(float(window["crisis"] - window["end"]))
    attracts = float(window["end"] - 0.3 * (window["limit"] - window["end"]))
    begin = on_the_orbit(rates, omega, attracts, start, period)
    before, after = (
        [
            in_cells_of_several_phases(path, period) > 0.5
            for path in strobes(rates, omega, crisis + side * error, begin, 500, _STROBES)
        ]
        for side in (-beyond, beyond)
    )
    assert not any(before)
    assert any(after)
