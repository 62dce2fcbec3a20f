"""How many of random cases bars cover: bifurcations, their derivatives, and connections, all in closed form.

    python -m sweeps.studies.coverage [maps flows loops shares] [--cases 20] [--seed 0] [--target 1e-6]

maps: folds and doublings of x → a + c x + d x² + e x³, and their derivatives in c, d and e, in extended precision.
flows: r′ = r (mu + a r² − b r⁴) has a fold of cycles at mu = −a²/4b, and across its cycles what begins to turn at
mu = nu, in coordinates that are bent. loops: the loop of Sandstede's flow is homoclinic at mt = 0, here mt = p + c1 q +
c2 q². shares: of the basins of a bistable map whose boundary is the point c.

A case that was not found, or for which no solver has the target, is counted as such and in no share.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

import jaxnh
from jaxnh.orbits.continuation.kinds import KINDS

NEAR = 1e-3  # of a value in closed form: what is further is another bifurcation

Rows = defaultdict[str, list[tuple[float, float]]]
"""Misses and bars by what they are of."""


def cubic(a: Any = 0.0, c: Any = 0.5, d: Any = 1.0, e: Any = 0.1) -> dict[str, Any]:
    """A map of one coordinate."""
    return {"map": lambda s: a + c * s[0] + d * s[0] ** 2 + e * s[0] ** 3, "coordinates": "x"}


def tube(
    mu: Any = 0.3,
    a: Any = 0.5,
    b: Any = 1.0,
    omega: Any = 1.5,
    sigma: Any = 0.3,
    nu: Any = 0.4,
    eta: Any = 0.5,
    bend: Any = 0.3,
) -> dict[str, Any]:
    """A cycle across which two coordinates turn and grow as mu − nu."""

    def rhs(s: Any, t: Any) -> tuple[Any, ...]:
        x, v, z, w = s
        y = v - bend * x * x
        z = z - bend * x * y
        square = x * x + y * y
        turn, growth = omega + sigma * square, mu + a * square - b * square * square
        dx, dy = growth * x - turn * y, growth * y + turn * x
        across = mu - nu - z * z - w * w
        dz, dw = across * z - eta * w, across * w + eta * z
        return dx, dy + 2 * bend * x * dx, dz + bend * (dx * y + x * dy), dw

    return {"rhs": rhs, "coordinates": ("x", "y", "z", "w")}


def loop(p: Any = 0.0, q: Any = -0.3, c1: Any = 0.3, c2: Any = 0.2, bend: Any = 0.2) -> dict[str, Any]:
    """A saddle loop in the plane, in coordinates that are bent (Sandstede 1997)."""

    def rhs(s: Any, t: Any) -> tuple[Any, ...]:
        x, v = s
        y, push = v - bend * x * x, p + c1 * q + c2 * q * q
        dx = q * x + y - q * x * x + push * x * (2.0 - 3.0 * x)
        dy = x + q * y - 1.5 * x * x - 1.5 * q * x * y - 2.0 * push * y
        return dx, dy + 2 * bend * x * dx

    return {"rhs": rhs, "coordinates": ("x", "y")}


def bistable(c: Any = 0.3) -> dict[str, Any]:
    """A map with basins x < c and x > c in |x − c| < √3."""

    def image(s: Any) -> Any:
        u = s[0] - c
        return c + 1.5 * u - 0.5 * u * u * u

    return {"map": image, "coordinates": "x"}


def of_bifurcations(data: xr.Dataset, axis: str, truth: dict[str, tuple[float, dict[str, float]]], rows: Rows) -> None:
    """Add what values and derivatives of bifurcations miss, of each kind one with its value and derivatives."""
    for kind, (value, rates) in truth.items():
        at = np.flatnonzero(data["kind"].to_numpy() == KINDS.index(kind))
        gaps = np.abs(data[axis].to_numpy()[at].astype(np.longdouble) - value)
        if not len(at) or gaps.min() > NEAR:
            rows[f"{kind}, not found"].append((0.0, np.nan))
            continue
        point = data.isel(bifurcation=int(at[np.argmin(gaps)]))
        rows[f"{kind}, value"].append((float(gaps.min()), point[f"{axis}_error"].item()))
        for name, rate in rates.items():
            own = point.sel(parameter=name)
            miss = abs(np.longdouble(own[f"{axis}_sensitivity"].item()) - rate)
            rows[f"{kind}, derivatives"].append((float(miss), own[f"{axis}_sensitivity_error"].item()))


def critical(multiplier: float, c: float, d: float, e: float) -> tuple[Any, dict[str, Any]]:
    """The value of a at which the cubic map's fixed point has a multiplier ±1, and its derivatives."""
    roots = np.roots([3 * e, 2 * d, c - multiplier]).real
    x = np.longdouble(roots[np.argmin(np.abs(roots))])
    for _ in range(3):
        x -= (c + 2 * d * x + 3 * e * x * x - multiplier) / (2 * d + 6 * e * x)
    moved = -(1.0 - multiplier) / (2 * d + 6 * e * x)
    rates = {"c": -x + moved, "d": -x * x + 2 * x * moved, "e": -(x**3) + 3 * x * x * moved}
    return x - c * x - d * x * x - e * x**3, rates


