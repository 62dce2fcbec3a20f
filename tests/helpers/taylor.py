"""Reference for the stroboscopic map and its period doublings: heyoka's Taylor integrator in 80-bit arithmetic.

Here live the flow in angle form, the map P of one strobe period with its first and second derivatives, periodic
orbits and period-doubling points by multiple shooting. Nothing here comes from the package under test, and no
known result is written down: every number is computed.

The state of a lane is (x, y, th): position, and the direction of the velocity s(t) (cos th, sin th). Whole turns of
the angle are taken out between periods, to keep its digits, never within the first: one period's map is smooth.
"""

import functools
import itertools
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar

import heyoka as hy
import numpy as np

# 64 bits of mantissa on x86. Elsewhere long double may be float64 or software quadruple: fall back to float64.
REAL = np.longdouble if np.finfo(np.longdouble).nmant == 63 else np.float64

TWO_PI = 8 * np.arctan(REAL(1))  # np.pi only has 53 bits

_LARGEST_STEP = 10.0  # of Newton on an orbit: the paper's motion is confined to |x|, |y| < 5, and a turn is 2 pi
_SHORTER = (256, 1024, 4096, 16384)  # parts of a period that a step must not exceed


def flow():
    """The variables x, y, th, the parameter b, and the equations; par[0..4] are b, a, c, d, omega."""
    x, y, th = hy.make_vars("x", "y", "th")
    b, a, c, d, omega = (hy.par[i] for i in range(5))
    s = hy.sqrt(c + d * hy.sin(hy.time))
    g = 1.0 + hy.sin(omega * hy.time)
    # Products, not powers: the Taylor recurrence of a power divides by its base, which an orbit takes through 0.
    f1 = b * y - g * x * (a + x * x)
    f2 = b * x - g * y * (1.0 + a * (y * y))
    cos, sin = hy.cos(th), hy.sin(th)
    return (x, y, th), b, [(x, s * cos), (y, s * sin), (th, (cos * f2 - sin * f1) / s)]


@dataclass(frozen=True)
class Parameters:
    """Parameters of the system other than b: squared speed c + d sin t, forcing 1 + sin(omega t)."""

    a: float = 0.5
    c: float = 1.0
    d: float = 0.0
    omega: float = 1.0
    equations: ClassVar = staticmethod(flow)  # another function for another system of three variables

    @property
    def period(self):
        """Strobe period: of sin(omega t), and if d is not 0 the least common one with sin t.

        Raises ValueError where sin t and sin(omega t) have no common period.
        """
        if self.d == 0:
            return TWO_PI / REAL(abs(self.omega))
        ratio = Fraction(self.omega).limit_denominator(1000)
        if not math.isclose(ratio, self.omega, rel_tol=1e-15):
            raise ValueError(f"sin t and sin({self.omega} t) have no common period")
        return TWO_PI * ratio.denominator

    def start(self, x1=0.1, x2=0.1, y1=0.1):
        """The state (3,) at t = 0 with velocity (x2, y2), y2 the positive root of the constraint."""
        x2 = REAL(x2)
        return np.array([x1, y1, np.arctan2(np.sqrt(REAL(self.c) - x2 * x2), x2)], dtype=REAL)


# The map and its derivatives


@functools.cache
def integrator(system, order, real, tol):
    """The integrator with the variational equations up to `order` in (x, y, th, b), and its state at time 0."""
    state, b, equations = system()
    if order:
        equations = hy.var_ode_sys(equations, [*state, b], order=order)
    # Compact mode runs a little slower, but without it second order takes minutes to compile.
    ta = hy.taylor_adaptive(
        equations,
        np.zeros(3, dtype=real),
        pars=np.zeros(5, dtype=real),
        tol=real(tol),
        fp_type=real if real is not np.float64 else float,
        compact_mode=order > 0,
    )
    return ta, ta.state.copy()


def turns(angle):
    """The whole turns in an angle, in radians and in the arithmetic of the angle."""
    return TWO_PI.astype(angle.dtype) * np.rint(angle / TWO_PI.astype(angle.dtype))


