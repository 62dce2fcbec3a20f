"""The paper's four equations off the constraint: how a speed error grows, which b die, and what jaxnh makes of them."""

from __future__ import annotations

import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from matplotlib.figure import Figure

from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import iterate
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import constant_speed, disturbed_speed
from tests.flows.paper_equations import constrained_field
from tests.helpers.battery import worst

START = ((0.1, 0.1), (0.1, math.sqrt(0.99)))
SYSTEMS = {"d = 0": constant_speed(), "d = 0.1": disturbed_speed()}
pytestmark = pytest.mark.case("Off the constraint")


def speed_error(system, t, y):
    """(|v|² − s²)/s² of y = (x1, x2, y1, y2)."""
    return (y[1] ** 2 + y[3] ** 2) / (system.c + system.d * jnp.sin(t)) - 1.0


def runge_kutta_4(system, y, p, steps, periods, parts, t0=0.0):
    """|speed error| of one lane at `parts` moments of each period from t0, and the growth there predicted, by RK4.

    Off the constraint the error ε obeys d ln ε/dt = −2 (n·F)/s exactly, with n·F/s = F·v/s² along the orbit: a fifth
    component of the state holds its integral.
    """

    def field(t, z):
        x1, x2, y1, y2 = z[:4]
        f1, f2 = system.force((x1, y1), system.forcing(t), 1.0, p)
        rate = -2.0 * (f1 * x2 + f2 * y2) / (system.c + system.d * jnp.sin(t))
        return (*constrained_field(system, t, z[:4], p), rate)

    h = system.period / steps

    def add(z, k, w):
        return tuple(a + w * c for a, c in zip(z, k, strict=True))

    def step(i, z):
        t = t0 + jnp.float64(i) * h
        k1 = field(t, z)
        k2 = field(t + h / 2, add(z, k1, h / 2))
        k3 = field(t + h / 2, add(z, k2, h / 2))
        k4 = field(t + h, add(z, k3, h))
        return tuple(a + h / 6 * (p + 2 * q + 2 * r + s) for a, p, q, r, s in zip(z, k1, k2, k3, k4, strict=True))

    def part(z, j):
        first = (j % parts) * (steps // parts)
        z = lax.fori_loop(first, first + steps // parts, step, z)
        t = t0 + jnp.float64(first + steps // parts) * h
        return z, (speed_error(system, t, z), z[4])

    start = tuple(jnp.asarray(v, float) for v in (*y, 0.0))
    return lax.scan(part, start, jnp.arange(parts * periods))[1]


def rk4(system, y, p, periods):
    """|speed error| of one lane after each period, under RK4 with 2000 steps a period."""
    return runge_kutta_4(system, y, p, 2000, periods, 1)[0]


def adaptive_dopri8(system, y, p, periods):
    """|speed error| of one lane after each period, under diffrax's own Dopri8 with rtol = atol = 1e-9."""

    def period(y, _):
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, p: constrained_field(system, t, y, p)),
            diffrax.Dopri8(),
            0.0,
            system.period,
            1e-3,
            y,
            args=p,
            stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-9),
            max_steps=4000,
            throw=False,
        )
        end = tuple(jnp.where(solution.result == diffrax.RESULTS.successful, v[-1], jnp.nan) for v in solution.ys)
        return end, speed_error(system, 0.0, end)

    return lax.scan(period, tuple(jnp.asarray(v, float) for v in y), length=periods)[1]


@pytest.mark.slow
def test_growth_of_a_speed_error(battery, lanes):
    """An error put in on purpose grows by the predicted factor, as long as it stays small beside the speed."""
    count, put_in = (64, 1e-8) if battery.full else (8, 1e-8)
    b = np.linspace(5.3, 6.0, count)
    for name, system in SYSTEMS.items():
        state = jax.tree.map(lambda leaf: np.full(count, leaf), START)
        solver = SPLITTINGS["kahan_li8"]
        state = lanes(iterate, (make_return_map(system, solver, 240), np.int32(50)), (state, {"b": b}), tile=32)
        grown, predicted = [], []
        for t0 in system.period * np.arange(1, 8) / 8:
            here = lanes(
                iterate, (make_return_map(system, solver, 240, span=(0.0, t0)), np.int32(1)), (state, {"b": b}), tile=32
            )
            s = math.sqrt((system.c + system.d * math.sin(t0)) * (1 + put_in))
            (x, y), (n1, n2) = here
            flow = jax.jit(jax.vmap(lambda y, p, system=system, t0=t0: runge_kutta_4(system, y, p, 16000, 1, 64, t0)))
            error, expected = (np.asarray(v) for v in flow((x, s * n1, y, s * n2), {"b": b}))
            # Nothing to compare once it was damped down to what RK4 makes by itself, or has outgrown small.
            clear = (np.minimum.accumulate(expected, axis=1) > -4) & np.isfinite(error)
            clear &= np.maximum.accumulate(expected, axis=1) < math.log(1e-3 / put_in)
            grown += list(np.log(np.abs(error[clear]) / put_in))
            predicted += list(expected[clear])
        off = np.abs(np.array(grown) - predicted)
        battery.row(
            f"{name}, {len(off):,} moments on the orbits of {count} b in [5.3, 6]: growth of an error of 1e-8, up to "
            f"{math.exp(max(predicted)):.1e} times",
            float(np.quantile(off, 0.95)),
            0.01,
            "ln observed + 2∫n·F/s, 95 in 100:",
        )
        assert max(predicted) > math.log(10)


