"""Facts of a lane, in words."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator

import numpy as np
import xarray as xr

from jaxnh.explorer.source import LaneReport
from jaxnh.plotting.basins import attractor_words
from jaxnh.plotting.meanings import meanings


def report_html(report: LaneReport) -> str:
    """A table of a report."""
    where = [(name, repr(value)) for name, value in report.where.items()]
    more = "" if report.whole else "<div class='notes'>spectrum and verdict are being computed…</div>"
    return facts_html([*where, *lines(report)]) + more


def facts_html(facts: Iterable[tuple[str, str]]) -> str:
    """A table of facts, each with its name."""
    rows = (f"<tr><td>{html.escape(words)}</td><td>{html.escape(text)}</td></tr>" for words, text in facts)
    return f"<table class='lane'>{''.join(rows)}</table>"


def lines(report: LaneReport) -> Iterator[tuple[str, str]]:
    """Known facts of a lane with their names."""
    groups = report.groups
    if any("computed" in data and not int(data["computed"]) for data in groups.values()):
        yield "from a coarser level", "this lane was not computed; it has what a neighbour of its kind has"
    if "attractors" in groups and ("basins" not in groups or groups["basins"]["attractor"].ndim):
        yield from _shares(groups["attractors"])
    if "basins" in groups:
        yield from _basin(groups["basins"], groups.get("attractors"))
    if "verdict" in groups:
        yield "verdict", _flag(groups["verdict"]["kind"])
        if int(groups["verdict"]["phase_volume"]):
            yield "phase volume", _flag(groups["verdict"]["phase_volume"])
    if "period" in groups:
        yield from _period(groups["period"])
    if "rotation" in groups:
        yield from _rotation(groups["rotation"])
    if "lyapunov" in groups:
        yield from _spectrum(groups["lyapunov"])
    if "chaos01" in groups:
        yield "0–1 test K", f"{float(groups['chaos01']['k_median']):.3f}"


def _flag(variable: xr.DataArray) -> str:
    return meanings(variable)[int(variable)][0]


def _basin(data: xr.Dataset, attractors: xr.Dataset | None) -> Iterator[tuple[str, str]]:
    number = data["attractor"]
    if number.ndim:
        return  # of random starts
    said = attractor_words(attractors) if attractors is not None and attractors["kind"].ndim == 1 else {}
    other = {value: words for value, (words, _) in meanings(number).items()}
    yield "attractor", said.get(int(number)) or other.get(int(number), f"{int(number)}")
    if int(number) > 0:
        yield "known after", f"{float(data['time']):g} {data['time'].attrs.get('counted_in', '')}"


def _shares(attractors: xr.Dataset) -> Iterator[tuple[str, str]]:
    """Shares of the basins of attractors that there are, where they have one at each point of a plane."""
    if "fraction_low" not in attractors or attractors["fraction"].ndim != 1:
        return
    for k in range(attractors.sizes["attractor"]):
        share, low, high = (float(attractors[f"fraction{end}"][k]) for end in ("", "_low", "_high"))
        if share > 0:
            words = attractor_words(attractors)[int(attractors["attractor"][k])]
            yield f"attractor {words}", f"share {share:.3g} ({low:.3g} to {high:.3g})"


def _period(data: xr.Dataset) -> Iterator[tuple[str, str]]:
    if int(data["status"]):
        yield "least period", f"failed: {_flag(data['status'])}"
        return
    n = int(data["period"])
    yield "least period", f"{n}" if n else f"none up to {data.attrs.get('max_period', '?')}"
    if n:
        yield "largest multiplier", f"{float(data['multiplier']):.6g}"


def _rotation(data: xr.Dataset) -> Iterator[tuple[str, str]]:
    fraction = f" to {int(data['numerator'])}/{int(data['denominator'])}" if int(data["denominator"]) else ""
    yield "rotation number", with_error(float(data["rotation"]), float(data["rotation_error"]))
    yield "rotation", f"{_flag(data['kind'])}{fraction}"


def _spectrum(data: xr.Dataset) -> Iterator[tuple[str, str]]:
    exponents = np.atleast_1d(data["exponents"].to_numpy())
    errors = np.atleast_1d(data["exponents_error"].to_numpy())
    for k, (value, error) in enumerate(zip(exponents, errors, strict=True), start=1):
        yield f"exponent {k} (95 %)", with_error(float(value), float(error))
    if "kaplan_yorke" in data:
        yield "Kaplan–Yorke dimension", with_error(float(data["kaplan_yorke"]), float(data["kaplan_yorke_error"]))


def with_error(value: float, error: float) -> str:
    """A number with its error, to the digits that this has: two."""
    if not np.isfinite(value) or not np.isfinite(error) or error <= 0.0:
        return f"{value:.6g}"
    digits = max(0, min(15, 1 - int(np.floor(np.log10(error)))))
    return f"{value:.{digits}f} ± {error:.{digits}f}"