def propagate(par, b, state, order=0, periods=1, tol=None, real=REAL, longest=np.inf):
    """Yields lane by lane the integrator at the end of the last period: b () or (lanes,), state (lanes, 3).

    No step is longer than `longest`.
    """
    state = np.atleast_2d(np.asarray(state, dtype=real))
    b = np.broadcast_to(np.asarray(b, dtype=real), state.shape[:1])
    ta, at_zero = integrator(par.equations, order, real, float(np.finfo(real).eps if tol is None else tol))
    period = real(par.period)
    for b_lane, z in zip(b, state, strict=True):
        ta.pars[:] = [b_lane, real(par.a), real(par.c), real(par.d), real(par.omega)]
        ta.state[:] = at_zero
        ta.state[:3] = z
        for count in range(periods):
            ta.time = real(0)  # the clock never leaves [0, period]
            if count:
                ta.state[2] -= turns(ta.state[2])
            outcome = ta.propagate_until(period, max_delta_t=real(longest))[0]
            if outcome != hy.taylor_outcome.time_limit:
                raise ArithmeticError(f"integration stopped at t = {ta.time}, b = {b_lane}: {outcome}")
        yield ta


def strobe(par, b, state, periods=1, tol=None, real=REAL, longest=np.inf):
    """The states (lanes, 3) `periods` strobe periods after the states (lanes, 3) at t = 0; b () or (lanes,).

    `real` is the arithmetic and the dtype of the result, `tol` the relative error of a step (default: the unit
    roundoff of `real`), `longest` the longest step.
    """
    return np.array([ta.state.copy() for ta in propagate(par, b, state, 0, periods, tol, real, longest)])


@functools.cache
def batch_integrator(system, tol):
    """The integrator of as many lanes at once as the processor has float64 in a vector, and how many these are."""
    _, _, equations = system()
    n = hy.recommended_simd_size()
    return hy.taylor_adaptive_batch(equations, np.zeros((3, n)), pars=np.zeros((5, n)), tol=tol), n


def strobe_of_many(par, b, state, periods=1, tol=1e-15):
    """The strobe in float64, for one b and many states (lanes, 3), each with steps of its own: in a vector's lanes."""
    ta, n = batch_integrator(par.equations, tol)
    period, state = float(par.period), np.array(state, dtype=float)
    ta.pars[:] = np.array([b, par.a, par.c, par.d, par.omega], dtype=float)[:, None]
    for begin in range(0, len(state), n):
        lanes = np.minimum(np.arange(begin, begin + n), len(state) - 1)
        ta.state[:] = state[lanes].T
        for count in range(periods):
            ta.set_time(0.0)
            if count:
                ta.state[2] -= turns(ta.state[2])
            ta.propagate_until(period)
            if any(outcome[0] != hy.taylor_outcome.time_limit for outcome in ta.propagate_res):
                raise ArithmeticError(f"integration stopped at t = {ta.time}, b = {b}")
        state[lanes] = ta.state.T
    return state


def settled_strobe(par, b, state, known):
    """The states one period later, with steps shortened until that changes no lane by more than `known`.

    The length of a step is chosen by the largest component. One many orders below it that grows fast, as the distance
    from an invariant line does, is then lost between two steps, and in every precision alike.
    """
    image = strobe(par, b, state)
    for parts in _SHORTER:
        before, image = image, strobe(par, b, state, longest=par.period / parts)
        gap = image - before
        gap[..., 2] -= turns(gap[..., 2])
        if np.abs(gap).max() <= known:
            return image
    raise ArithmeticError(f"steps of 1/{parts} of a period still change the state by {np.abs(gap).max():.1e}")


def strobe_jacobian(par, b, state, tol=None, real=REAL):
    """One period's states (lanes, 3), monodromy matrices (lanes, 3, 3) and derivatives in b (lanes, 3)."""
    end = np.array([ta.state.copy() for ta in propagate(par, b, state, 1, 1, tol, real)])
    first = end[:, 3:].reshape(-1, 3, 4)
    return end[:, :3], first[..., :3], first[..., 3]


@functools.cache
def divergence_integrator(system):
    """The integrator of the flow with the integral of its divergence as a fourth variable, in `REAL`."""
    equations = system()[2]
    rate = hy.sum([hy.diff(right, x) for x, right in equations])
    equations = [*equations, (hy.make_vars("volume"), rate)]
    real = float if REAL is np.float64 else REAL
    return hy.taylor_adaptive(
        equations, np.zeros(4, REAL), pars=np.zeros(5, REAL), tol=np.finfo(REAL).eps, fp_type=real
    )


def divergence(par, b, points):
    """The integral of the divergence over the periods that begin at points (n, 3): the logarithm of a volume's growth."""
    ta, total = divergence_integrator(par.equations), REAL(0)
    ta.pars[:] = [REAL(b), REAL(par.a), REAL(par.c), REAL(par.d), REAL(par.omega)]
    for point in np.asarray(points, REAL):
        ta.state[:], ta.time = [*point, 0], REAL(0)
        outcome = ta.propagate_until(REAL(par.period))[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"integration stopped at t = {ta.time}, b = {b}: {outcome}")
        total += ta.state[3]
    return total


