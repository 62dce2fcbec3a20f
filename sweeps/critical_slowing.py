"""Why published doubling points come too early: critical slowing down in a plain detection of the period.

Run `python -m sweeps.critical_slowing` after `make table1 table2`. Each lane starts from the start state, waits for a
transient of N periods and compares strobe points with a threshold ε; multisection on the detected period gives the b at
which n seems to turn into 2n. Beside it stands what the multiplier at the doubling predicts. Reads result files, writes
a page and a figure; integration, orbits and derivatives are the package's.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import numpy as np
import typer
from jaxtyping import Array
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.console import Console
from rich.markdown import Markdown
from ruamel.yaml import YAML

from jaxnh import store, terminal
from jaxnh.experiment import Experiment
from jaxnh.lanes import Lanes, configure
from jaxnh.orbits import Orbit, find_orbit
from jaxnh.solvers import SPLITTINGS
from jaxnh.strobe import Strobe, iterate, make_strobe, record
from jaxnh.systems import State, chart, unchart

TABLES = ("table1", "table2")
THRESHOLDS = (1e-4, 1e-5, 1e-6)
TRANSIENTS = (100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000)
SOLVER, STEPS = "blanes_moan6", 128  # moves the doublings by less than 1e-9: the page says by how much

_POINTS = 7  # values of b that a multisection looks at, both ends included
_TILE = 64
_ROUNDS = 40
_FINE, _RELATIVE = 1e-9, 2e-3  # a detected b is known to the sum: in b, and of its move since the last N
_SETTLED = 4000  # periods after which Newton takes over in the search for the orbits of the prediction
_BESIDE, _SPLIT, _CENTRED = 0.05, 0.02, 1e-3  # offsets in b, as fractions of the distance to the next doubling
_CONVERGED = 1e-7
_TURNS, _PAST = 30, 0.3  # slopes are fitted from so many turns of the orbit up to this fraction of N*
_HALF_DIGIT = 5e-7  # the published b have six decimals


class Cascade(NamedTuple):
    """A computed cascade, the published one beside it, and what to integrate.

    Attributes:
        title: of the config.
        strobe, start: the map of one forcing period, and the start state of every lane.
        n: period of the orbit that doubles, (levels,).
        b: doubling points, (levels,).
        ahead: signed distance from each doubling to the next one, (levels,).
        published, source: the published b, (levels,), and where they are from.
    """

    title: str
    strobe: Strobe
    start: State
    n: np.ndarray
    b: np.ndarray
    ahead: np.ndarray
    published: np.ndarray
    source: str

    def before(self, b: np.ndarray) -> np.ndarray:
        """β, the distance of values (levels, ...) before their doublings; negative beyond them."""
        per_level = (-1,) + (1,) * (b.ndim - 1)
        return np.sign(self.ahead).reshape(per_level) * (self.b.reshape(per_level) - b)


class Law(NamedTuple):
    """What decides the bias near a doubling; each of shape (levels,).

    One turn (n periods) of the orbit takes the difference D of strobe points a turn apart to μ (1 − γ D² + …) D, with
    μ = −1 + κ β. Started far away, |D| falls below ε after N periods where β = (n / 2 κ N) ln(1 + κ β / (γ ε²)).

    Attributes:
        kappa: |dμ/db| at the doubling.
        gamma: coefficient of the cubic term: beyond the doubling the branches of 2n are √(κ |β| / γ) apart.
        shift: by how much the steps used here move the doubling in b.
    """

    kappa: np.ndarray
    gamma: np.ndarray
    shift: np.ndarray

    def crossing(self, n: np.ndarray, threshold: float) -> np.ndarray:
        """N*, at which the bias changes sign: there D is ε at the doubling itself. (levels,)."""
        return n / (2.0 * self.gamma * threshold**2)

    def bias(self, n: np.ndarray, transients: np.ndarray, threshold: float) -> np.ndarray:
        """Predicted β, (levels, transients): with s = κ β / (γ ε²) it is N / N* = ln(1 + s) / s."""
        s = np.concatenate([-1.0 + np.logspace(-14, -0.01, 4000), np.logspace(-3, 14, 40000)])
        of_ratio = np.interp(-transients / self.crossing(n, threshold)[:, None], -np.log1p(s) / s, s)
        return (self.gamma * threshold**2 / self.kappa)[:, None] * of_ratio


class Study(NamedTuple):
    """One cascade: its law, and the b and bias detected, (levels, thresholds, transients), NaN where there is none."""

    cascade: Cascade
    law: Law
    detected: np.ndarray
    bias: np.ndarray
    published_bias: np.ndarray


# ---- the plain detection


def strobe_points(strobe: Strobe, transient: Any, start: State, b: Any, count: int) -> Array:
    """x1 at `count` strobes after a transient, of one lane, (count,)."""
    return record(strobe, iterate(strobe, transient, start, b), b, count)[1][0][0]


def detected_period(x1: np.ndarray, threshold: np.ndarray) -> np.ndarray:
    """Least p with |x1(j + p) − x1(j)| below the threshold at p strobes on end; 0 if there is none.

    Args:
        x1: strobe points, (lanes, count); p up to count / 2 are tried.
        threshold: (lanes,).
    """
    period = np.zeros(len(x1), int)
    for p in range(x1.shape[1] // 2, 0, -1):
        period[np.abs(x1[:, p : 2 * p] - x1[:, :p]).max(axis=1) < threshold] = p
    return period


def detect(cascade: Cascade, lanes: Lanes, transients: np.ndarray) -> np.ndarray:
    """The b at which period n is not seen any more, (levels, thresholds, transients); NaN where none is found.

    For the first N it is searched for from the middle of one window of the cascade to the middle of the next; later
    around where b∞ + C/N through the two N before would have it. Either way both ends are looked at as well.
    """
    jobs = len(THRESHOLDS)
    n, b, ahead = (np.repeat(each, jobs) for each in (cascade.n, cascade.b, cascade.ahead))
    behind = np.repeat(np.append(cascade.ahead[:1], np.diff(cascade.b)), jobs)
    window = np.stack([b - 0.5 * behind, b + 0.5 * ahead])
    threshold = np.tile(THRESHOLDS, len(cascade.n))
    count = 2 * int(n[-1])
    found = np.full((len(n), len(transients)), np.nan)
    for k, transient in enumerate(transients):
        shared = (cascade.strobe, np.int32(transient), cascade.start)

        def doubled(b: np.ndarray, job: np.ndarray, shared: Any = shared) -> np.ndarray:
            x1 = lanes(strobe_points, shared, (b,), periods=shared[1] + count, tile=_TILE, static=(count,))
            period = detected_period(x1, threshold[job])
            return (period == 0) | (period > n[job])

        bracket, move = window.copy(), np.zeros(len(n))
        if k > 1:
            first, second, now = 1.0 / transients[k - 2 : k + 1]
            move = (found[:, k - 1] - found[:, k - 2]) * (second - now) / (first - second)
            reach = np.sign(ahead) * (0.3 * np.abs(move) + 10 * _FINE)
            near = found[:, k - 1] + move + np.array([[-1], [1]]) * reach
            bracket = np.where(np.isfinite(near), near, window)
        found[:, k] = _multisect(doubled, bracket, window, _FINE + _RELATIVE * np.nan_to_num(np.abs(move)))
    return found.reshape(len(cascade.n), jobs, len(transients))


def _multisect(
    doubled: Callable[[np.ndarray, np.ndarray], np.ndarray],
    bracket: np.ndarray,
    window: np.ndarray,
    tolerance: np.ndarray,
) -> np.ndarray:
    """Where `doubled`, of values and the jobs they belong to, turns true; brackets and windows are (2, jobs).

    A bracket that misses the turn moves on inside its window; NaN where the whole window misses it.
    """
    found = np.full(bracket.shape[1], np.nan)
    for _ in range(_ROUNDS):
        jobs = np.flatnonzero(np.abs(bracket[1] - bracket[0]) > tolerance)
        if not len(jobs):
            break
        values = np.linspace(bracket[0, jobs], bracket[1, jobs], _POINTS)
        seen = doubled(values.ravel(), np.tile(jobs, _POINTS)).reshape(values.shape)
        first = np.where(seen.any(axis=0), seen.argmax(axis=0), _POINTS)
        right = np.clip(first, 1, _POINTS - 1)
        narrowed = np.take_along_axis(values, np.stack([right - 1, right]), axis=0)
        width = values[-1] - values[0]
        aside = np.where(first == 0, values[0] - [[3.0], [0.0]] * width, values[-1] + [[0.0], [3.0]] * width)
        inside = (first > 0) & (first < _POINTS)
        bracket[:, jobs] = np.where(inside, narrowed, np.clip(aside, *np.sort(window[:, jobs], axis=0)))
        found[jobs] = np.where(inside, narrowed.mean(axis=0), np.nan)
    return found


# ---- the prediction


def section(strobe: Strobe, transient: Any, start: State, b: Any) -> Array:
    """Section coordinates of one lane after a transient, (3,)."""
    return chart(iterate(strobe, transient, start, b))


def measure_law(cascade: Cascade, lanes: Lanes) -> Law:
    """κ from the multiplier on both sides of each doubling, γ from the orbit of 2n a little beyond it."""
    strobe, ahead = cascade.strobe, cascade.ahead
    beyond = cascade.b + _SPLIT * ahead
    shared = (strobe, np.int32(_SETTLED), cascade.start)
    b = np.concatenate([cascade.b - _BESIDE * ahead, beyond])
    single, double = np.split(lanes(section, shared, (b,), periods=_SETTLED, tile=_TILE), 2)
    kappa, gamma, shift = (np.empty(len(ahead)) for _ in range(3))
    for k, n in enumerate(cascade.n):
        h = _CENTRED * ahead[k]
        orbit = _orbits(lanes, strobe, single[k], cascade.b[k] + h * np.array([-1, 0, 1]), n)
        mu = np.linalg.eigvals(orbit.monodromy).real.min(axis=1)
        kappa[k] = (mu[0] - mu[2]) / (2 * abs(h))
        shift[k] = (mu[1] + 1.0) / kappa[k]
        at = beyond[k : k + 1]
        start = unchart(_orbits(lanes, strobe, double[k], at, 2 * n).u.T)
        x1 = lanes(strobe_points, (strobe, np.int32(0)), (start, at), tile=8, static=(2 * int(n),))[0]
        gamma[k] = kappa[k] * _SPLIT * abs(ahead[k]) / np.max(np.abs(x1[n:] - x1[:n])) ** 2
    return Law(kappa, gamma, shift)


def _orbits(lanes: Lanes, strobe: Strobe, u: np.ndarray, b: np.ndarray, n: int) -> Orbit:
    """Orbits of period n at values of b, all from one start point."""
    orbit = lanes(find_orbit, (strobe, np.int32(n)), (np.broadcast_to(u, (len(b), 3)), b), tile=8)
    if not np.all(orbit.residual < _CONVERGED):
        raise RuntimeError(f"no orbit of period {n} was found near b = {b[0]:.9g}")
    return orbit


# ---- what is read off


def slopes(study: Study, transients: np.ndarray) -> np.ndarray:
    """d ln β / d ln N measured and predicted over the same N, (2, levels, thresholds); NaN with fewer than three N."""
    n = study.cascade.n
    fits = np.full((2, len(n), len(THRESHOLDS)), np.nan)
    for k, j in np.ndindex(fits.shape[1:]):
        last = _PAST * study.law.crossing(n, THRESHOLDS[j])[k]
        use = (transients >= _TURNS * n[k]) & (transients <= last) & (study.bias[k, j] > 0)
        if use.sum() > 2:
            both = study.bias[k, j], study.law.bias(n, transients, THRESHOLDS[j])[k]
            fits[:, k, j] = [np.polyfit(np.log(transients[use]), np.log(beta[use]), 1)[0] for beta in both]
    return fits


def needed_transient(bias: np.ndarray, transients: np.ndarray, target: float) -> float:
    """N at which a measured bias (transients,) first falls to a target; 0 if before those run, ∞ if after them."""
    bias, transients = bias[np.isfinite(bias)], transients[np.isfinite(bias)]
    k = next((k for k, beta in enumerate(bias) if beta <= target), -1)
    if k < 1:
        return np.inf if k < 0 else 0.0
    ends = bias[[k, k - 1]]
    if min(target, ends[0]) > 0:
        target, ends = np.log(target), np.log(ends)
    return float(np.exp(np.interp(target, ends, np.log(transients[[k, k - 1]]))))


def nearest_pair(studies: list[Study]) -> tuple[int, int]:
    """Index of the threshold and of the N whose biases come nearest to the published ones, all cascades together."""
    misfit = []
    for study in studies:
        rows = study.published_bias > 2 * _HALF_DIGIT
        detected = np.maximum(np.nan_to_num(study.bias[rows]), _FINE)
        misfit.append(np.abs(np.log(detected / study.published_bias[rows, None, None])))
    j, k = np.unravel_index(np.concatenate(misfit).mean(axis=0).argmin(), misfit[0].shape[1:])
    return int(j), int(k)


# ---- page

_PAGE = """\
# Critical slowing down and the published doubling points

