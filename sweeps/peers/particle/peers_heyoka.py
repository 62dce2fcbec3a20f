"""heyoka: the true results in long double, and its batch integrator as a contestant.

heyoka's tolerance sets the order of its Taylor series and nothing else (the step follows from the coefficients), so
the order is what is tuned: tol = e^(2 − 2 order). The steps could be cut further by `max_delta_t`: measured, an order
with shorter steps is always slower than the next order at the same error.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sweeps.peers.particle.peers_cases import Case
from sweeps.peers.particle.peers_scene import PERIODS, TRANSIENT, Errors, Scene, Setting, Truth, unit

try:
    import heyoka as hy
except ImportError as error:
    raise SystemExit(
        "sweeps.peers.particle.peers needs heyoka: pip install 'jaxnh[dev]' (or conda install heyoka.py)"
    ) from error

# 64 bits of mantissa on x86. Elsewhere long double may be float64 or software quadruple: fall back to float64.
REAL: Any = np.longdouble if np.finfo(np.longdouble).nmant == 63 else np.float64
TOLERANCE = 1e-18 if REAL is np.longdouble else 1e-15
MOST_ORDER = 30
CLOCK = "clock equations"
# Clock: sin t by heyoka's own time, or sin t and cos t as two more equations.
_FORMS = tuple(itertools.product(("angle", "unit vector"), ("time", CLOCK)))
_BATCHES = (1, 2, 4)  # in recommended SIMD sizes
_OPTIONS: tuple[tuple[str, ...], ...] = ((), ("fast_math",), ("compact_mode",), ("fast_math", "force_avx512"))
WIDE = 8  # lanes of a vector of 512 bits


def equations(a: float, c: float, d: float, form: str, clock: str) -> list[tuple[Any, Any]]:
    """Equations of motion as heyoka takes them; parameter 0 is b. Cubes are products: x**3 is NaN at x = 0."""
    b = hy.par[0]
    x, y = hy.make_vars("x", "y")
    sine, cosine = hy.make_vars("sine", "cosine") if clock == CLOCK else (hy.sin(hy.time), None)
    n1, n2 = hy.make_vars("n1", "n2")
    theta = hy.make_vars("theta")
    if form == "angle":
        n1, n2 = hy.cos(theta), hy.sin(theta)
    s = hy.sqrt(c + d * sine) if d else hy.expression(math.sqrt(c))
    g = 1.0 + sine
    f1 = b * y - g * (x * (a + x * x))
    f2 = b * x - g * (y * (1.0 + a * (y * y)))
    turn = (n1 * f2 - n2 * f1) / s
    motion = [(x, s * n1), (y, s * n2)]
    motion += [(theta, turn)] if form == "angle" else [(n1, -n2 * turn), (n2, n1 * turn)]
    return motion + ([(sine, cosine), (cosine, -sine)] if cosine is not None else [])


def tried_options(options: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the options that say something here: `force_avx512` only where the processor has such registers."""
    return [row for row in options if "force_avx512" not in row or hy.recommended_simd_size() >= WIDE]


def taylor_periods(
    motion: list[tuple[Any, Any]], dimension: int, period: Any
) -> Callable[[np.ndarray, float, int], np.ndarray]:
    """A function of (state, parameter, periods) to the state then, by Taylor integrations at 1e-18 in long double.

    Raises:
        ArithmeticError: when called, where the integrator stops on the way.
    """
    ta = hy.taylor_adaptive(
        motion,
        np.zeros(dimension, dtype=REAL),
        pars=np.zeros(1, dtype=REAL),
        tol=REAL(TOLERANCE),
        fp_type=REAL if REAL is not np.float64 else float,
    )

    def after(state: np.ndarray, value: float, periods: int) -> np.ndarray:
        ta.pars[0] = REAL(value)
        ta.state[:] = state
        for _ in range(periods):
            ta.time = REAL(0)
            outcome = ta.propagate_until(period)[0]
            if outcome != hy.taylor_outcome.time_limit:
                raise ArithmeticError(f"the reference stopped at t = {ta.time}, parameter {value}: {outcome}")
        return ta.state.copy()

    return after


def true_scene(case: Case) -> Scene:
    """The scene of a case, its ends of one period by a Taylor integration at 1e-18 in long double."""
    motion = equations(case.a, case.c, case.d, "angle", "time")
    after = taylor_periods(motion, 3, 8 * np.arctan(REAL(1)))
    start, values = np.array(case.start), case.values
    later = np.array([after(start, b, TRANSIENT) for b in values]).astype(float)
    later[:, 2] -= 2 * math.pi * np.rint(later[:, 2] / (2 * math.pi))
    states = np.concatenate([np.tile(start, (len(values), 1)), later])
    b = np.tile(values, 2)
    ends = np.array([after(z, value, 1) for z, value in zip(states, b, strict=True)])
    return Scene(case.a, case.c, case.d, b, states, unit(ends))