def multiplier_logs(par, n, b, points):
    """ln|mu| (3,) of a periodic orbit's points (n, 3), largest first, none of them from a difference of large numbers.

    Of the first from the product of the monodromy matrices, of the first two together from that of the matrices of
    their minors, of all three from the divergence.
    """
    blocks = strobe_jacobian(par, np.full(n, b), points)[1]
    pairs = list(itertools.combinations(range(3), 2))
    minors = np.zeros_like(blocks)
    for (i, rows), (j, columns) in itertools.product(enumerate(pairs), enumerate(pairs)):
        (p, q), (r, s) = rows, columns
        minors[:, i, j] = blocks[:, p, r] * blocks[:, q, s] - blocks[:, p, s] * blocks[:, q, r]
    first, both, whole = largest_log(blocks), largest_log(minors), float(divergence(par, b, points))
    return np.array([first, both - first, whole - both])


def largest_log(blocks):
    """ln of the largest eigenvalue's modulus of a product of matrices (n, 3, 3)."""
    product, log = np.eye(3, dtype=blocks.dtype), 0.0
    for block in blocks:
        product = block @ product
        size = np.abs(product).max()
        product, log = product / size, log + float(np.log(size))
    return log + float(np.log(np.abs(np.linalg.eigvals(product.astype(np.float64))).max()))


def strobe_hessian(par, b, state, tol=None, real=REAL):
    """One period's states (lanes, 3), first (lanes, 3, 4) and second (lanes, 3, 4, 4) derivatives in (x, y, th, b)."""
    end = np.array([ta.state.copy() for ta in propagate(par, b, state, 2, 1, tol, real)])
    first = end[:, 3:15].reshape(-1, 3, 4)
    packed = end[:, 15:].reshape(-1, 3, 10)
    second = np.empty((len(end), 3, 4, 4), dtype=real)
    for k, (i, j) in enumerate(itertools.combinations_with_replacement(range(4), 2)):
        second[:, :, i, j] = second[:, :, j, i] = packed[:, :, k]
    return end[:, :3], first, second


def enlargement(par, b, state, periods, parts=64):
    """The largest factor by which the flow enlarges a small error until the end of a period, of some from a state (3,).

    Errors are made at the beginning of any of the parts of a period: what is enlarged within may shrink before the end,
    or the other way round. In float64.
    """
    ta, at_zero = integrator(par.equations, 1, np.float64, np.finfo(np.float64).eps)
    ta.pars[:] = [float(value) for value in (b, par.a, par.c, par.d, par.omega)]
    ends, z, largest = np.linspace(0.0, float(par.period), parts + 1), np.array(state, np.float64), 0.0
    for _ in range(periods):
        z[2] -= turns(z[2])
        blocks = []
        for begin, end in itertools.pairwise(ends):
            ta.state[:] = at_zero
            ta.state[:3] = z
            ta.time = begin
            outcome = ta.propagate_until(end)[0]
            if outcome != hy.taylor_outcome.time_limit:
                raise ArithmeticError(f"integration stopped at t = {ta.time}, b = {b}: {outcome}")
            z = ta.state[:3].copy()
            blocks.append(ta.state[3:].reshape(3, 4)[:, :3].copy())
        rest = np.eye(3)
        for block in reversed(blocks):
            rest = rest @ block
            largest = max(largest, float(np.linalg.norm(rest, ord=2)))
    return largest


def attractor(par, b, state, periods):
    """The states (lanes, 3) after a plain transient, in float64: good for a guess, no more."""
    return strobe(par, b, state, periods, real=np.float64)


# Lyapunov exponents


