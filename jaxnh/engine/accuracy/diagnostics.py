"""Explanations for the user of a system: why no number of steps meets an accuracy, or why a map has no value.

Each cause is looked for on the motion that errs most, and named where it is there; that a field has a jump or a corner
is seen in `kinks`.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Complex, Float

from jaxnh.engine.accuracy.kinks import find_kink
from jaxnh.engine.accuracy.rounding import is_rounding, last_digit
from jaxnh.engine.accuracy.sample_maps import SampleMaps, Samples
from jaxnh.engine.accuracy.sizes import coordinate_names
from jaxnh.maps.section import Section, System, flow_of
from jaxnh.systems.degeneracy import describe_near_singularity, describe_singularity
from jaxnh.systems.flow import Flow, Parameters
from jaxnh.systems.rows import select, spread_indices
from jaxnh.systems.state import State, is_finite
from jaxnh.systems.user_functions import COMPILED_FOR_ONE_CALL

_LONG = 4.0  # times the median return: errors have grown in it
_STIFF = 200.0  # rates a unit of time that explicit steps of the reference do not follow
_UNRESOLVED = 1.0  # of a rate times a step: from here on explicit steps do not follow it
_STIFFER = 2.0  # times as fast as all else, at least, what is stiff decays
_UNSTABLE = 2.8  # of a rate times a step of the classical method, which from here on goes to infinity by itself
_ROUGHLY = 2048  # steps along a motion that is looked at
_FINER, _SAME_END = 4, 3.0  # times as many steps, with which infinity is as near, in steps, if it is the motion's own
_LOOKED_AT = 64  # states of these at which rates are
_MODERATE = 100.0  # times that a map enlarges a rounding, which is then that of a large number and not of chaos
_SHARE_OF_DIGIT = 1 / 128  # of an error: roundings of some 16,000 steps add up like their root, to no more
_LARGE = 100.0  # times the size of its motion, that a coordinate is far from zero


_DECAYS, _GROWS, _TURNS = (
    "the system is stiff",
    "motions near this one part as fast, as where one escapes",
    "the motion turns as fast",
)


class _FastestRates(NamedTuple):
    """The fastest rate of change at states of a motion.

    Steps that follow what grows or turns are as short for its own sake. Of what decays much faster than all else
    changes they have to be short for stability alone: that is stiff.

    Attributes:
        fastest: largest modulus of an eigenvalue.
        kind: what changes so fast.
    """

    fastest: float
    kind: str

    def describe(self, flow: Flow) -> str:
        """Describe the rates of a flow, for the user."""
        unit = "unit of time" if flow.autonomous else "period"
        return f"rates of change reach {self.fastest * flow.period:.2g} a {unit}: {self.kind}"


def fault_of(system: System, state: State, p: Parameters, first_look: str = "") -> str:
    """Explain why the map of a state, floats, has no value; "" where no cause is seen.

    Args:
        first_look: what a first look at the motion has seen.
    """
    if why := lost_rank(system, state, p):
        return why
    flow, state = flow_of(system), state.state if isinstance(system, Section) else state
    alone = jax.tree.map(lambda leaf: np.asarray(leaf)[None], state)
    if (rates := _fastest_rates(flow, np.zeros(1), alone, p)).fastest * flow.period > _STIFF:
        if first_look and rates.kind == _GROWS:
            return first_look
        time_unit = ", or give a smaller time_unit" if flow.autonomous else ""
        return f"{rates.describe(flow)}; slow down what is fast in it{time_unit}"
    if first_look:
        return first_look
    if isinstance(system, Section):
        return f"the section may not be met within {system.longest * flow.period:g} units of time"
    return ""


def describe_rates(system: System, state: State, p: Parameters) -> str:
    """Describe the fastest rates of change at a state, floats."""
    flow, state = flow_of(system), state.state if isinstance(system, Section) else state
    alone = jax.tree.map(lambda leaf: np.asarray(leaf)[None], state)
    return _fastest_rates(flow, np.zeros(1), alone, p).describe(flow)


def lost_rank(system: System, state: State, p: Parameters) -> str:
    """Explain what matrix is singular at a state, floats, or on the motion from it; "" where there is none."""
    flow, state = flow_of(system), state.state if isinstance(system, Section) else state
    return describe_singularity(flow, state, p) or describe_near_singularity(
        flow, *_motion(flow, state, p, flow.period), p
    )


def explain_long_returns(section: System, lengths: Float[np.ndarray, " samples"], worst: int) -> str:
    """Explain the largest error by the long returns of its sample to a section; "" where they are not long."""
    if isinstance(section, Section) and not np.isfinite(lengths[worst]):
        longest = section.longest * section.flow.period
        return f"it does not come back within {longest:.4g} units of time; a section that is met more often would do"
    if lengths[worst] > _LONG * np.nanmedian(lengths):
        return (
            f"it takes {lengths[worst]:.3g} units of time, which a section that is met more often would cut, and which "
            "a smaller longest_return leaves out"
        )
    return ""


def explain_chance_return(length: float) -> str:
    """Explain a return that some numbers of steps meet and others do not."""
    return (
        f"it comes back after {length:.3g} units of time or not at all, by chance; a smaller longest_return "
        "leaves that out"
    )


def explain_motion(maps: SampleMaps, sample: Samples, length: float | None = None) -> str:
    """Explain the least error of the sample that errs most by what is seen on its motion; "" where it is nothing.

    Constraints that nearly lose rank, a field that jumps or has a corner, or rates that steps do not follow.

    Args:
        sample: of one state.
        length: of its motion; by default a period or unit of time, or the part of it that maps go over.
    """
    flow, times, passed, p = _motion_of(maps, sample, length)
    if why := describe_near_singularity(flow, times, passed, p):
        return why
    if not np.all(finite := is_finite(passed)):
        rates = _fastest_rates(flow, times[:1], select(passed, slice(1)), p)
        # Of the steps that are to show the motion, and no fault of it.
        if rates.fastest * (times[1] - times[0]) > _UNSTABLE:
            return f"{rates.describe(flow)}; slow down what is fast in it, or ask for less"
        _, finer_times, finer, _ = _motion_of(maps, sample, length, _FINER * _ROUGHLY)
        if not np.all(still := is_finite(finer)):
            end, step = times[np.argmin(finite)], times[1] - times[0]
            moved = abs(finer_times[np.argmin(still)] - end) > _SAME_END * step
            return "" if moved else f"the motion goes to infinity at t = {end:.3g}"
        times, passed = finer_times, finer
    if kink := find_kink(flow, times, passed, p):
        return kink.description
    return _explain_rates(maps, flow, times, passed, p)


def order_on_motion(maps: SampleMaps, sample: Samples, *, located: bool = True) -> float:
    """Power of the steps with which the errors of any method fall on a sample's motion; infinite where it is smooth.

    Args:
        sample: of one state.
        located: whether steps end at switches.
    """
    kink = find_kink(*_motion_of(maps, sample), located=located)
    return kink.order if kink else math.inf


def explain_rounding(maps: SampleMaps, sample: Samples, sizes: Float[np.ndarray, " components"], error: float) -> str:
    """Explain an error by rounding, and the coordinate whose last digit matters most; "" where it is none."""
    if not is_rounding(maps, sample, sizes, error):
        return ""
    name, value, digit, change = last_digit(maps, sample, sizes)
    if change < _SHARE_OF_DIGIT * error:
        return "that is rounding, of all steps together; ask for less"
    size = sizes[coordinate_names(maps.flow).index(name)]
    words = f"that is rounding: {name} = {value:.4g} has a last digit of {digit:.1g}"
    if change * size < _MODERATE * digit and abs(value) > _LARGE * size:
        return f"{words}, and moves by {size:.2g} only; let it begin nearer to zero, or ask for less"
    autonomous = maps.flow.autonomous
    unit = "return" if maps.sectioned else "unit of time" if autonomous else "period"
    remedy = "take a section that is met more often, or ask for less" if maps.sectioned else "ask for less"
    return f"{words}, which a {unit} makes {change:.1g} of the size of the motion; {remedy}"


def _explain_rates(maps: SampleMaps, flow: Flow, times: np.ndarray, passed: State, p: Parameters) -> str:
    """Explain an error by rates on a motion that the most steps do not follow; "" where these do."""
    picked = spread_indices(len(times), _LOOKED_AT)
    rates = _fastest_rates(flow, times[picked], select(passed, picked), p)
    steps = max(1, maps.scheme.reference.most_steps(maps.tried))
    if rates.fastest * flow.period < _UNRESOLVED * steps:
        return ""
    return f"{rates.describe(flow)}; slow down what is fast in it, or ask for less"


def _motion_of(
    maps: SampleMaps, sample: Samples, length: float | None = None, steps: int = _ROUGHLY
) -> tuple[Flow, np.ndarray, State, Parameters]:
    """The flow of a sample of one state, times and states of its motion, and its parameters."""
    system = maps.flows[int(sample.row[0])]
    flow = flow_of(system)
    length = flow.period / maps.parts if length is None else length
    first = select(sample, 0)
    state = first.states.state if maps.sectioned else first.states
    return flow, *_motion(flow, state, first.p, length, steps), first.p


def _motion(flow: Flow, y: State, p: Parameters, length: float, steps: int = _ROUGHLY) -> tuple[np.ndarray, State]:
    """Times and states of a motion from t = 0 over a length of time, both ends too: the classical method of order 4."""
    h = length / steps
    times = h * np.arange(steps + 1)
    ends, weights = jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6.0

    @partial(jax.jit, compiler_options=COMPILED_FOR_ONE_CALL)
    def motion(y: State, p: Parameters) -> State:
        def step(y: State, t: Array) -> tuple[State, State]:
            def moved(by: ArrayLike, rate: State) -> State:
                return jax.tree.map(lambda a, b: a + by * b, y, rate)

            def stage(i: Array, carry: tuple[State, State]) -> tuple[State, State]:
                before, total = carry
                k = flow.rhs(t + ends[i] * h, moved(ends[i] * h, before), p)
                return k, jax.tree.map(lambda a, b: a + weights[i] * b, total, k)

            zero = jax.tree.map(jnp.zeros_like, y)
            rate = lax.fori_loop(0, 4, stage, (zero, zero))[1]  # a loop, as the field is most of the program
            return moved(h, rate), y

        end, passed = lax.scan(step, y, jnp.asarray(times[:-1]))
        return jax.tree.map(lambda each, last: jnp.concatenate([each, last[None]]), passed, end)

    return times, jax.tree.map(np.asarray, motion(jax.tree.map(jnp.asarray, y), p))


def _fastest_rates(flow: Flow, times: np.ndarray, states: State, p: Parameters) -> _FastestRates:
    """The largest modulus of the eigenvalues of a flow's linearisations at states (count,) of a motion, and its kind.

    Those that are not finite are left out; zero where all are.
    """

    @partial(jax.jit, compiler_options=COMPILED_FOR_ONE_CALL)
    @jax.vmap
    def jacobians(t: Array, y: State) -> Array:
        flat, whole = ravel_pytree(y)
        return jax.jacfwd(lambda z: ravel_pytree(flow.rhs(t, whole(z), p))[0])(flat)

    each = np.asarray(jacobians(jnp.asarray(times), jax.tree.map(jnp.asarray, states)))
    eigenvalues = np.linalg.eigvals(each[np.isfinite(each).all(axis=(1, 2))])
    if not eigenvalues.size:
        return _FastestRates(0.0, _DECAYS)
    return _rates_of(eigenvalues[np.argmax(np.abs(eigenvalues).max(axis=1))])


def _rates_of(eigenvalues: Complex[np.ndarray, " d"]) -> _FastestRates:
    """The fastest of a state's rates, and whether what decays is far faster than all else."""
    moduli, real, imaginary = np.abs(eigenvalues), np.real(eigenvalues), np.abs(np.imag(eigenvalues))
    growth, turning, decay = (
        float(np.max(moduli, initial=0.0, where=which))
        for which in (real > imaginary, np.abs(real) <= imaginary, -real > imaginary)
    )
    kind = _DECAYS if decay > _STIFFER * max(growth, turning) else _GROWS if growth >= turning else _TURNS
    return _FastestRates(float(moduli.max(initial=0.0)), kind)