@pytest.mark.slow
def test_which_die(battery, lanes):
    """From the start state, on the constraint: four equations die on many b; unit vectors keep |n| = 1 on all.

    A step of RK4 leaves the constraint by its own error, which climbs of the force then enlarge up to 1e5 times
    (`test_growth_of_a_speed_error`). With 200 steps a period has an error of 4e-6, so that one such climb is death: some
    of 64 lanes must meet one in a hundred periods. With 2000 steps it is 1e-11: nobody dies in three periods, and over
    many, as many as fit into minutes here, several climbs without a descent between are rare; no number is asserted.
    """
    count = 64 if battery.full else 8
    b = np.linspace(5.3, 6.0, count)
    y = (0.1, 0.1, 0.1, math.sqrt(0.99))
    picture = Figure(figsize=(10.5, 6), layout="constrained")
    panels = picture.subplots(2, 1, sharex=True, sharey=True)
    for axes, (name, system) in zip(panels, SYSTEMS.items(), strict=True):
        many = np.linspace(5.3, 6.0, 64)
        coarse = jax.jit(jax.vmap(lambda p, s=system: runge_kutta_4(s, y, p, 200, 100, 1)[0]))({"b": many})
        alive = int(np.sum(lives(np.asarray(coarse))))
        battery.row(f"{name}, four equations, RK4, 200 steps, 100 periods at 64 b", alive, 63, "lanes that live:")
        equations = (
            ("RK4, 2000 steps", "o", 10_000 if battery.full else 3, rk4),
            ("Dopri8, 1e-9", "x", 400 if battery.full else 3, adaptive_dopri8),
        )
        for label, mark, periods, follow in equations:
            error = jax.jit(jax.vmap(lambda p, s=system, n=periods, follow=follow: follow(s, y, p, n)))({"b": b})
            error = np.abs(np.asarray(error))
            alive = lives(error)
            largest = np.max(np.where(np.isfinite(error), error, np.inf), axis=1)
            died = f"{count - alive.sum()} of {count}"
            axes.semilogy(
                b, np.clip(largest, 1e-16, 1e2), mark, ms=4, label=f"{label}, {periods:,} periods: {died} die"
            )
            dead = ", ".join(f"{value:.3f}" for value in b[~alive][:12]) or "none"
            more = " …" if np.sum(~alive) > 12 else ""
            first = (
                ""
                if alive.all()
                else f"; the first after {np.min(np.argmax(~bounded(error[~alive]), axis=1)):,} periods"
            )
            battery.note(f"{name}, four equations, {label}, {periods:,} periods: {died} b die ({dead}{more}){first}.")
            assert battery.full or alive.all()
        kept = hold_speed(battery, lanes, name, system, b)
        axes.semilogy(b, np.maximum(kept, 1e-16), ".", color="k", label="jaxnh, ||n| − 1|")
        axes.set(ylabel="largest relative speed error\n(dead: at the top)", title=name)
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1), fontsize=8)
    panels[1].set_xlabel("b")
    battery.picture(picture, "off_constraint", "Speed errors of the four equations and of unit vectors")


def bounded(error):
    """Where a relative speed error is below one."""
    return np.isfinite(error) & (error < 1)


def lives(error):
    """Which lanes have relative speed errors (lanes, periods) below one throughout."""
    return np.all(bounded(np.abs(error)), axis=1)


def hold_speed(battery, lanes, name, system, b):
    """jaxnh on the same b for long: the largest ||n| − 1| of all strobes, and whether late strobes are as early ones."""
    blocks, periods = (100, 1000) if battery.full else (10, 100)
    strobe = make_return_map(system, SPLITTINGS["blanes_moan6"], 120)
    state = jax.tree.map(lambda leaf: np.full(len(b), leaf), START)
    state = lanes(iterate, (strobe, np.int32(200)), (state, {"b": b}), tile=32)
    off, far = np.zeros((2, blocks, len(b)))
    for k in range(blocks):
        state, off[k], far[k] = lanes(watched, (strobe, np.int32(periods)), (state, {"b": b}), periods=periods, tile=32)
    shown = f"{name}, jaxnh, {len(b)} b, {blocks * periods:,} periods"
    battery.row(shown, worst(off.max(axis=0)), 1e-14, "largest ||n| − 1|")
    # On an attractor the means of blocks are alike, early and late. Five standard errors: 6e-7 by chance, a lane.
    early, late = np.split(far / periods, 2)
    error = np.sqrt((early.var(axis=0, ddof=1) + late.var(axis=0, ddof=1)) / (blocks / 2))
    parted = np.abs(early.mean(axis=0) - late.mean(axis=0)) / (error + 1e-9)  # 1e-9: what is left on a periodic orbit
    battery.row("the same, mean |q| of the late half against the early one", worst(parted), 5.0, "standard errors")
    return off.max(axis=0)


def watched(strobe, n, state, p):
    """A state n periods on, the largest ||n| − 1| met at strobes, and the sum of |q|."""

    def step(_, carry):
        z, off, far = carry
        z = strobe(z, p)
        (x, y), (n1, n2) = z
        return z, jnp.maximum(off, jnp.abs(jnp.sqrt(n1 * n1 + n2 * n2) - 1.0)), far + jnp.hypot(x, y)

    zero = jnp.zeros_like(state[0][0])
    return lax.fori_loop(0, n, step, (state, zero, zero))
