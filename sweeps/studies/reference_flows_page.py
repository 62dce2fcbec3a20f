"""The page of `sweeps.studies.reference_flows`, from its dataset alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

import jaxnh
from sweeps.studies.reference_flows_table import RUNS

_PAGE = """\
# Spectra of known flows and maps

Written by `make reference` from `results/reference_flows.h5`, whose group `flows` has all digits (dimensions `flow` and
`exponent`; `xarray.open_dataset(path, group="flows")`). Flows are those without delay of the package dysts, as their
authors wrote them and at their published values; maps are those of `configs/maps`. Each is one lane at a target of
1e-8. {count}

{measured_at}

- **Exponents** are in 1/time, those of maps in 1/iterate; what stands in brackets is the error at 95 %, in units of the
  last digits: 0.9056(22) is 0.9056 ± 0.0022. An exponent without brackets is known to be zero, as that along a flow.
- **D** is the Kaplan–Yorke dimension. **Motion** is what the exponents say by the rule of `verdict`, which for its
  other criteria would need a section of each flow.
- **Sum** is how far the sum of the exponents is from the mean divergence, **met** the error of a unit of time that the
  steps had, relative to the size of the motion.
- **dysts** is what that package says of λ1 and D, in bold where it lies outside of our bar. It has no bars of its own.

{rows}

## Without an answer

{refused}

## How often error bars cover

{coverage}

{independent}
"""


def page(data: xr.Dataset) -> str:
    """Return the page in Markdown."""
    answered = data["status"].to_numpy() == 0
    rows = [_row(data.isel(flow=i)) for i in np.flatnonzero(answered)]
    heads = "name", "exponents", "D", "motion", "sum", "met", "dysts λ1", "dysts D"
    words = np.array(RUNS)[data["status"].to_numpy()]
    refused = [
        (str(data["flow"].to_numpy()[i]), str(words[i]), str(data["message"].to_numpy()[i]).replace("|", "\\|"))
        for i in np.flatnonzero(~answered)
    ]
    of = f"{int(answered.sum())} of {data.attrs['flows_and_maps']} have an answer"
    missing = int(data.attrs["flows_and_maps"]) - data.sizes["flow"]
    of += f", {missing} have not been run" if missing else ""
    return _PAGE.format(
        count=f"{of}.",
        measured_at="\n".join(dict.fromkeys(data["measured_at"].to_numpy().tolist())),
        rows=_table(heads, rows),
        refused=_table(("name", "status", "message"), refused) if refused else "None.",
        coverage=_coverage(data.isel(flow=answered)),
        independent=_independent(data.isel(flow=answered)),
    )


def with_error(value: float, error: float) -> str:
    """Return a number with its error in brackets, in units of the last of two digits that the error has."""
    if not math.isfinite(value):
        return "–"
    if not math.isfinite(error) or error == 0.0:
        return f"{value:.6g}"
    largest = _power(max(abs(value), error))
    power = largest if largest < -3 or error >= 100.0 else 0
    value, error = value / 10.0**power, error / 10.0**power
    digits = max(1 - _power(error), 0)
    bracket = round(error * 10.0**digits)
    return f"{value:.{digits}f}({bracket})" + (f"e{power}" if power else "")


def _power(value: float) -> int:
    """The power of ten of a positive number that is rounded to two digits."""
    return int(f"{value:.1e}".partition("e")[2])


def _row(flow: xr.Dataset) -> tuple[str, ...]:
    exponents, error = flow["exponents"].to_numpy(), flow["exponents_error"].to_numpy()
    own = ~np.isnan(exponents)
    dimension = float(flow["kaplan_yorke"]), float(flow["kaplan_yorke_error"])
    kind = str(jaxnh.labels(flow["motion"]).item())
    return (
        str(flow["flow"].item()),
        ", ".join(with_error(*pair) for pair in zip(exponents[own], error[own], strict=True)),
        with_error(*dimension),
        kind,
        f"{abs(float(flow['sum_rule_residual'])):.0e}",
        f"{float(flow['error_estimate']):.0e}" if np.isfinite(flow["error_estimate"]) else "–",
        _format_published(float(flow["published_largest"]), exponents[0], error[0]),
        _format_published(float(flow["published_kaplan_yorke"]), *dimension),
    )


def _format_published(published: float, value: float, error: float) -> str:
    """A published number, in bold where it lies outside of an error bar."""
    if math.isnan(published):
        return "–"
    return f"{published:.4g}" if abs(published - value) <= error else f"**{published:.4g}**"


def _coverage(data: xr.Dataset) -> str:
    value, error = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    longer, remaining = data["longer_exponents"].to_numpy(), data["longer_exponents_error"].to_numpy()
    known = np.isfinite(value) & np.isfinite(longer) & (error > 0.0)
    if not known.any():
        return "No flow has been run for longer."
    apart = np.abs(value - longer)
    within = known & (apart <= error)
    both = known & (apart <= np.hypot(error, remaining))
    names = data["flow"].to_numpy()
    missed = [f"{names[i]} λ{j + 1} ({apart[i, j] / error[i, j]:.1f} bars)" for i, j in np.argwhere(known & ~within)]
    share = within.sum() / known.sum()
    return (
        f"{known.any(axis=1).sum()} flows were run once more, ten times as long, from where the first average ends. "
        f"Of their {known.sum()} exponents that have a bar, {within.sum()} ({100 * share:.1f} %) are within it of the "
        f"longer average, and {both.sum()} within both bars together."
        + (f"\nOutside of it: {', '.join(missed)}." if missed else "")
    )


def _independent(data: xr.Dataset) -> str:
    value, error = data["exponents"].to_numpy(), data["exponents_error"].to_numpy()
    mean, bar = data["independent_exponents"].to_numpy(), data["independent_exponents_error"].to_numpy()
    known = np.isfinite(value) & np.isfinite(mean)
    if not known.any():
        return "None has an independent integration."
    apart = np.abs(value - mean)
    close = ~known | (apart <= 1.5 * (error + bar) + 1e-3 + 2e-3 * np.abs(mean))
    flows, agree = known.any(axis=1), known.any(axis=1) & close.all(axis=1)
    names = data["flow"].to_numpy()
    differ = [
        f"- {names[i]}: "
        + ", ".join(with_error(*pair) for pair in zip(value[i][known[i]], error[i][known[i]], strict=True))
        + "; there "
        + ", ".join(with_error(*pair) for pair in zip(mean[i][known[i]], bar[i][known[i]], strict=True))
        for i in np.flatnonzero(flows & ~agree)
    ]
    text = (
        f"Of {flows.sum()} flows there is an independent integration by fixed steps (`sweeps.studies.dysts_flows`); "
        f"{agree.sum()} agree with it within half as much again as both errors together, 0.001 and 0.2 %."
    )
    return text + ("\nApart from it:\n\n" + "\n".join(differ) if differ else "")


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, [":--"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
