"""The page and the figure of `sweeps.studies.critical_slowing`."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sweeps.studies.critical_slowing_study import (
    FACTOR,
    HALF_DIGIT,
    PAST,
    TABLES,
    THRESHOLDS,
    TURNS,
    Agreement,
    CascadeStudy,
    agreement,
    checked_rows,
    nearest_pair,
    needed_transient,
    slopes,
)

_PAGE = """\
# Critical slowing down and the published doubling points

`python -m sweeps.studies.critical_slowing`, after `make {tables}`: {cost}

{measured_at}

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

The transient and the threshold of the published values are not known: N and ε are two free numbers here, chosen to
fit. {checked} rows have a bias that exceeds the rounding of the sixth decimal. For each ε, how many of them one N has
within a factor of two at most, with which N, with which N at least half of them, and the N that they need one by one to
have the published bias itself:

{agreement}

So the published values are consistent with plain detection at
{consistent}.
{all_rows}That they were found so is not shown by this.

Of the pairs run, N = {transient:.0f} and ε = {threshold} come nearest to all rows: {near} of {checked} within a factor
of two{far}.

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


def page(studies: list[CascadeStudy], transients: np.ndarray, cost: str, measured_at: str) -> str:
    """The result in Markdown."""
    j, k = nearest_pair(studies)
    rows, ratios = [], {}
    for name, study in zip(TABLES, studies, strict=True):
        for i, n in enumerate(study.cascade.n):
            bias, published = study.bias[i, j, k], study.published_bias[i]
            values = f"{study.detected[i, j, k]:.6f}", f"{study.cascade.published[i]:.6f}"
            rows.append([name, _turn(n), *values, f"{bias:+.1e}", f"{published:+.1e}"])
            if i in checked_rows(study):
                ratios[f"{name} {_turn(n)}"] = bias / published
    far = [f"{row} ({ratio:.2g} times)" for row, ratio in ratios.items() if not 1 / FACTOR < ratio < FACTOR]
    found = [agreement(studies, transients, j) for j in range(len(THRESHOLDS))]
    return _PAGE.format(
        tables=" ".join(TABLES),
        measured_at=measured_at,
        cost=cost,
        **_agreement(found, len(ratios)),
        systems="".join(_system_page(study, transients) for study in studies),
        transient=transients[k],
        threshold=_power(THRESHOLDS[j]),
        checked=len(ratios),
        near=len(ratios) - len(far),
        far=f"; outside it {', '.join(far)}" if far else "",
        pair=_table(["table", "period", "b detected", "b published", "β detected", "β published"], rows),
    )


def _agreement(found: list[Agreement], checked: int) -> dict[str, str]:
    """The table of agreement, a line a threshold, and what it says."""
    rows = [
        [_power(epsilon), f"{a.most} of {checked}", _ends(a.best), _ends(a.half), _ends(a.each)]
        for epsilon, a in zip(THRESHOLDS, found, strict=True)
    ]
    head = ["ε", "most rows within a factor of two", "N with as many", "N with half of the rows", "N of the rows alone"]
    half = [
        f"ε = {_power(epsilon)} and N of {_ends(a.half)}"
        for epsilon, a in zip(THRESHOLDS, found, strict=True)
        if np.isfinite(a.half[0])
    ]
    all_rows = any(a.most == checked for a in found)
    return {
        "agreement": _table(head, rows),
        "consistent": (", ".join(half) + ": at least half of the rows within a factor of two") if half else "no N",
        "all_rows": "" if all_rows else f"No pair has all {checked} rows so. ",
    }


def _ends(span: tuple[float, float]) -> str:
    """A range of N, to two digits."""
    if not np.isfinite(span[0]):
        return "–"
    low, high = (f"{float(f'{end:.2g}'):.0f}" if np.isfinite(end) else "∞" for end in span)
    return low if low == high else f"{low}–{high}"


def _system_page(study: CascadeStudy, transients: np.ndarray) -> str:
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
        turns=TURNS,
        past=PAST,
        source=c.source,
        slopes=_table(["period", "κ", "γ", f"N*, ε = {powers[0]}", *(f"slope, ε = {p}" for p in powers)], law_rows),
        needs=_table(["period", "b", f"b, {c.source}", "β", *(f"N, ε = {p}" for p in powers)], need_rows),
    )


def _span(bias: np.ndarray, transients: np.ndarray, published: float) -> str:
    """N to two digits, or its range, for a published bias that is known to half a digit."""
    low, high = (needed_transient(bias, transients, published + d) for d in (HALF_DIGIT, -HALF_DIGIT))
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


def figure(studies: list[CascadeStudy], transients: np.ndarray) -> Figure:
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


def panel(ax: Axes, study: CascadeStudy, j: int, transients: np.ndarray) -> None:
    """All levels of one cascade at one threshold, onto an axis."""
    fine = np.geomspace(transients[0], transients[-1], 600)
    ax.axhspan(1e-12, HALF_DIGIT, color="0.93", zorder=0)
    ax.plot(fine, 1.2 / fine, ls="-.", lw=1, color="k")
    law = study.law.bias(study.cascade.n, fine, THRESHOLDS[j])
    for k, (beta, predicted) in enumerate(zip(study.bias[:, j], law, strict=True)):
        color: dict[str, Any] = {"color": f"C{k}"}
        ax.axhline(abs(study.published_bias[k]), ls="--", lw=1, **color)
        for sign, line, fill in ((1, "-", color["color"]), (-1, ":", "white")):
            ax.plot(fine, np.where(sign * predicted > 0, sign * predicted, np.nan), line, lw=1.2, **color)
            ax.plot(transients, np.where(sign * beta > 0, sign * beta, np.nan), "o", ms=5, mfc=fill, **color)
    ax.set(xscale="log", yscale="log", ylim=(1e-8, 2e-2), xlim=(fine[0] / 1.2, fine[-1] * 1.2))
