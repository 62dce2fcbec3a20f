"""Error bars of edges of a flow: two wells with a tilt, driven, at random parameters, against scipy's DOP853.

The cycle between the wells is by Newton on the strobe map with variational equations, and the least shock by what leaves the
basin and what does not, in directions about ours.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import jaxnh

pytestmark = pytest.mark.usefixtures("always_shared_programs")
TURN = 2 * np.pi
UNIT = np.array([1.5, 3.0])
"""Halves of the box."""

BOX = {"x": (-1.5, 1.5), "v": (-3.0, 3.0)}

PERIODS = 40
"""After which a motion is on its attractor: at friction 0.16 it has come 600 times nearer e times."""

TURNS = np.array([0.0, *(side * turn for turn in (1e-5, 1e-4, 1e-3) for side in (1.0, -1.0))])
"""Radians: directions of the reference from ours, over which lengths are a parabola: 1e-10 of them is by 1e-5."""

FRONT = np.geomspace(0.5, 1e-9, 40)
"""Shares of the length: what is looked at in front of a boundary."""


def tilted(force=0.05, friction=0.2, tilt=0.0):
    def rhs(y, t):
        x, v = y
        return v, x - x**3 + tilt - friction * v + force * jnp.cos(t)

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * jnp.pi}


class Strobes:
    """The strobe map of many set-ups at once, (n,), by DOP853."""

    def __init__(self, force, friction, tilt):
        self.force, self.friction, self.tilt = force, friction, tilt

    def _rates(self, t, y):
        n = len(self.force)
        x, v = y[: 2 * n].reshape(2, n)
        parts = [v, x - x**3 + self.tilt - self.friction * v + self.force * np.cos(t)]
        if len(y) > 2 * n:
            a = y[2 * n :].reshape(2, 2, n)
            parts += [a[1].ravel(), ((1.0 - 3.0 * x * x) * a[0] - self.friction * a[1]).ravel()]
        return np.concatenate(parts)

    def _after(self, y, periods):
        return solve_ivp(self._rates, (0.0, 2 * np.pi * periods), y, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]

    def after(self, u, periods):
        """Points (n, 2) so many periods later."""
        return self._after(u.T.ravel(), periods).reshape(2, -1).T

    def closed(self, u):
        """The cycles near points (n, 2), and their matrices, (n, 2, 2)."""
        n = len(u)
        for _ in range(6):
            y = self._after(np.concatenate([u.T.ravel(), np.repeat(np.eye(2).ravel(), n)]), 1)
            matrix = np.moveaxis(y[2 * n :].reshape(2, 2, n), 2, 0)
            step = np.linalg.solve(matrix - np.eye(2), (u - y[: 2 * n].reshape(2, n).T)[..., None])[..., 0]
            u = u + step
        assert np.abs(step).max() < 1e-12
        return u, matrix


def covered_edges(data):
    """Whether each number of the cycles between wells is within its bar, (numbers, lanes)."""
    one = data.isel(pair=0)
    rows = (one["kind"].to_numpy() == 1) & (one["period"].to_numpy() == 1)
    assert rows.all()
    names = ("x_edge", "v_edge", "multiplier", "second_multiplier")
    ours, bars = (np.array([one[f"{name}{end}"].to_numpy()[rows] for name in names]) for end in ("", "_error"))
    cycles, matrix = Strobes(*(data[key].to_numpy()[rows] for key in ("force", "friction", "tilt"))).closed(ours[:2].T)
    moduli = np.sort(np.abs(np.linalg.eigvals(matrix)), axis=1)
    exact = np.array([*cycles.T, moduli[:, 1], moduli[:, 0]])
    # The reference is known to some 1e-12 of the larger multiplier, as its steps are to 1e-13.
    rounding = (
        np.array([1e-12, 1e-12, 0.0, 0.0])[:, None] + 1e-12 * moduli[:, 1] * np.array([0.0, 0.0, 1.0, 1.0])[:, None]
    )
    return np.abs(ours - exact) <= bars + rounding


def leaves(strobes, base, angle, lengths):
    """Whether displacements of points (n, 2) by lengths in directions (n, k) leave the basins of the cycles there."""
    count, k = lengths.shape
    point = np.repeat(base, k, axis=0)
    moved = point + lengths.ravel()[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2).reshape(-1, 2) * UNIT
    many = Strobes(*(np.repeat(leaf, k) for leaf in (strobes.force, strobes.friction, strobes.tilt)))
    return (np.abs(many.after(moved, PERIODS) - point).max(axis=1) > 0.05).reshape(count, k)


def covered_shocks(data):
    """Whether each least shock of cycles of one period is within its bar.

    Beyond the bar it leaves the basin; before the bar neither it nor those beside it do, nor what is in front of them.
    """
    data = data.stack(row=("lane", "attractor"))
    cycle = (data["attractor_kind"].to_numpy() == 0) & (data["attractor_period"].to_numpy() == 1)
    data = data.isel(row=np.flatnonzero(cycle & np.isfinite(data["shock"].to_numpy())))
    strobes = Strobes(*(data[key].to_numpy() for key in ("force", "friction", "tilt")))
    base, _ = strobes.closed(np.stack([data["x_attractor"].to_numpy(), data["v_attractor"].to_numpy()], axis=1))
    way = np.stack([data["x_shock"].to_numpy(), data["v_shock"].to_numpy()], axis=1) / UNIT
    angle, length, bar = (
        np.arctan2(way[:, 1], way[:, 0])[:, None],
        *(data[name].to_numpy()[:, None] for name in ("shock", "shock_error")),
    )
    shorter = [np.repeat(length - bar, len(TURNS), axis=1), np.minimum(length * (1.0 - FRONT), length - bar)]
    turns = np.concatenate([TURNS, np.zeros(len(FRONT) + 1)])
    out = leaves(strobes, base, angle + turns, np.concatenate([*shorter, length + bar], axis=1))
    return out[:, -1] & ~out[:, :-1].any(axis=1)


def run(options, **axes):
    session = jaxnh.Session(tilted, start={"x": 0.3, "v": 0.0}, target=1e-6)
    data = session.run(jaxnh.Edges(box=BOX, pairs=1, **options), **axes)
    return data.stack(lane=("force", "friction", "tilt")).reset_index("lane").transpose("lane", ...)


def test_the_bars_of_one_flow():
    data = run({"n_starts": 8, "transient": 32, "directions": 0}, force=[0.05], friction=[0.6], tilt=[0.05])
    assert covered_edges(data).all()


@pytest.mark.slow
def test_bars_of_flows_cover():
    """Of twelve set-ups and one with three attractors, the basin of one of which has strips in front of another's."""
    draw = np.random.default_rng(7)
    axes = {
        "force": draw.uniform(0.02, 0.1, 3),
        "friction": draw.uniform(0.16, 0.4, 2),
        "tilt": draw.uniform(-0.1, 0.1, 2),
    }
    options = {"n_starts": 16, "directions": 8}
    three = {"force": [0.1005], "friction": [0.16348], "tilt": [0.03047]}
    parts = [run(options, **axes), run({**options, "n_starts": 48}, **three)]
    few = run({"n_starts": 8, "directions": 0}, **three)  # of which none leads to the third
    assert few["attractors"].to_numpy()[0] == 2
    edges = np.concatenate([covered_edges(data) for data in [*parts, few]], axis=1)
    assert edges.mean() >= 0.95
    assert parts[1]["attractors"].to_numpy()[0] == 3
    shocks = np.concatenate([covered_shocks(data) for data in parts])
    assert len(shocks) >= 20
    assert shocks.mean() >= 0.95


