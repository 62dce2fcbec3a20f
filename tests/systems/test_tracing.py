"""Facts from tracing are looked up once for a structure, and the equations of a function are listed once."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.systems.tracing import cached_by_structure, listed_once


def test_answers_are_kept_by_structure_and_shapes():
    """Numbers of a tree decide nothing: they are zeros where it is looked at."""
    looks = []

    @cached_by_structure
    def largest(tree):
        looks.append(tree)
        return max(np.max(leaf) for leaf in jax.tree.leaves(tree))

    assert largest({"a": 3.0, "b": np.ones(2)}) == largest({"a": -1.0, "b": np.zeros(2)}) == 0.0
    assert len(looks) == 1
    largest({"a": 3.0, "b": np.ones(3)})
    largest({"a": 3.0})
    assert len(looks) == 3


def test_equations_are_listed_once_and_used_in_programs_alone():
    """In a program calls are those of the list, with equal equations once, and derivatives go through it."""
    calls = []

    @listed_once
    def energy(q, v):
        calls.append(q)
        return jnp.sin(q) * v + jnp.sin(q) * v * v

    assert float(energy(0.5, 2.0)) == float(jnp.sin(0.5) * 6.0)
    assert len(calls) == 1  # outside of programs it is called as written
    program = jax.make_jaxpr(lambda q, v: energy(q, v) + energy(v, q))(0.5, 2.0)
    assert len(calls) == 2
    assert [e.primitive.name for e in program.jaxpr.eqns].count("sin") == 2
    slope = jax.jit(jax.grad(energy))(0.5, 2.0)
    assert len(calls) == 2
    np.testing.assert_allclose(slope, 6.0 * np.cos(0.5), rtol=1e-15)
