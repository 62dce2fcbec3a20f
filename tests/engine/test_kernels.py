"""Kernels for graphics cards, compiled as C++ for the host, against XLA's programs of the same functions."""

from __future__ import annotations

from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import jaxnh
from jaxnh.engine.executor import lanes as executor
from jaxnh.engine.executor import programs
from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.engine.kernels import cuda
from jaxnh.engine.kernels.source import shapes_of
from tests.helpers.host_kernels import COMPILER, HeldPrograms, run_kernel
from tests.helpers.kept_calibrations import calibrating_by, unless_given

pytestmark = pytest.mark.skipif(
    COMPILER is None, reason="kernels are tried on the host by a C++ compiler, which is missing"
)

TABLE = np.linspace(0.1, 2.0, 300).reshape(100, 3)
X = np.array([0.3, -1.2, 2.5, np.nan, 40.0])
V = np.random.default_rng(3).normal(size=(5, 4))


def elementary(table, x, v):
    y = jnp.sin(x) + jnp.cos(x) * jnp.exp(-x * x) - jnp.tanh(x) / (1.0 + jnp.abs(x)) + x**3 - x**-2
    z = (
        jnp.arctan2(x, v[0])
        + jnp.sqrt(jnp.abs(x))
        + jnp.hypot(v[1], v[2])
        + jnp.log1p(x * x)
        + jnp.round(x)
        + jnp.sign(x)
    )
    return (
        y,
        z,
        jnp.fmod(x, 0.7),
        jnp.maximum(x, 0.0),
        jnp.minimum(v, x),
        jnp.isfinite(x),
        jnp.where(x > 0, v, -v),
        x + 0.0,
    )


def places(table, x, v):
    i = jnp.argmax(v)
    return (
        v[i],
        v[jnp.array([3, 0])],
        v.at[i].add(2.0),
        v.at[9].set(1.0, mode="drop"),
        v.at[7].get(mode="fill", fill_value=jnp.nan),
        lax.dynamic_slice(v, (i,), (2,)),
        lax.dynamic_update_slice(v, jnp.ones(2), (i - 1,)),
        table[i],
        jnp.argmin(jnp.append(v, x)),
        jnp.roll(v, 1),
        jnp.pad(v, (1, 2)),
        jnp.flip(v.reshape(2, 2), 0).T,
        jnp.cumsum(v),
    )


def products(table, x, v):
    a = jnp.outer(v, v) + jnp.eye(4)
    return (
        a @ v,
        jnp.trace(a),
        table.T @ table[:, 0],
        (table * v[0]).max(axis=0),
        (table + x).sum(),
        jnp.einsum("ij,jk->ik", a, a),
    )


def loops(table, x, v):
    counted = lax.fori_loop(0, 50, lambda i, c: c + table[i, 0] * jnp.cos(c * table[i, 1]), v[0])
    own = lax.while_loop(
        lambda c: (c[0] < 1e3) & (c[1] < 400), lambda c: (c[0] * 1.1 + 1e-3, c[1] + 1), (jnp.abs(v[1]), 0)
    )
    last, each = lax.scan(lambda c, row: (c + row[0], c * row), x, table[:3], reverse=True)
    kept = lax.fori_loop(0, 40, lambda i, a: a.at[i].set(v[:2] * i), jnp.zeros((90, 2)))
    swapped = lax.fori_loop(0, 3, lambda i, c: (c[1], c[0] + c[1]), (v[2], v[3]))
    branch = lax.cond(v[0] > 0, lambda: jnp.stack([x, x]), lambda: v[:2])
    return (
        counted,
        own,
        last,
        each,
        kept,
        swapped,
        branch,
        lax.switch(jnp.argmax(v), [lambda: x, lambda: -x, lambda: 2 * x]),
    )


@pytest.mark.parametrize("function", [elementary, places, products, loops])
def test_operations(tmp_path, function):
    mine = run_kernel(tmp_path, function, (TABLE,), (X, V))
    theirs = jax.vmap(lambda x, v: function(jnp.asarray(TABLE), x, v))(X, V)
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(theirs), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


def roessler(a=0.2):
    return {
        "rhs": lambda y, t: (-y[1] - y[2], y[0] + a * y[1], 0.2 + y[2] * (y[0] - 5.7)),
        "coordinates": ("x", "y", "z"),
    }


def particle(analyses, **more):
    system = {"constraint": "constant_speed"}
    content = {"title": "kernels", "system": system, "initial": {"x1": 0.1, "x2": 0.1, "y1": 0.1}, **more}
    return jaxnh.Experiment.from_dict({"accuracy": {"target": 1e-6}, "analyses": analyses, **content})