def maps(rng: np.random.Generator, cases: int, target: float) -> Rows:
    """Folds and doublings of cubic maps."""
    rows, session = Rows(list), jaxnh.Session(cubic, start={"x": 0.0})
    options = jaxnh.Branches(max_period=1, sensitivities=True, n_starts=4, n_values=4, box={"x": (-2.0, 2.0)})
    for _ in range(cases):
        fixed = {"c": rng.uniform(-0.6, 0.6), "d": rng.uniform(0.5, 2.0), "e": rng.uniform(-0.05, 0.05)}
        truth = {"fold": critical(1.0, **fixed), "period_doubling": critical(-1.0, **fixed)}
        low, high = sorted(float(value) for value, _ in truth.values())
        over = np.linspace(1.3 * low - 0.3 * high, 1.3 * high - 0.3 * low, 8)
        of_bifurcations(session.groups({"branches": options}, a=over, **fixed)["bifurcations"], "a", truth, rows)
    return rows


def flows(rng: np.random.Generator, cases: int, target: float) -> Rows:
    """Folds of cycles and tori."""
    rows, start = Rows(list), {"x": 0.9, "y": 0.1, "z": 0.01, "w": 0.0}
    session = jaxnh.Session(tube, start=start, target=target).on("x", 0.0, "down")
    ranges = {
        "a": (0.3, 1.0),
        "b": (0.7, 1.3),
        "omega": (1.2, 2.5),
        "sigma": (-0.4, 0.5),
        "nu": (0.15, 0.45),
        "eta": (0.2, 0.9),
        "bend": (0.0, 0.4),
    }
    for _ in range(cases):
        fixed = {name: rng.uniform(*ends) for name, ends in ranges.items()}
        a, b, none = fixed["a"], fixed["b"], dict.fromkeys(ranges, 0.0)
        fold = -a * a / (4 * b)
        truth = {
            "fold": (fold, none | {"a": -a / (2 * b), "b": a * a / (4 * b * b)}),
            "neimark_sacker": (fixed["nu"], none | {"nu": 1.0}),
        }
        options = jaxnh.Branches(max_period=1, sensitivities=True, transient=64)
        try:
            groups = session.groups({"branches": options}, mu=np.linspace(1.3 * fold, 0.5, 8), **fixed)
        except jaxnh.AccuracyError:
            rows["refused"].append((0.0, np.nan))
            continue
        of_bifurcations(groups["bifurcations"], "mu", truth, rows)
    return rows


def loops(rng: np.random.Generator, cases: int, target: float) -> Rows:
    """Points of curves of homoclinic orbits; the bar of p, and of q by the curve's slope."""
    rows = Rows(list)
    box = {"x": (0.3, 1.0), "y": (-0.3, 0.5)}
    for _ in range(cases):
        c1, c2, bend = rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(-0.4, 0.4)
        session = jaxnh.Session(
            loop, {"x": 0.6, "y": 0.1}, target=target, parameters={"c1": c1, "c2": c2, "bend": bend}
        )
        options = jaxnh.Homoclinic(box=box, n_starts=8, n_values=1, cycles=1, ds_max=0.05)
        p, q = 0.3 * c1 - 0.09 * c2, np.array([-0.3, -0.25, -0.2])
        section = session.on("x", 0.66, "up", longest_return=60)
        data = section.groups({"homoclinic": options}, p=np.linspace(p - 0.01, p + 0.05, 4), q=q)["homoclinic"]
        p, q, p_error, q_error = (data[name].to_numpy().ravel() for name in ("p", "q", "p_error", "q_error"))
        miss, bar = np.abs(p + c1 * q + c2 * q * q), p_error + np.abs(c1 + 2 * c2 * q) * q_error
        rows["homoclinic, points"] += zip(miss[np.isfinite(p)], bar[np.isfinite(p)], strict=True)
    return rows


def shares(rng: np.random.Generator, cases: int, target: float) -> Rows:
    """Shares of basins, their intervals by the middle and half of the width."""
    rows, session = Rows(list), jaxnh.Session(bistable, start={"x": 0.1})
    for seed in range(cases):
        c = rng.uniform(-0.7, 0.7)
        options = jaxnh.Basins(n_starts=200, seed=seed, box={"x": (-1.0, 1.0)})
        data = session.groups({"basins": options}, c=c)["attractors"]
        for low, high, x in zip(
            *(data[name].to_numpy() for name in ("fraction_low", "fraction_high", "x")), strict=True
        ):
            share = 0.5 * (1.0 - c) if x > c else 0.5 * (1.0 + c)
            rows["share of a basin"].append((abs(share - 0.5 * (low + high)), 0.5 * (high - low)))
    return rows


STUDIES: dict[str, Callable[[np.random.Generator, int, float], Rows]] = {
    "maps": maps,
    "flows": flows,
    "loops": loops,
    "shares": shares,
}


def main() -> None:
    """Print of each kind of number how many of its bars cover, the median bar and the largest miss in bars."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    _ = parser.add_argument("studies", nargs="*", metavar="STUDY", help=", ".join(STUDIES))
    _ = parser.add_argument("--cases", type=int, default=20)
    _ = parser.add_argument("--seed", type=int, default=0)
    _ = parser.add_argument("--target", type=float, default=1e-6)
    asked = parser.parse_args()
    for study in asked.studies or STUDIES:
        for name, pairs in STUDIES[study](np.random.default_rng(asked.seed), asked.cases, asked.target).items():
            miss, bar = np.array(pairs).T
            if np.isnan(bar).all():
                print(f"{study}: {name}: {len(bar)}")
                continue
            with np.errstate(invalid="ignore", divide="ignore"):
                most = np.nanmax(np.where(miss > 0.0, miss / bar, 0.0))
            covered = int(np.sum(miss <= bar))
            print(f"{study}: {name}: {covered} of {len(bar)}, median bar {np.median(bar):.1e}, most {most:.2g} bars")


if __name__ == "__main__":
    main()
