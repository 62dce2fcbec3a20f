"""Deviations of branches where events cut the steps: straight lines of affine maps; their unit, and ends of branches."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import jaxnh
from jaxnh.analyses.manifolds.curves import ManifoldBranch, distance_from

pytestmark = pytest.mark.usefixtures("always_shared_programs")
BOX = {"x": (-0.5, 0.5), "v": (-0.8, 0.8)}
HALVES = np.array([0.5, 0.8])


def square_wave(k=1.0, d=0.1, force=0.3):
    """A saddle that is pushed one way for half of a period and the other way for the rest."""

    def rhs(y, t):
        return y[1], k * y[0] - d * y[1] + force * jnp.sign(jnp.cos(2 * jnp.pi * t / 1.3))

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 1.3}


def kicked(k=1.0, q=0.1, c=0.1):
    """A saddle that is kicked at the middle and at the end of a period."""

    def rhs(y, t):
        return y[1], k * y[0] + 0.0 * t

    kick = {"when": lambda y, t: jnp.sin(2 * jnp.pi * t), "direction": "both"}
    kick["then"] = lambda y, t: (y[0] + c * y[1], y[1] - q)
    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 1.0, "jumps": [kick]}


def affine_map(field, force, duration):
    """The affine map (3, 3) of a linear field and a force on v over a time."""
    matrix = np.zeros((3, 3))
    matrix[:2, :2], matrix[1, 2] = field, force
    return expm(duration * matrix)


def map_of_square_wave(p):
    field = np.array([[0.0, 1.0], [p["k"], -p["d"]]])
    ends, middle = affine_map(field, p["force"], 0.325), affine_map(field, -p["force"], 0.65)
    return ends @ middle @ ends


def map_of_kicked(p):
    half = affine_map(np.array([[0.0, 1.0], [p["k"], 0.0]]), 0.0, 0.5)
    kick = np.array([[1.0, p["c"], 0.0], [0.0, 1.0, -p["q"]], [0.0, 0.0, 1.0]])
    return kick @ half @ kick @ half


@pytest.mark.parametrize(
    ("define", "map_of", "lanes"),
    [
        (square_wave, map_of_square_wave, {"k": [0.6, 1.8], "force": [0.2, -0.3]}),
        (kicked, map_of_kicked, {"k": [0.9, 1.8], "q": [0.1, -0.1]}),
    ],
)
def test_deviations_where_twice_the_steps_are_the_same_parts(define, map_of, lanes):
    """They cover the distance from the lines, and are twice it, as steps of a quarter leave nothing beside it.

    The unit is half the box, whichever starts Newton has: the arc length along a line says so. Of two steps or fewer,
    cut at a quarter, half or three quarters of a period, twice as many are the same parts, and differ by rounding.
    """
    options = jaxnh.Manifolds(box=BOX, length=8.0, spacing=0.3, crossings=0, n_starts=4)
    session = jaxnh.Session(define, start={"x": 0.1, "v": 0.0}, target=1e-5)
    data = session.run(options, **lanes).isel(saddle=0)
    own = {"d": 0.1} if define is square_wave else {"c": 0.1}
    (first, firsts), (second, seconds) = lanes.items()
    for i, j in np.ndindex(len(firsts), len(seconds)):
        affine = map_of({**own, first: firsts[i], second: seconds[j]})
        centre = np.linalg.solve(np.eye(2) - affine[:2, :2], affine[:2, 2]) / HALVES
        multipliers, vectors = np.linalg.eig(affine[:2, :2])
        of_lane = data.isel({first: i, second: j})
        for b, kind in enumerate(jaxnh.labels(of_lane["branch_kind"]).to_numpy().tolist()):
            branch, number = of_lane.isel(branch=b), int(np.argmax(np.abs(multipliers)))
            way = vectors[:, number if kind == "unstable" else 1 - number] / HALVES
            arc = branch["arc_length"].to_numpy()
            points = np.stack([branch["x_points"], branch["v_points"]], axis=-1)[np.isfinite(arc)] / HALVES - centre
            away = np.abs(points @ np.array([-way[1], way[0]])).max() / np.linalg.norm(way)
            assert len(points) > 10
            # The closed form is rounded as well: of coordinates of 8 and a condition of the fixed point below 10.
            rounding = 80 * np.finfo(float).eps * 8
            assert away <= float(branch["deviation"]) + rounding
            assert float(branch["deviation"]) < 2.1 * away + rounding
            assert arc[np.isfinite(arc)] == pytest.approx(np.linalg.norm(points, axis=1), abs=1e-9)


@pytest.mark.parametrize("moved", [0, 7, 19])
def test_points_at_both_ends_of_a_branch_count(moved):
    """One that lies across by 1e-4 is as far from the curve, at its ends as well: where errors have grown most."""
    x = np.linspace(0.0, 1.0, 20)
    u = np.stack([x, 0.3 * x * x], axis=1)
    points, normal = u.copy(), np.array([-0.6 * x[moved], 1.0]) / np.hypot(0.6 * x[moved], 1.0)
    points[moved] += 1e-4 * normal
    branch = ManifoldBranch(np.insert(x, 0, -np.inf), np.insert(u, 0, u[0], axis=0), np.zeros(21), 1)
    assert distance_from(branch, points, np.ones(2), lambda gap: gap) == pytest.approx(1e-4, rel=1e-3)


def test_points_next_to_a_jump_lie_on_their_own_side_of_it():
    """Where a jump reverses y at x = 1 and ends the branch, a point moved along by 1e-7 is on the curve, or as near."""
    x = np.append(1.0 - 0.5 ** np.arange(1, 31), 1.0)  # neighbours are halved up to the jump
    u = np.stack([x, np.append(0.3 * x[:-1] ** 2, -0.3)], axis=1)
    branch, points = ManifoldBranch(np.insert(x, 0, -np.inf), np.insert(u, 0, u[0], axis=0), np.zeros(32), 1), u.copy()
    points[-1] = 1.0 - 1e-7, 0.3 * (1.0 - 1e-7) ** 2
    assert distance_from(branch, points, np.ones(2), lambda gap: gap) < 2e-7