def spectra(par, b, states, transient, periods, parts=8, tol=1e-11):
    """Growth of tangents (lanes, 3), a time, averaged from states (lanes, 3) over `periods` after `transient`; b (lanes,).

    Variational equations in float64, all lanes in one batch, orthonormalised by QR `parts` times a period.
    """
    state, _, equations = par.equations()
    lanes = len(states)
    system = hy.var_ode_sys(equations, [*state], order=1)
    ta = hy.taylor_adaptive_batch(system, np.zeros((3, lanes)), pars=np.zeros((5, lanes)), tol=tol, compact_mode=True)
    ta.pars[:] = np.array([np.broadcast_to(v, lanes) for v in (b, par.a, par.c, par.d, par.omega)], float)
    ta.state[:3] = np.asarray(states, float).T
    basis = np.broadcast_to(np.eye(3), (lanes, 3, 3))
    ends = np.linspace(0.0, float(par.period), parts + 1)
    logs = np.zeros((lanes, 3))
    for count in range(transient + periods):
        ta.state[2] -= turns(ta.state[2])
        for begin, end in itertools.pairwise(ends):
            ta.set_time(begin)
            ta.state[3:] = np.moveaxis(basis, 0, 2).reshape(9, lanes)
            ta.propagate_until(end)
            if any(outcome != hy.taylor_outcome.time_limit for outcome, *_ in ta.propagate_res):
                raise ArithmeticError(f"integration stopped at t = {ta.time}")
            basis, grown = np.linalg.qr(np.moveaxis(ta.state[3:].reshape(3, 3, lanes), 2, 0))
            if count >= transient:
                logs += np.log(np.abs(np.diagonal(grown, axis1=1, axis2=2)))
    return logs / (periods * float(par.period))


# Without a clock


def still_flow(constrained, cubic, coupled, damped):
    """The variables and equations without forcing, par[0..2] are b, a, c: (x, y, th) at speed √c, or (x, y, u, v) free."""
    x, y, th, u, v = hy.make_vars("x", "y", "th", "u", "v")
    b, a, c = (hy.par[i] for i in range(3))
    f1 = -x * (a + x * x) if cubic else -a * x
    f2 = -y * (1.0 + a * (y * y)) if cubic else -y
    if coupled:
        f1, f2 = f1 + b * y, f2 + b * x
    if constrained:
        s, cos, sin = hy.sqrt(c), hy.cos(th), hy.sin(th)
        return [(x, s * cos), (y, s * sin), (th, (cos * f2 - sin * f1) / s)]
    if damped:
        f1, f2 = f1 - a * u, f2 - a * v
    return [(x, u), (y, v), (u, f1), (v, f2)]


def crossings(
    state, b, number, count, *, a=0.5, c=1.0, direction=1, constrained=True, cubic=True, coupled=True, damped=True
):
    """Return where a motion from a state (d,) first passes zero in a position upwards (1), downwards (−1) or both (0).

    The `count` first states with their times, (count, d + 1). Without a constraint c and a state of three are not used.
    """
    equations = still_flow(constrained, cubic, coupled, damped)
    way = {1: hy.event_direction.positive, -1: hy.event_direction.negative, 0: hy.event_direction.any}[direction]
    found = []
    event = hy.nt_event(equations[number][0], lambda ta, t, d: found.append(t), direction=way, fp_type=REAL)
    start = np.asarray(state, dtype=REAL)
    used = np.array([b, a, c], dtype=REAL)[: 3 if constrained else 2]
    ta = hy.taylor_adaptive(equations, start, pars=used, fp_type=REAL, nt_events=[event])
    while len(found) < count:
        if ta.step()[0] != hy.taylor_outcome.success or ta.time > 1000:
            raise ArithmeticError(f"{len(found)} crossings up to t = {ta.time}")
    ta = hy.taylor_adaptive(equations, start, pars=used, fp_type=REAL)
    points = []
    for t in found[:count]:
        ta.propagate_until(t)
        points.append([*ta.state, t])
    return np.array(points, dtype=REAL)


def still_exponents(states, b, duration, transient=200.0, a=0.5, c=1.0, tol=1e-11):
    """The largest exponent (lanes,) at constant speed without forcing, from states (lanes, 3), averaged over a time.

    Variational equations in float64; the tangent is kept across the flow, along which the exponent is zero.
    """
    equations = still_flow(True, True, True, True)
    lanes = len(states)
    system = hy.var_ode_sys(equations, [variable for variable, _ in equations], order=1)
    ta = hy.taylor_adaptive_batch(system, np.zeros((3, lanes)), pars=np.zeros((3, lanes)), tol=tol, compact_mode=True)
    ta.pars[:] = np.broadcast_to(np.array([b, a, c], float)[:, None], (3, lanes))
    ta.state[:3] = np.asarray(states, float).T
    tangent, logs = np.tile([1.0, 0.3, -0.2], (lanes, 1)), np.zeros(lanes)
    for i in range(math.ceil(transient + duration)):
        ta.set_time(0.0)
        ta.state[3:] = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, lanes)).reshape(9, lanes)
        ta.propagate_until(1.0)
        tangent = np.einsum("ijl,lj->li", ta.state[3:].reshape(3, 3, lanes), tangent)
        x, y, th = ta.state[:3]
        s, cos, sin = math.sqrt(c), np.cos(th), np.sin(th)
        f1, f2 = b * y - x * (a + x * x), b * x - y * (1.0 + a * y * y)
        along = np.stack([s * cos, s * sin, (cos * f2 - sin * f1) / s], axis=-1)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        tangent -= (tangent * along).sum(axis=1, keepdims=True) * along
        size = np.linalg.norm(tangent, axis=1)
        tangent /= size[:, None]
        if i >= transient:
            logs += np.log(size)
    return logs / duration


