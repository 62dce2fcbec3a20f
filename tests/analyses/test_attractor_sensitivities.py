"""Derivatives of attractors in parameters: closed forms of maps, of driven and of resting flows, and two whole runs."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxnh
from jaxnh.analyses.verdict import KINDS


def attractors(session, box, **axes):
    """The group `attractors` with derivatives."""
    options = jaxnh.Basins(n_starts=8, seed=1, box=box, sensitivities=True)
    return session.groups({"basins": options}, **axes)["attractors"]


def check(data, exact, largest):
    """Derivatives by name and parameter: within their errors, which are small."""
    for name, of_parameters in exact.items():
        for parameter, truth in of_parameters.items():
            rates, errors = (
                data[f"{name}_sensitivity{end}"].sel(parameter=parameter).to_numpy() for end in ("", "_error")
            )
            assert np.all(np.abs(rates - truth) <= errors), (name, parameter, rates, truth, errors)
            assert np.all(errors < largest), (name, parameter, errors)


def henon(a=0.2, b=0.3):
    def image(s):
        x, y = s
        return 1.0 - a * x * x + y, b * x

    return {"map": image, "coordinates": ("x", "y")}


def test_fixed_point_of_a_map():
    """x with a x² + (1 − b) x = 1 and its multiplier, the root of μ² + 2 a x μ = b of the larger modulus."""

    def known(p):
        a, b = p
        x = (b - 1 + jnp.sqrt((1 - b) ** 2 + 4 * a)) / (2 * a)
        modulus = a * x + jnp.sqrt((a * x) ** 2 + b)
        return jnp.stack([x, b * x, modulus, jnp.log(modulus)])

    session = jaxnh.Session(henon, start={"x": 0.1, "y": 0.1})
    data = attractors(session, {"x": (-0.5, 0.5), "y": (-0.3, 0.3)}, a=[0.2, 0.25])
    assert data["kind"].to_numpy().tolist() == [[0], [0]]
    truth = np.array([jax.jacobian(known)(np.array([a, 0.3])) for a in (0.2, 0.25)])[:, None]
    names = ("x", "y", "multiplier", "exponent")
    exact = {name: {"a": truth[..., k, 0], "b": truth[..., k, 1]} for k, name in enumerate(names)}
    check(data, exact, 1e-10)


def logistic(r=3.2, q=0.0):
    return {"map": lambda s: r * s[0] * (1.0 - s[0]) + q - q, "coordinates": "x"}


def test_what_solves_no_equation_has_none():
    """The cycle of two of the logistic map, 4 + 2 r − r², has derivatives; chaos has exponents by averages and no more."""
    session = jaxnh.Session(logistic, start={"x": 0.3})
    data = attractors(session, {"x": (0.2, 0.8)}, r=[3.1, 3.9])
    assert [KINDS[kind] for kind in data["kind"].to_numpy()[:, 0]] == ["periodic", "chaotic"]
    check(data.isel(r=[0], attractor=[0]), {"multiplier": {"r": 2 - 2 * 3.1, "q": 0.0}}, 1e-10)
    chaotic = data.isel(r=1)
    assert np.isnan([chaotic[f"{name}_sensitivity"] for name in ("multiplier", "exponent", "x")]).all()


def driven(k=0.5, f=1.0, w=1.3):
    def rhs(y, t):
        x, v = y
        return v, f * jnp.cos(w * t) - k * v - x

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi / w}


def test_orbit_of_a_flow_with_a_clock():
    """x = Re f/(1 − w² + i k w) and v = Re i w x at the strobe; |μ| = exp(−k π/w), in whose exponent w plays no part."""

    def known(p):
        k, f, w = p
        square = (1 - w * w) ** 2 + (k * w) ** 2
        return jnp.stack([f * (1 - w * w) / square, f * k * w * w / square, jnp.exp(-k * jnp.pi / w), -k / 2])

    session = jaxnh.Session(driven, start={"x": 0.0, "v": 0.0}, target=1e-8)
    data = attractors(session, {"x": (-1.0, 1.0), "v": (-1.0, 1.0)})
    truth = np.asarray(jax.jacobian(known)(np.array([0.5, 1.0, 1.3])))
    names = ("x", "v", "multiplier", "exponent")
    exact = {name: dict(zip(("k", "f", "w"), truth[place], strict=True)) for place, name in enumerate(names)}
    check(data, exact, 1e-6)


def duffing(k=0.3, f=1.0, w=1.1):
    def rhs(y, t):
        x, v = y
        return v, f * jnp.cos(w * t) - k * v - x - x**3

    return {"rhs": rhs, "coordinates": ("x", "v"), "period": 2 * np.pi / w}


@pytest.mark.slow  # the driven line is quick
def test_differences_of_runs():
    """Six digits of differences of four whole runs, of fourth order."""
    session = jaxnh.Session(duffing, start={"x": 0.5, "v": 0.0}, target=1e-9)
    box = {"x": (0.4, 0.6), "v": (-0.1, 0.1)}
    data = attractors(session, box)
    assert data["kind"].to_numpy().tolist() == [0]
    for parameter, value in {"k": 0.3, "f": 1.0, "w": 1.1}.items():
        step = 2e-4 * value
        run = {k: attractors(session, box, **{parameter: value + k * step}) for k in (-2, -1, 1, 2)}
        for name in ("x", "v", "multiplier", "exponent"):
            near, far = (float(run[k][name][0] - run[-k][name][0]) for k in (1, 2))
            exact = (8 * near - far) / (12 * step)
            rate, error = (
                float(data[f"{name}_sensitivity{end}"].sel(parameter=parameter)[0]) for end in ("", "_error")
            )
            assert abs(rate - exact) <= 1e-6 * max(abs(exact), 0.1), (parameter, name, rate, exact, error)


def lorenz(sigma=10.0, rho=12.0, beta=8 / 3):
    def rhs(y, t):
        x, y, z = y
        return sigma * (y - x), x * (rho - z) - y, x * y - beta * z

    return {"rhs": rhs, "coordinates": ("x", "y", "z")}


def test_equilibria_of_a_flow():
    """Lorenz at ρ = 12: ±√(β (ρ − 1)), and the pair of eigenvalues that decides, by the equation
    λ³ + (σ + β + 1) λ² + (ρ + σ) β λ + 2 σ β (ρ − 1) = 0."""
    p = np.array([10.0, 12.0, 8 / 3])
    growth = max(np.roots([1, p[0] + p[2] + 1, (p[1] + p[0]) * p[2], 2 * p[0] * p[2] * (p[1] - 1)]), key=np.real)
    by_p = np.array(
        [
            growth**2 + p[2] * growth + 2 * p[2] * (p[1] - 1),
            p[2] * growth + 2 * p[0] * p[2],
            growth**2 + (p[1] + p[0]) * growth + 2 * p[0] * (p[1] - 1),
        ]
    )
    by_growth = 3 * growth**2 + 2 * (p[0] + p[2] + 1) * growth + (p[1] + p[0]) * p[2]
    exponent = np.real(-by_p / by_growth)
    session = jaxnh.Session(lorenz, start={"x": 1.0, "y": 1.0, "z": 20.0}, target=1e-8)
    data = attractors(session, {"x": (-9.0, 9.0), "y": (-9.0, 9.0), "z": (5.0, 15.0)})
    assert [KINDS[kind] for kind in data["kind"].to_numpy()] == ["equilibrium", "equilibrium"]
    assert np.allclose(data["exponent"], growth.real, atol=1e-9)
    root, sign = np.sqrt(p[2] * (p[1] - 1)), np.sign(data["x"].to_numpy())
    exact = {
        "x": {"sigma": 0.0, "rho": sign * p[2] / (2 * root), "beta": sign * (p[1] - 1) / (2 * root)},
        "z": {"sigma": 0.0, "rho": 1.0, "beta": 0.0},
        "exponent": dict(zip(("sigma", "rho", "beta"), exponent, strict=True)),
    }
    check(data, exact, 1e-9)
    assert np.isnan(data["multiplier_sensitivity"]).all()