class Batches:
    """heyoka's batch integrators of a scene's lanes, made once for each form of the equations and each option.

    Args:
        equations: those of a form.
    """

    def __init__(self, equations: Callable[..., list[tuple[Any, Any]]]) -> None:
        self._equations = equations
        self._integrators: dict[tuple[object, ...], Any] = {}

    def __call__(
        self,
        start: np.ndarray,
        b: np.ndarray,
        times: tuple[float, float],
        form: tuple[str, ...],
        batch: int,
        options: tuple[str, ...],
        order: int,
    ) -> np.ndarray:
        """States (lanes, variables) of lanes b (lanes,) from one time to another, by one run through all of them."""
        ta = self.integrator(form, batch, options, order)
        ends = np.empty_like(start)
        for at in range(0, len(start), batch):
            part = slice(at, at + batch)
            ta.set_time(times[0])
            ta.pars[0] = b[part]
            ta.state[:] = start[part].T
            ta.propagate_until(times[1])
            ends[part] = ta.state.T
        return ends

    def integrator(self, form: tuple[str, ...], batch: int, options: tuple[str, ...], order: int) -> Any:
        key = (form, batch, options, order)
        if key not in self._integrators:
            motion = self._equations(*form)
            self._integrators[key] = hy.taylor_adaptive_batch(
                motion,
                np.zeros((len(motion), batch)),
                pars=np.zeros((1, batch)),
                tol=math.exp(2 - 2 * order),
                **dict.fromkeys(options, True),
            )
        return self._integrators[key]


class BatchContestant:
    """The batch integrator of a flow in all its forms: of the equations, batch size, and options of the compiler.

    Attributes:
        forms: of the equations, each a few words, by which `equations` makes them.
        options: of the compiler.
        periods: that one call of a timed program integrates over.
    """

    forms: Sequence[tuple[str, ...]]
    options: Sequence[tuple[str, ...]] = _OPTIONS
    periods = PERIODS

    def __init__(self, scene: Truth) -> None:
        self.scene = scene
        self._batches = Batches(self.equations)
        self._errors: dict[tuple[object, ...], Errors] = {}

    def equations(self, *form: str) -> list[tuple[Any, Any]]:
        """Equations of motion in a form; parameter 0 is the lane's."""
        raise NotImplementedError

    def starts(self, form: tuple[str, ...], lanes: np.ndarray) -> np.ndarray:
        """Start states (lanes, variables) of lanes in a form."""
        raise NotImplementedError

    def compared(self, form: tuple[str, ...], ends: np.ndarray) -> np.ndarray:
        """Return what is compared of states (lanes, variables): as the scene's `ends`."""
        raise NotImplementedError

    def tune(self, target: float, hints: Sequence[Setting] = (), only: bool = False) -> list[Setting]:
        simd = hy.recommended_simd_size()
        settings = []
        wanted = {hint.key for hint in hints}
        for form in self.forms:
            if only and not any(key[:-2] == form for key in wanted):
                continue
            order = self._least_order(form, target)
            for multiple, options in itertools.product(_BATCHES, tried_options(self.options)):
                batch = multiple * simd
                if only and (*form, batch, options) not in wanted:
                    continue
                default = form[-1] == "time" and not options
                settings.append(
                    Setting(
                        peer="heyoka batch, default options" if default else "heyoka batch",
                        form=", ".join((*form, f"batch of {batch}", *options)),
                        knob=order,
                        label=f"order {order} (tol {math.exp(2 - 2 * order):.1e})",
                        errors=self._measured(*form, batch, options, order),
                        key=(*form, batch, options),
                    )
                )
        # Reassociated sums can carry an error that just met the target over it.
        return [s for s in settings if s.errors.max <= target]

    def program(self, setting: Setting, idle: bool = False) -> Callable[[], float]:
        """Return the program, as for every contestant; idle with the same calls and no time to integrate over."""
        lanes = self.scene.timed()

        def run() -> float:
            self._propagate(lanes, 0 if idle else self.periods, (*setting.key, int(setting.knob)))
            return len(lanes) * self.periods

        return run

    def _least_order(self, form: tuple[str, ...], target: float) -> int:
        order = max(3, math.ceil(1 - 0.5 * math.log(target)) - 2)
        simd = hy.recommended_simd_size()
        while order > 3 and self._measured(*form, simd, (), order - 1).max <= target:
            order -= 1
        while self._measured(*form, simd, (), order).max > target:
            order += 1
            if order > MOST_ORDER:
                raise ArithmeticError(f"heyoka reaches no error of {target:g} in the form {' '.join(form)}")
        return order

    def _measured(self, *key: Any) -> Errors:
        if key not in self._errors:
            ends = self._propagate(np.arange(len(self.scene.b)), 1, key)
            self._errors[key] = self.scene.errors(self.compared(key[:-3], ends))
        return self._errors[key]

    def _propagate(self, lanes: np.ndarray, periods: int, key: tuple[Any, ...]) -> np.ndarray:
        """States (lanes, variables) some periods later, by one run through all of them: no stop at the strobes."""
        *form, batch, options, order = key
        times = 0.0, periods * self.scene.period
        start = self.starts(tuple(form), lanes)
        return self._batches(start, self.scene.b[lanes], times, tuple(form), batch, options, order)


class Contestant(BatchContestant):
    """The particle: angle or unit vector, and its clock."""

    scene: Scene
    forms = _FORMS

    def equations(self, *form: str) -> list[tuple[Any, Any]]:
        return equations(self.scene.a, self.scene.c, self.scene.d, *form)

    def starts(self, form: tuple[str, ...], lanes: np.ndarray) -> np.ndarray:
        start = (self.scene.states if form[0] == "angle" else self.scene.unit_states)[lanes]
        return with_clock(start) if form[1] == CLOCK else start

    def compared(self, form: tuple[str, ...], ends: np.ndarray) -> np.ndarray:
        return unit(ends[:, :3]) if form[0] == "angle" else ends[:, :4]


def with_clock(start: np.ndarray) -> np.ndarray:
    """States (lanes, d) and those of the clock equations at t = 0: its sine and cosine."""
    return np.column_stack([start, np.zeros(len(start)), np.ones(len(start))])