def bent_bistable(lam=0.4, m=-0.05, a=0.27, b=-0.21, e=0.27):
    """X′ = λ(X − m)(1 − X²)g and Y′ = −0.66 (1 + X/5)Yg with g of mean 1, where x = X + aY² + bY and y = Y about a point
    that the clock moves: the boundary is X = m, and attractors are (±1, 0)."""

    def rhs(s, t):
        at, moving = e * jnp.cos(TURN * t), -TURN * e * jnp.sin(TURN * t)
        y = s[1] - at
        x, g = s[0] - a * y * y - b * y - at, 1.0 - 0.19 * jnp.cos(TURN * t)
        dy = -0.66 * g * (1.0 + 0.2 * x) * y
        return g * lam * (x - m) * (1.0 - x * x) + (2.0 * a * y + b) * dy + moving, dy + moving

    return {"rhs": rhs, "coordinates": ("x", "y"), "period": 1.0}


def least_shock(side, m=-0.05, a=0.27, b=-0.21):
    """Least distance, in halves of a box of sides 4, of the attractor on a side from the boundary."""

    def distance(y):
        return np.hypot(m + a * y * y + b * y - side, y) / 2.0

    return min(minimize_scalar(distance, bracket=(y - 0.1, y + 0.1), tol=1e-14).fun for y in (-1.0, 0.0, 1.0))


@pytest.mark.slow
def test_steps_that_move_the_attractor_are_in_the_bars_of_shocks():
    """Steps move what attracts weakly as well as the boundary: bars of the boundary alone missed 15 of 16."""
    session = jaxnh.Session(bent_bistable, start={"x": 0.5, "y": 0.1}, target=1e-4)
    box = {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}
    data = session.run(jaxnh.Edges(box=box, n_starts=8, pairs=1), lam=[0.05, 0.2, 0.4])
    known = np.isfinite(data["shock"].to_numpy())
    shock, error, x = (data[name].to_numpy()[known] for name in ("shock", "shock_error", "x_attractor"))
    assert len(shock) == 6
    assert np.all(np.abs(shock - np.where(x > 0.27, least_shock(1.0), least_shock(-1.0))) <= error)
    assert np.max(error) < 1e-4