@pytest.mark.parametrize(
    ("scene", "names"),
    [
        ("kicks", {"iterate", "derivatives", "record"}),
        pytest.param("section", {"iterate", "record"}, marks=pytest.mark.slow),
        pytest.param("tangents", {"begin", "advance"}, marks=pytest.mark.slow),
        pytest.param("tables", {"evaluate_block"}, marks=pytest.mark.slow),
    ],
)
def test_programs_of_analyses(tmp_path, scene, names):
    """Every program that an analysis runs, by its kernel: kicks, stacked tables, returns to a section."""
    held = HeldPrograms(tmp_path)
    along = {"b": {"start": 2.0, "stop": 2.6, "count": 4}}  # no chaos, which would lead last bits apart
    spectra, period = {"lyapunov": {"transient": 16, "periods": 16}}, {"period": {"transient": 16, "max_period": 2}}
    with held.patch():
        if scene == "section":
            session = jaxnh.Session(roessler, start={"x": 1.0, "y": 1.0, "z": 0.0}, target=1e-6)
            section = session.on(coordinate="x", value=0.0, direction="up")
            section.run(jaxnh.Period(transient=16, max_period=2), a=[0.2, 0.21])
        elif scene == "tables":
            jaxnh.run(
                particle(
                    {"lyapunov": {"transient": 16, "periods": 16, "exponents": 1}},
                    system={"constraint": "disturbed_speed"},
                    sweep={**along, "d": {"start": 0.0, "stop": 0.1, "count": 8}},
                )
            )
        else:
            jaxnh.run(particle(period if scene == "kicks" else spectra, sweep=along))
    assert names <= set(held.held) | set(held.without)
    assert not held.without
    assert held.apart < 1e-11


def test_what_kernels_do_not_know_is_left_to_xla():
    shared, lane = (shapes_of(np.eye(3)),), (jax.ShapeDtypeStruct((3,), float),)
    assert cuda.find_kernel(lambda s, one: jnp.linalg.solve(s[0], one[0]), shared, lane) is None


def test_a_kernel_in_a_program_for_cuda():
    """One call of XLA's for kernels, and no loop around it."""
    x = np.linspace(0.0, 1.0, 256)

    def lower(traced):
        lowered.append(traced.lower(lowering_platforms=("cuda",)).as_text())
        raise StopIteration

    lowered, one = [], programs.Programs(kept=False)
    lanes = jax.ShapeDtypeStruct(x.shape, x.dtype)
    with (
        mock.patch.object(programs, "capability_of", return_value="90"),
        mock.patch.object(programs, "takes_count", return_value=True),
        mock.patch.object(cuda, "compile_kernel", lambda text, architecture: f'.entry "{architecture}"\n'),
        mock.patch.object(programs, "_lower", lower),
        pytest.raises(StopIteration),
    ):
        one.find(_settle, (), (np.float64(0.5),), (lanes,), jax.devices()[:1], executor.Accounts())
    (text,) = lowered
    assert text.count("__gpu$xla.gpu.ptx") == 1
    assert "stablehlo.while" not in text
    for word in ("grid_x = 2", "block_x = 128", "compute_90", "output_indices = [3]"):
        assert word in text


def _settle(rate, x):
    return lax.fori_loop(0, 1000, lambda i, y: rate * y * (1.0 - y), x)


@pytest.mark.usefixtures("quick_compiling_once")
@pytest.mark.parametrize(
    ("analysis", "options", "names"),
    [
        ("diagram", {"transient": 8, "strobes": 4}, ["x1"]),
        ("period", {"transient": 8, "max_period": 2}, ["period", "multiplier"]),
        pytest.param(
            "lyapunov",
            {"transient": 8, "periods": 16, "exponents": 1},
            ["exponents", "exponents_error"],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_card_computes_what_the_host_does(analysis, options, names):
    """The executor's way on a card, in large tiles with each lane at its own table, on CPU devices."""
    chart = {
        "analyses": {analysis: options},
        "system": {"constraint": "disturbed_speed"},
        "sweep": {"b": {"start": 5.2, "stop": 5.6, "count": 3}, "d": {"start": 0.0, "stop": 0.1, "count": 5}},
        "accuracy": {"solver": "blanes_moan6", "steps": 60},
    }
    with calibrating_by(unless_given):
        host = jaxnh.run(particle(**chart))
        with (
            mock.patch.object(LaneExecutor, "on_card", property(lambda self: True)),
            mock.patch.object(executor, "_ON_CARD", (16, 64)),
        ):
            card = jaxnh.run(particle(**chart))
    for name in names:
        np.testing.assert_allclose(card[analysis][name], host[analysis][name], rtol=1e-6, atol=1e-9)
