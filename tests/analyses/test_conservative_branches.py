"""Branches of conservative maps and flows: two multipliers have the product one all along, which is no bifurcation."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.orbits.continuation.kinds import DOUBLING, HOPF, NEIMARK_SACKER

PAIRS = {NEIMARK_SACKER, HOPF}


def quadratic(a=2.7):
    """Hénon's map of Jacobian one."""

    def image(s):
        x, y = s
        return 1.0 - a * x**2 - y, x

    return {"map": image, "coordinates": ("x", "y")}


def standard(K=1.0):
    def image(s):
        theta, p = s
        momentum = p + K * jnp.sin(theta)
        return theta + momentum, momentum

    return {"map": image, "coordinates": ("theta", "p"), "angles": ("theta", "p")}


def coupled(K=1.0, b=0.2):
    """Two standard maps that are coupled by b sin(θ₁ + θ₂)."""

    def image(s):
        first, p, second, q = s
        together = b * jnp.sin(first + second)
        p, q = p + K * jnp.sin(first) + together, q + 0.7 * K * jnp.sin(second) + together
        return first + p, p, second + q, q

    return {"map": image, "coordinates": ("first", "p", "second", "q"), "angles": ("first", "p", "second", "q")}


def parametric_pendulum(e=0.3, w=2.0):
    def rhs(s, t):
        x, v = s
        return v, -jnp.sin(x) * (1.0 + e * jnp.cos(w * t))

    return {"rhs": rhs, "coordinates": ("x", "v"), "angles": "x", "period": 2.0 * np.pi / w}


def three_bodies(mu=0.01):
    """The restricted problem in the plane, in a frame that turns."""

    def rhs(s, t):
        x, y, p, q = s
        near, far = (x + mu) ** 2 + y**2, (x - 1.0 + mu) ** 2 + y**2
        to_near, to_far = (1.0 - mu) / near**1.5, mu / far**1.5
        return p, q, 2.0 * q + x - to_near * (x + mu) - to_far * (x - 1.0 + mu), -2.0 * p + y - (to_near + to_far) * y

    return {"rhs": rhs, "coordinates": ("x", "y", "p", "q")}


def followed(session, options, **values):
    groups = session.groups({"branches": options}, **values)
    return groups["branches"], groups["bifurcations"]


def doublings(bifurcations, name, period):
    here = (bifurcations["kind"] == DOUBLING) & (bifurcations["period"] == period)
    return bifurcations[name].to_numpy()[here], bifurcations[f"{name}_error"].to_numpy()[here]


def test_cascade_of_the_area_preserving_quadratic_map():
    """The fixed point doubles at a = 3, where 2 − 2√(1 + a) is its trace, and its orbit of period 2 at 4."""
    session = jaxnh.Session(quadratic, start={"x": 0.3, "y": 0.3})
    options = jaxnh.Branches(max_period=16, n_starts=2, n_values=2, box={"x": (0.3, 0.4), "y": (0.3, 0.4)})
    branches, bifurcations = followed(session, options, a=np.linspace(2.9, 4.14, 20))
    assert not PAIRS & {*bifurcations["kind"].to_numpy().tolist()}
    cascade = np.zeros(5)
    for level, exact in enumerate([3.0, 4.0, None, None, None]):
        value, error = doublings(bifurcations, "a", 2**level)
        if exact is not None:
            assert np.any(np.abs(value - exact) <= error)
        cascade[level] = value.max()
    # δ = 8.721097 of area-preserving maps (Bountis, Physica D 3, 1981; MacKay, Physica D 7, 1983)
    gaps = np.diff(cascade)
    np.testing.assert_allclose(gaps[2:-1] / gaps[3:], 8.721097, rtol=2e-3)
    assert int(branches["not_located"]) == 0


def test_a_search_for_doublings_names_what_follows_orbits_that_nothing_settles_on():
    session = jaxnh.Session(quadratic, start={"x": 0.3, "y": 0.35})
    with pytest.warns(
        jaxnh.JaxnhWarning, match="orbits that no motion settles on are followed by branches with n_starts"
    ):
        found = session.run(jaxnh.Doubling(levels=2, search=False), a=np.linspace(2.5, 3.4, 32))
    assert int(found["levels_found"]) == 0


def test_standard_map():
    """The fixed point (π, 0) doubles at K = 4, where its trace is 2 − K, and nothing else is of period 1 there."""
    session = jaxnh.Session(standard, start={"theta": 3.0, "p": 0.0})
    options = jaxnh.Branches(max_period=1, n_starts=8, n_values=2, box={"theta": (0.5, 5.5), "p": (-1.0, 1.0)})
    branches, bifurcations = followed(session, options, K=np.linspace(0.5, 6.0, 24))
    assert bifurcations["kind"].to_numpy().tolist() == [DOUBLING]
    assert abs(float(bifurcations["K"][0]) - 4.0) <= float(bifurcations["K_error"][0])
    assert int(branches["not_located"]) == 0


def test_branches_of_coupled_standard_maps():
    """Where two multipliers one merge, the critical vectors of both sides are orthogonal: no criticality is told."""
    session = jaxnh.Session(coupled, start={"first": 3.0, "p": 0.0, "second": 3.0, "q": 0.0})
    box = {"first": (0.0, 6.0), "p": (-3.0, 3.0), "second": (0.0, 6.0), "q": (-3.0, 3.0)}
    options = jaxnh.Branches(max_period=1, n_starts=16, n_values=3, box=box)
    _, bifurcations = followed(session, options, K=np.linspace(-3.0, 4.0, 15))
    assert bifurcations.sizes["bifurcation"]
    assert not PAIRS & {*bifurcations["kind"].to_numpy().tolist()}
    assert not np.any(bifurcations["criticality"])


@pytest.mark.parametrize("target", [1e-6, 1e-9])
def test_parametric_pendulum(target):
    """What steps make of multipliers is none of the flow: a coarse target shows no other bifurcations than a fine one."""
    session = jaxnh.Session(parametric_pendulum, start={"x": 1.0, "v": 0.0}, target=target)
    options = jaxnh.Branches(max_period=1, n_starts=8, n_values=2, box={"x": (-3.0, 3.0), "v": (-2.5, 2.5)})
    branches, bifurcations = followed(session, options, e=np.linspace(0.05, 1.0, 20))
    assert branches.sizes["branch"]
    assert not PAIRS & {*bifurcations["kind"].to_numpy().tolist()}
    assert not np.isin(branches["not_located_kind"], [*PAIRS]).any()


def test_equilibria_of_three_bodies():
    """L₄ and L₅ lose their stability at Routh's ratio 0.0385 by two frequencies that meet: no point of Hopf's."""
    session = jaxnh.Session(three_bodies, start={"x": 0.5, "y": 0.0, "p": 0.0, "q": 0.8})
    box = {"x": (-1.3, 1.3), "y": (-1.0, 1.0), "p": (-1.0, 1.0), "q": (-1.0, 1.0)}
    options = jaxnh.Branches(max_period=1, equilibria=32, n_values=2, box=box)
    branches, bifurcations = followed(
        session.on(coordinate="y", value=0.0, direction="up"), options, mu=np.linspace(0.01, 0.045, 8)
    )
    assert int(np.sum(branches["period"] == 0)) == 5
    assert not bifurcations.sizes["bifurcation"]
    assert int(branches["not_located"]) == 0