`python -m sweeps.critical_slowing`, after `make {tables}`: {cost}

Plain detection: every value of b runs from the start state for N forcing periods; the period is then the least p with
|x1(j + p) − x1(j)| < ε at p strobes on end, and multisection finds the b at which n is not seen any more. Its bias β is
the distance by which that b lies before the doubling (negative: beyond it).

Prediction, with no fitted constant: a turn of the orbit, n periods, takes the difference D of strobe points a turn
apart to μ (1 − γ D²) D, where μ = −1 + κ β. From far away, |D| comes down to ε after N periods where
β = (n / 2κN) ln(1 + κβ / γε²): 1/N times a logarithm that falls slowly, zero at N* = n / 2γε², then −γε²/κ for ever.
κ = |dμ/db| is from the monodromy matrix, γ from the distance of the branches of 2n a little beyond the doubling.

![Bias against N](critical_slowing.png)
{systems}
## One transient for all rows?

Of the pairs run, N = {transient:.0f} and ε = {threshold} come nearest to all rows of both tables. Of the {checked} rows
whose bias exceeds the rounding of the sixth decimal, {near} have it within a factor of two{far}.

{pair}

At equal N a deeper level has fewer turns, N/n, but a multiplier that moves faster: n grows by 2 a level and κ by 4.67,
so that β falls to 0.43 of the level before. The windows fall to 0.21: seen in its own window, each level is twice as
biased as the one before. At deep levels the law is an upper bound more than a value: with few turns, or where the one
start state happens to land near the stable set of the orbit, D is smaller than it assumes (points below the lines).
"""

_SYSTEM = """
## {title}