# Periodic orbits


def closed(points, image):
    """Mismatch (n, 3) of an orbit: image of each point less the next point, whole turns of the angle left out."""
    gap = image - np.roll(points, -1, axis=0)
    gap[:, 2] -= turns(gap[:, 2])
    return gap


def cyclic(blocks, last=1.0):
    """The matrix (3n, 3n) of w -> A_k w_k - w_(k+1) for blocks A (n, 3, 3); the last row has -`last` w_0."""
    n = len(blocks)
    out = np.zeros((n, 3, n, 3))
    for k in range(n):
        out[k, :, k, :] += blocks[k]
        out[k, :, (k + 1) % n, :] -= np.eye(3) * (last if k == n - 1 else 1.0)
    return out.reshape(3 * n, 3 * n)


def periodic_orbit(par, n, b, points):
    """The period-n orbit (n, 3) near `points` (n, 3), by multiple shooting in float64."""
    points = np.array(points, dtype=np.float64)
    for _ in range(30):
        image, monodromy, _ = strobe_jacobian(par, b, points, real=np.float64)
        step = np.linalg.solve(cyclic(monodromy), -closed(points, image).ravel()).reshape(n, 3)
        points += step
        if not 1e-11 <= np.abs(step).max() < _LARGEST_STEP:
            break
    if not np.abs(step).max() < 1e-11:
        raise ArithmeticError(f"no orbit of period {n} found at b = {b}")
    if n > 1 and np.abs(closed(points[[0, n // 2]], points[[0, n // 2]])).max() < 1e-6:
        raise ArithmeticError(f"the orbit found at b = {b} has period {n // 2}, not {n}")
    return points


def orbit(par, n, b, state):
    """The states (n, 3) of one lane (3,) at the strobes 0..n-1, angles within half a turn, in float64."""
    points = [np.asarray(state, dtype=np.float64)]
    for _ in range(n - 1):
        points.append(strobe(par, b, points[-1], real=np.float64)[0])
    points = np.array(points)
    points[:, 2] -= turns(points[:, 2])
    return points


# Period doublings


@dataclass(frozen=True)
class DoublingInfo:
    """Further results of `doubling_point`; n is the period that doubles.

    residual: largest mismatch of the shooting equations
    error: bound of the error of b: its sensitivity to the mismatch, times the largest of the mismatch left, its
        change under a second tolerance, and one roundoff for each of some 64 steps of a period
    points, vectors: (n, 3) the orbit and the eigenvector of the multiplier -1 along it
    multipliers: (3,) eigenvalues of the product of the n monodromy matrices; the smallest are lost to roundoff
    steps: Newton steps taken
    """

    residual: float
    error: float
    points: np.ndarray
    vectors: np.ndarray
    multipliers: np.ndarray
    steps: int


def eigenvector(monodromy):
    """Multipliers (3,) of matrices (n, 3, 3) applied in turn, and the vectors (n, 3) of the one nearest to -1."""
    product = functools.reduce(lambda left, right: right @ left, monodromy)
    multipliers, vectors = np.linalg.eig(product.astype(np.float64))
    chain = [vectors[:, np.argmin(np.abs(multipliers + 1))].real]
    for matrix in monodromy[:-1]:
        chain.append(matrix @ chain[-1])
    chain = np.array(chain)
    return multipliers, chain / np.sqrt((chain**2).sum())


def mismatch(par, b, points, vectors, normal, tol, real):
    """Residual (6n + 1,) of: the orbit closes, the vectors close onto their negative, normal . vectors = 1."""
    image, monodromy, _ = strobe_jacobian(par, b, points, tol, real)
    following = np.concatenate([vectors[1:], -vectors[:1]])
    turned = (monodromy * vectors[:, None, :]).sum(axis=-1) - following
    return np.concatenate([closed(points, image).ravel(), turned.ravel(), [(normal * vectors).sum() - 1]])


def mismatch_jacobian(par, b, points, vectors, normal):
    """Its derivative (6n + 1, 6n + 1) in (points, vectors, b), in float64."""
    n, m = len(points), 3 * len(points)
    vectors = vectors.astype(np.float64)
    _, first, second = strobe_hessian(par, b, points, real=np.float64)
    bent = np.einsum("nijk,nj->nik", second[:, :, :3, :], vectors)
    out = np.zeros((2 * m + 1, 2 * m + 1))
    out[:m, :m] = cyclic(first[..., :3])
    out[:m, -1] = first[..., 3].ravel()
    for k in range(n):
        out[m + 3 * k : m + 3 * k + 3, 3 * k : 3 * k + 3] = bent[k, :, :3]
    out[m : 2 * m, m : 2 * m] = cyclic(first[..., :3], last=-1.0)
    out[m : 2 * m, -1] = bent[..., 3].ravel()
    out[-1, m : 2 * m] = normal.ravel()
    return out


def doubling_point(par, n, b_guess, state_guess, real=REAL):
    """Return where a period-n orbit has the multiplier -1: b, a state (3,) of the orbit, and a DoublingInfo.

    Newton on all n points, the n vectors and b at once (multiple shooting): no product of monodromy matrices is
    formed, and no error grows over more than one period. The residual is evaluated in `real`, the matrix and the
    steps in float64: as in iterative refinement the result has the accuracy of the residual.

    Raises ArithmeticError where Newton finds no such orbit, or one of half the period.
    """
    points = periodic_orbit(par, n, b_guess, orbit(par, n, b_guess, state_guess)).astype(real)
    b = real(b_guess)
    vectors = eigenvector(strobe_jacobian(par, b, points, real=real)[1])[1].astype(real)
    normal = vectors.astype(np.float64)
    sizes = [np.inf]
    for _ in range(30):
        residual = mismatch(par, b, points, vectors, normal, None, real)
        matrix = mismatch_jacobian(par, b, points, vectors, normal)
        step = np.linalg.solve(matrix, -residual.astype(np.float64))
        points = points + step[: 3 * n].reshape(n, 3)
        vectors = vectors + step[3 * n : -1].reshape(n, 3)
        b = b + real(step[-1])
        sizes.append(np.abs(step).max())
        if sizes[-2] / 8 < sizes[-1] < 1e-9:  # roundoff: the steps have stopped shrinking
            break
    else:
        raise ArithmeticError(f"no doubling of period {n} found near b = {b_guess}")
    residual = mismatch(par, b, points, vectors, normal, None, real)
    coarser = mismatch(par, b, points, vectors, normal, 16 * np.finfo(real).eps, real)
    noise = max(np.abs(residual).max(), np.abs(residual - coarser).max(), 64 * np.finfo(real).eps)
    sensitivity = np.abs(np.linalg.solve(matrix.T, np.eye(6 * n + 1)[-1])).sum()
    multipliers, _ = eigenvector(strobe_jacobian(par, b, points, real=real)[1])
    error = float(sensitivity * noise + np.finfo(real).eps * abs(b))
    info = DoublingInfo(float(np.abs(residual).max()), error, points, vectors, multipliers, len(sizes) - 1)
    return b, points[0], info


def cascade(par, b_guesses, start=None, real=REAL, first=1, before=None):
    """The doublings of the periods 1, 2, 4, ... times `first` met on the way through the rough b_guesses: a list of (b, state, info).

    The guesses, two at least, are good if each is off by much less than its distance to the next one.
    A transient from `start` (3,), by default `par.start()`, at `before`, well before the first guess, picks the attractor; midway
    between two doublings, where orbits attract fast, a transient finds the orbit of twice the period, and it is
    followed to the next guess.
    """
    state = par.start() if start is None else start
    before = 3 * b_guesses[0] - 2 * b_guesses[1] if before is None else before
    found = []
    for level, guess in enumerate(b_guesses):
        n = first * 2**level
        middle = before if level == 0 else (before + guess) / 2
        points = orbit(par, n, middle, attractor(par, middle, state, 300 + 60 * n)[0])
        for b in np.linspace(middle, guess, 5):
            points = periodic_orbit(par, n, b, points)
        b, state, info = doubling_point(par, n, guess, points[0], real)
        found.append((b, state, info))
        before = float(b)
        state = state + info.vectors[0] * (0.01 / np.abs(info.vectors[0]).max())  # off the orbit, now unstable
    return found
