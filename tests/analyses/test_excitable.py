"""Stiff, excitable and bursting flows as users give them: Hodgkin and Huxley, Hindmarsh and Rose, three more by dysts."""

from __future__ import annotations

import functools

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxnh
from jaxnh.systems.status import STATUS
from tests.flows.excitable import FLOWS, by_heyoka, by_scipy, rates_with_tangents, spectrum
from tests.helpers.cases import some_slow
from tests.helpers.kept_programs import session_of


@pytest.fixture
def session_at(tmp_path):
    """A session of a flow by its name and a target, from a file as a user writes it."""

    def session(name, target):
        (tmp_path / "own.py").write_text(
            f"from tests.flows.excitable import FLOWS\n\n\ndef system():\n    return FLOWS[{name!r}].define()\n"
        )
        first, *others = [f"{key}: {value!r}" for key, value in FLOWS[name].begun.items()]
        axis = first.replace(": ", ": {values: [") + "]}"
        (tmp_path / "own.yaml").write_text(
            f"system: {{file: own.py}}\ninitial: {{{', '.join(others)}}}\nsweep: {{{axis}}}\n"
            f"accuracy: {{target: {target!r}}}\nanalyses:\n  portrait: {{transient: 1, periods: 1}}\n"
        )
        return session_of(jaxnh.load(tmp_path / "own.yaml"))

    return session


@functools.cache
def orbit_by_scipy(name, number, value):
    """Period, Floquet multipliers and mean divergence of a cycle through a coordinate at a value upwards, by DOP853."""
    flow, rates = FLOWS[name], rates_with_tangents(name)
    d = len(flow.start)
    exact = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}

    def crossing(t, z):
        return z[number] - value

    crossing.direction = 1.0
    field = jax.jit(lambda y: jax.numpy.stack(flow.define()["rhs"](tuple(y), 0.0)))
    passed = solve_ivp(
        lambda t, y: np.asarray(field(y)), (0.0, 40.0 * flow.unit), flow.start, events=crossing, **exact
    ).y_events[0][-1]  # fmt: skip
    begun = np.concatenate([passed, np.eye(d).ravel(), [0.0]])
    run = solve_ivp(rates, (0.0, 4.0 * flow.unit), begun, events=crossing, **exact)
    later = next(i for i, t in enumerate(run.t_events[0]) if t > 1e-6)
    period, end = run.t_events[0][later], run.y_events[0][later]
    assert np.abs(end[:d] - passed).max() < 1e-9 * np.abs(passed).max()
    return period, np.linalg.eigvals(end[d : d + d * d].reshape(d, d)), end[-1] / period


@pytest.mark.slow  # Newton on sections is quick, and so are the spectra of another cell
@pytest.mark.parametrize("target", [1e-6, 1e-8])
def test_the_orbit_of_hodgkin_and_huxley(session_at, target):
    """Its period within the target, which is of one return, and its largest multiplier, by scipy's DOP853 at 1e-12.

    Rates change e-fold over 10 mV, and what a step of order nine errs by with their ninth power, over a hundredth of the
    motion: by so much an error of the map's derivative is larger.
    """
    period, multipliers, _ = orbit_by_scipy("hodgkin_huxley", 0, 0.0)
    session = session_at("hodgkin_huxley", target).on(coordinate="v", value=0.0, direction="up")
    crossings = session.run(jaxnh.Poincare(transient=20, strobes=2))["t"].to_numpy().ravel()
    assert abs((crossings[1] - crossings[0]) / period - 1.0) < 2.0 * target
    orbit = session.run(jaxnh.Period(transient=20, max_period=4)).squeeze()
    assert int(orbit["period"]) == 1
    across = np.sort(np.abs(multipliers))[-2]  # the largest is that along the flow
    assert abs(float(orbit["multiplier"]) - across) < 100.0 * target


@pytest.mark.slow  # sums of exponents of other flows are quick
def test_the_exponents_of_hodgkin_and_huxley(session_at):
    """One that is known to be zero, and the mean divergence over the cycle as the sum of all."""
    _, _, divergence = orbit_by_scipy("hodgkin_huxley", 0, 0.0)
    run = session_at("hodgkin_huxley", 1e-6).run(jaxnh.Lyapunov(transient=32, periods=128, exponents=4))
    exponents, error = run["exponents"].to_numpy().ravel(), run["exponents_error"].to_numpy().ravel()
    assert exponents[0] == error[0] == 0.0
    assert (exponents[1:] + error[1:] < 0.0).all()
    assert abs(exponents.sum() / divergence - 1.0) < 1e-2  # the average is of no whole number of turns


@pytest.mark.parametrize(
    ("name", "other", "periods", "parts"),
    some_slow(
        {
            "quick": ("hindmarsh_rose", by_heyoka, 256, 16),
            "hindmarsh_rose": ("hindmarsh_rose", by_heyoka, 8192, 16),
            "excitable_cell": ("excitable_cell", by_scipy, 512, 8),
            "isothermal_chemical": ("isothermal_chemical", by_heyoka, 4096, 8),
            "circadian_rhythm": ("circadian_rhythm", by_heyoka, 512, 8),
        },
        "quick",
    ),
)
def test_spectra_beside_others(session_at, name, other, periods, parts):
    """At 1e-8, and all exponents: within twice the bars of both, which of 16 exponents one in 1e3 is to miss.

    What a finite window keeps of the tangents is allowed besides: a factor of 100 in their lengths.
    """
    d = len(FLOWS[name].start)
    run = session_at(name, 1e-8).run(jaxnh.Lyapunov(transient=64, periods=periods, exponents=d)).squeeze()
    assert STATUS[int(run["status"])] == "ok"
    exponents, error = run["exponents"].to_numpy(), run["exponents_error"].to_numpy()
    known, bar = spectrum(name, other(name), 64, periods, parts)
    window = periods * FLOWS[name].unit
    assert (np.abs(exponents - known) <= 2.0 * np.hypot(error, bar) + np.log(100.0) / window).all()
    assert abs(float(run["sum_rule_residual"])) < 1e-3 * np.abs(exponents).max()