Slope d ln β / d ln N measured (predicted), from {turns} turns up to {past} N*:

{slopes}

Transient N with which plain detection gives the value of the {source}; its last digit leaves a range:

{needs}
"""


def page(studies: list[Study], transients: np.ndarray, cost: str) -> str:
    """The result in Markdown."""
    j, k = nearest_pair(studies)
    rows, ratios = [], {}
    for name, study in zip(TABLES, studies, strict=True):
        for i, n in enumerate(study.cascade.n):
            bias, published = study.bias[i, j, k], study.published_bias[i]
            values = f"{study.detected[i, j, k]:.6f}", f"{study.cascade.published[i]:.6f}"
            rows.append([name, _turn(n), *values, f"{bias:+.1e}", f"{published:+.1e}"])
            if published > 2 * _HALF_DIGIT:
                ratios[f"{name} {_turn(n)}"] = bias / published
    far = [f"{row} ({ratio:.2g} times)" for row, ratio in ratios.items() if not 0.5 < ratio < 2.0]
    return _PAGE.format(
        tables=" ".join(TABLES),
        cost=cost,
        systems="".join(_system_page(study, transients) for study in studies),
        transient=transients[k],
        threshold=_power(THRESHOLDS[j]),
        checked=len(ratios),
        near=len(ratios) - len(far),
        far=f"; outside it {', '.join(far)}" if far else "",
        pair=_table(["table", "period", "b detected", "b published", "β detected", "β published"], rows),
    )


def _system_page(study: Study, transients: np.ndarray) -> str:
    """Tables of one cascade: the law with slopes, and the N that each published row asks for."""
    c, law = study.cascade, study.law
    measured, predicted = slopes(study, transients)
    crossing = law.crossing(c.n, THRESHOLDS[0])
    powers = [_power(threshold) for threshold in THRESHOLDS]
    law_rows, need_rows = [], []
    for k, n in enumerate(c.n):
        fits = [f"{m:.3f} ({p:.3f})" if np.isfinite(m) else "–" for m, p in zip(measured[k], predicted[k], strict=True)]
        law_rows.append([_turn(n), f"{law.kappa[k]:.4g}", f"{law.gamma[k]:.4g}", f"{crossing[k]:.1e}", *fits])
        beta = study.published_bias[k]
        spans = [_span(bias, transients, beta) for bias in study.bias[k]]
        need_rows.append([_turn(n), f"{c.b[k]:.9f}", f"{c.published[k]:.6f}", f"{beta:+.1e}", *spans])
    return _SYSTEM.format(
        title=c.title,
        turns=_TURNS,
        past=_PAST,
        source=c.source,
        slopes=_table(["period", "κ", "γ", f"N*, ε = {powers[0]}", *(f"slope, ε = {p}" for p in powers)], law_rows),
        needs=_table(["period", "b", f"b, {c.source}", "β", *(f"N, ε = {p}" for p in powers)], need_rows),
    )


def _span(bias: np.ndarray, transients: np.ndarray, published: float) -> str:
    """N to two digits, or its range, for a published bias that is known to half a digit."""
    low, high = (needed_transient(bias, transients, published + d) for d in (_HALF_DIGIT, -_HALF_DIGIT))
    if np.isinf(low):
        return f"> {transients[-1]:.0f}"
    ends = list(dict.fromkeys(f"{float(f'{end:.2g}'):.0f}" for end in (low, high) if np.isfinite(end)))
    return f"> {ends[0]}" if np.isinf(high) else "–".join(ends)


def _table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table, all columns flushed right."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, ["--:"] * len(head), *rows))


def _turn(n: int) -> str:
    return f"{n} → {2 * n}"


def _power(threshold: float) -> str:
    return "10" + str(round(np.log10(threshold))).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


# ---- figure


def figure(studies: list[Study], transients: np.ndarray) -> Figure:
    """Bias against N: a column a cascade, a row a threshold."""
    fig = Figure(figsize=(10.5, 11.5), layout="constrained")
    panels = fig.subplots(len(THRESHOLDS), len(studies), sharex=True, sharey=True, squeeze=False)
    for (j, i), ax in np.ndenumerate(panels):
        panel(ax, studies[i], j, transients)
        above = f"{studies[i].cascade.title}\n" if j == 0 else ""
        ax.set_title(f"{above}threshold ε = {_power(THRESHOLDS[j])}", fontsize=11)
    for ax in panels[-1]:
        ax.set_xlabel("transient N (forcing periods)")
    for ax in panels[:, 0]:
        ax.set_ylabel("bias |b detected − b| (dimensionless)")
    grey: dict[str, Any] = {"color": "0.3"}
    periods = enumerate(studies[0].cascade.n)
    key = [
        *(Line2D([], [], color=f"C{k}", lw=3, label=f"period {_turn(n)}") for k, n in periods),
        Line2D([], [], marker="o", ls="", **grey, label="detected too early"),
        Line2D([], [], marker="o", ls="", mfc="white", **grey, label="detected too late"),
        Line2D([], [], **grey, label="predicted (dotted: too late)"),
        Line2D([], [], ls="-.", lw=1, color="k", label="slope of 1/N"),
        Line2D([], [], ls="--", lw=1, **grey, label=f"bias of the {studies[0].cascade.source}'s table"),
        Line2D([], [], lw=8, color="0.9", label="within half of its last digit"),
    ]
    fig.legend(handles=key, loc="outside lower center", ncols=4, fontsize=10)
    return fig


def panel(ax: Axes, study: Study, j: int, transients: np.ndarray) -> None:
    """All levels of one cascade at one threshold, onto an axis."""
    fine = np.geomspace(transients[0], transients[-1], 600)
    ax.axhspan(1e-12, _HALF_DIGIT, color="0.93", zorder=0)
    ax.plot(fine, 1.2 / fine, ls="-.", lw=1, color="k")
    law = study.law.bias(study.cascade.n, fine, THRESHOLDS[j])
    for k, (beta, predicted) in enumerate(zip(study.bias[:, j], law, strict=True)):
        color: dict[str, Any] = {"color": f"C{k}"}
        ax.axhline(abs(study.published_bias[k]), ls="--", lw=1, **color)
        for sign, line, fill in ((1, "-", color["color"]), (-1, ":", "white")):
            ax.plot(fine, np.where(sign * predicted > 0, sign * predicted, np.nan), line, lw=1.2, **color)
            ax.plot(transients, np.where(sign * beta > 0, sign * beta, np.nan), "o", ms=5, mfc=fill, **color)
    ax.set(xscale="log", yscale="log", ylim=(1e-8, 2e-2), xlim=(fine[0] / 1.2, fine[-1] * 1.2))


# ---- command


class Missing(Exception):
    """A result file that is needed is not there, or not as it should be; the message says what to do."""


def read_cascade(path: Path) -> Cascade:
    """The cascade of a result file, and the published one that its config names.

    Raises:
        Missing: there is no such file, it has too few doublings, or its config names no published ones.
    """
    if not path.exists():
        raise Missing(f"{path} is not there: run `make {' '.join(TABLES)}` first")
    try:
        attrs, doubling = store.read_attrs(path), store.read_variables(path, "doubling")
    except store.StoreError as error:
        raise Missing(str(error)) from None
    experiment = Experiment.model_validate(YAML(typ="safe").load(attrs["config"]))
    compare = (experiment.compare or {}).get("doubling")
    found = np.isfinite(doubling["b"])
    if compare is None or found.sum() < 3:
        raise Missing(f"{path} has fewer than three doublings, or no published ones to compare with")
    b, gaps = doubling["b"][found], np.diff(doubling["b"][found])
    ahead = np.append(gaps, gaps[-1] ** 2 / gaps[-2])
    published = np.append(compare.columns()["b"], np.full(len(b), np.nan))[: len(b)]
    system = experiment.system.build()
    strobe = make_strobe(system, SPLITTINGS[SOLVER], STEPS)
    start = jax.tree.map(float, experiment.initial.state(system))
    n = doubling["period"][found].astype(int)
    return Cascade(experiment.title, strobe, start, n, b, ahead, published, compare.source)


def study_cascade(cascade: Cascade, lanes: Lanes, transients: np.ndarray) -> Study:
    """Prediction and plain detection of one cascade."""
    with lanes.stage(f"{cascade.title}: plain detection", 0):
        law = measure_law(cascade, lanes)
        detected = detect(cascade, lanes, transients)
    return Study(cascade, law, detected, cascade.before(detected), cascade.before(cascade.published))


def main(
    results: Annotated[Path, typer.Option(help="Folder to read from and to write to")] = Path("results"),
    longest: Annotated[int, typer.Option(help="Longest transient, in forcing periods", min=1000)] = TRANSIENTS[-1],
) -> None:
    """Show what a plain detection of the period makes of the doublings, beside the published values."""
    began = time.perf_counter()
    configure()
    try:
        cascades = [read_cascade(results / f"{name}.h5") for name in TABLES]
    except Missing as missing:
        print(missing, file=sys.stderr)
        raise typer.Exit(2) from None
    lanes = Lanes(terminal.progress(Console(stderr=True)))
    transients = np.array([n for n in TRANSIENTS if n <= longest], float)
    studies = [study_cascade(cascade, lanes, transients) for cascade in cascades]
    shift = max(float(np.abs(study.law.shift).max()) for study in studies)
    elapsed, processor = time.perf_counter() - began, time.process_time()
    cost = (
        f"{lanes.lane_periods:,.0f} lane-periods, {processor:.0f} s of processor time,\n"
        f"{elapsed:.0f} s by the clock on {len(lanes.devices)} cores. "
        f"{SOLVER} with {STEPS} steps a period moves the doublings by {shift:.0e} at most."
    )
    text = page(studies, transients, cost)
    Console().print(Markdown("\n".join(line for line in text.splitlines() if not line.startswith("!["))))
    path = results / "critical_slowing.md"
    path.write_text(text, encoding="utf-8")
    figure(studies, transients).savefig(path.with_suffix(".png"), dpi=90, pil_kwargs={"optimize": True})
    print(f"wrote {path} and {path.with_suffix('.png')}")


if __name__ == "__main__":
    typer.run(main)
