"""The loop over kicks against plain diffrax, the Taylor reference and jacfwd; its parameters one by one and together."""

from __future__ import annotations

import dataclasses

import diffrax
import jax
import numpy as np
import pytest

from jaxnh.engine.executor.lanes import LaneExecutor
from jaxnh.maps.build import make_return_map
from jaxnh.maps.iterate import derivatives, iterate, section_map
from jaxnh.maps.step_grids import step_grid
from jaxnh.solvers import SPLITTINGS
from jaxnh.systems.particle import CHART, constant_speed, disturbed_speed
from tests.flows.calm_particle import CALM, CALM_B, CALM_STATES, ROUNDOFF, P, image, one_lane, start_states, systems
from tests.flows.particle import twin
from tests.helpers import taylor
from tests.helpers.cases import some_slow
from tests.helpers.comparisons import same_leaves
from tests.helpers.convergence import FINEST, derivatives_apart, size
from tests.helpers.diffrax_solvers import SplittingSolver, isokinetic_terms
from tests.helpers.measurement import largest_difference

# ---- one period


@systems
@pytest.mark.parametrize(
    "name", ["strang2", pytest.param("blanes_moan6", marks=pytest.mark.slow)]
)  # the table is made alike for all; compiling more is slow
def test_kicks_are_diffeqsolve_on_the_same_grid(lanes, system, name):
    """The loop over the table of kicks is `SplittingSolver.step` under `diffeqsolve`, to rounding."""
    solver, steps = SPLITTINGS[name], 200
    grid = diffrax.StepTo(step_grid(system, steps, (0.0, system.period)))

    def solve(u, b):
        solution = diffrax.diffeqsolve(
            isokinetic_terms(system),
            SplittingSolver(solver),
            0.0,
            system.period,
            None,
            CHART.state(u),
            args={"b": b},
            stepsize_controller=grid,
        )
        return CHART.point(jax.tree.map(lambda leaf: leaf[-1], solution.ys))

    solved = jax.jit(jax.vmap(solve))(CALM_STATES, CALM_B)
    assert largest_difference(image(lanes, make_return_map(system, solver, steps)), solved).max() < ROUNDOFF


@systems
def test_compensated_sums(lanes, system):
    """Without the roundings of the sums, those of one kick's turn remain: a tenth at most of the error of plain sums."""
    exact = taylor.strobe(twin(system), CALM_B, CALM_STATES)
    plain, compensated = (
        largest_difference(image(lanes, make_return_map(system, FINEST, 100, compensated=c)), exact)
        for c in (False, True)
    )
    assert np.median(compensated) < 0.1 * np.median(plain)
    assert plain.max() < ROUNDOFF


def test_strobe_that_is_part_of_the_program():
    """Called by itself, inside another program, or handed over as an argument: the same map."""
    strobe = make_return_map(CALM["disturbed"], SPLITTINGS["blanes_moan6"], 100)
    state, p = jax.tree.map(np.asarray, one_lane())
    images = (
        strobe(state, p),
        jax.jit(lambda state, p: strobe(state, p))(state, p),
        jax.jit(lambda strobe, state, p: strobe(state, p))(strobe, state, p),
    )
    for one in images:
        assert largest_difference(CHART.point(one), CHART.point(images[0])) < ROUNDOFF


# ---- derivatives


def jacfwd(strobe, u, p):
    by_state, by_p = jax.jacfwd(lambda u, p: section_map(strobe, 1, u, p), argnums=(0, 1))(u, p)
    return section_map(strobe, 1, u, p), by_state, by_p


# Roundings are other ones in every table. A ratio of two single errors has any size by luck; root mean squares over
# sixteen tables and twelve derivatives of a lane do not.
TABLES = range(100, 116)


def root_mean_square(gaps):
    """Of differences (tables, lanes, 12), a lane."""
    return np.sqrt(np.mean(np.square(gaps), axis=(0, 2)))


def by_jacfwd(lanes, system, p, name):
    """Monodromy matrices and slopes in a parameter by `jax.jacfwd` of the plain map, table by table."""
    for steps in TABLES:
        strobe = make_return_map(system, FINEST, steps)
        _, by_state, by_p = lanes(jacfwd, (strobe,), (CALM_STATES, p), tile=16)
        yield by_state, by_p[name]


def by_tangents(lanes, system, p, name, compensated):
    """The same by our own tangents, with the image."""
    for steps in TABLES:
        strobe = make_return_map(system, FINEST, steps, compensated=compensated)
        yield lanes(derivatives, (strobe, np.int32(1)), (CALM_STATES, p), static=(name,), tile=16)


@pytest.mark.parametrize("system", some_slow(CALM, "disturbed"))
def test_derivatives_of_kicks(lanes, system):
    """At a hundred steps of order ten the calm map has come down to its roundings, and so have its derivatives.

    Those of no lane have more than twice the error of `jax.jacfwd`, against the reference; with compensated sums, whose
    tangents are not compensated but are taken along a better orbit, no more than that of plain sums.
    """
    exact, *right = taylor.strobe_jacobian(twin(system), CALM_B, CALM_STATES)
    theirs = root_mean_square([derivatives_apart(found, right) for found in by_jacfwd(lanes, system, P, "b")])
    for compensated, most in ((False, 2.0), (True, 1.0)):
        found = list(by_tangents(lanes, system, P, "b", compensated))
        assert max(np.max(largest_difference(image, exact)) for image, _, _ in found) < ROUNDOFF
        ours = root_mean_square([derivatives_apart(moved, right) for _, *moved in found])
        assert np.all(ours < most * theirs)
        assert np.all(ours < ROUNDOFF * size(*right))


@pytest.mark.slow
@pytest.mark.parametrize("system", CALM.values(), ids=CALM)
def test_derivatives_in_the_stiffness(lanes, system):
    """∂P/∂a in closed form is that of jacfwd, and that of the reference by differences.

    Of derivatives that each err by less than ROUNDOFF, one by twice the other, the difference is below three times it.
    The reference is in long double, and its differences of fourth order in h leave h⁴ beside rounding over h: 1e-10.
    """
    p, h = {**P, "a": np.full(len(CALM_B), system.a)}, taylor.REAL(1e-4)

    def moved(k):
        return taylor.strobe(dataclasses.replace(twin(system), a=taylor.REAL(system.a) + k * h), CALM_B, CALM_STATES)

    near, far = moved(1) - moved(-1), moved(2) - moved(-2)
    differences = ((8 * near - far) / (12 * h)).astype(float)
    theirs = list(by_jacfwd(lanes, system, p, "a"))
    for compensated in (False, True):
        ours = [(by_state, by_a) for _, by_state, by_a in by_tangents(lanes, system, p, "a", compensated)]
        gaps = [derivatives_apart(one, other) for one, other in zip(ours, theirs, strict=True)]
        assert np.all(root_mean_square(gaps) < 3 * ROUNDOFF * size(*theirs[0]))
        off = np.abs(ours[0][1] - differences).max(axis=1)
        assert np.all(off < (ROUNDOFF + 1e-10) * size(*theirs[0]))


def test_only_the_derivative_asked_for(lanes):
    """Without a name no derivative in a parameter; the other two are the same, to the rounding of another program."""
    strobe = make_return_map(CALM["disturbed"], FINEST, 100)
    with_it = lanes(derivatives, (strobe, np.int32(1)), (CALM_STATES, P), static=("b",), tile=16)
    without = lanes(derivatives, (strobe, np.int32(1)), (CALM_STATES, P), tile=16)
    assert without.by_parameter is None
    assert np.max(largest_difference(with_it.image, without.image)) < ROUNDOFF
    assert np.abs(with_it.monodromy - without.monodromy).max() < ROUNDOFF * np.abs(with_it.monodromy).max()


# ---- several parameters


@pytest.mark.parametrize("build", [constant_speed, disturbed_speed])
@pytest.mark.parametrize("compensated", [False, True])
def test_two_parameters_of_a_lane(lanes, build, compensated):
    """Lanes with an a and a b of their own are, bit for bit, those of systems that have one of them."""
    a, b = np.linspace(0.2, 1.2, 4), np.linspace(0.3, 5.7, len(CALM_B))
    solver, start, one = SPLITTINGS["blanes_moan6"], start_states(), np.int32(3)

    def end(system, p):
        return lanes(iterate, (make_return_map(system, solver, 60, compensated=compensated), one), (start, p))

    for value in a:
        both = end(build(), {"a": np.full(len(b), value), "b": b})
        same_leaves(both, end(build(a=value), {"b": b}))
    pairs = end(build(), {"a": np.resize(a, len(b)), "b": np.full(len(b), 5.2)})
    same_leaves(pairs, end(build(b=5.2), {"a": np.resize(a, len(b))}))


@systems
def test_two_parameters_against_the_reference(lanes, system):
    """One period of lanes that differ in a and b both, each against its own twin."""
    a = np.linspace(0.2, 1.2, len(CALM_B))
    found = lanes(section_map, (make_return_map(system, FINEST, 100), np.int32(1)), (CALM_STATES, {**P, "a": a}))
    exact = [
        taylor.strobe(dataclasses.replace(twin(system), a=own), b, u)[0]
        for own, b, u in zip(a.tolist(), CALM_B, CALM_STATES, strict=True)
    ]
    assert largest_difference(found, np.array(exact)).max() < ROUNDOFF


@pytest.mark.parametrize("name", ["blanes_moan6", "processed6"])
@pytest.mark.parametrize("compensated", [False, True])
def test_no_disturbance_is_constant_speed(lanes, name, compensated):
    """d = 0 has the table of constant speed and its states, bit for bit, derivatives as well."""
    still, constant = (
        make_return_map(system, SPLITTINGS[name], 60, compensated=compensated)
        for system in (disturbed_speed(d=0.0), constant_speed())
    )
    same_leaves((still.table, still.kicks, still.rest), (constant.table, constant.kicks, constant.rest))
    for function, static, tile in ((section_map, (), None), (derivatives, ("b",), 16)):
        one, other = (
            lanes(function, (s, np.int32(2)), (CALM_STATES, P), static=static, tile=tile) for s in (still, constant)
        )
        same_leaves(one, other)


def test_one_program_for_all_shared_parameters():
    """Speed and clock are data: sweeps over d, c and ω, and over splittings and steps, run through one program."""
    lanes = LaneExecutor()
    for d in (0.0, 0.05, 0.1, -0.3):
        lanes(
            iterate,
            (make_return_map(disturbed_speed(d=d), SPLITTINGS["blanes_moan6"], 60), np.int32(1)),
            (start_states(), P),
        )
    assert len(lanes.programs) == 1
    for system in (disturbed_speed(c=1.7), disturbed_speed(omega=1.5), disturbed_speed(a=0.3)):
        lanes(iterate, (make_return_map(system, SPLITTINGS["kahan_li8"], 40), np.int32(2)), (start_states(), P))
    assert len(lanes.programs) == 1
    spent = lanes.accounts.compile_seconds
    lanes(
        iterate, (make_return_map(disturbed_speed(d=0.2), SPLITTINGS["strang2"], 900), np.int32(1)), (start_states(), P)
    )
    assert lanes.accounts.compile_seconds == spent
