"""Labels of variables in figures: words, symbols and units, from their names and attributes."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
import xarray as xr

_SYMBOLS = {"exponents": "λ"}  # of names that are not written as they are
_LOWER = "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi"
_UPPER = "Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega"
_GREEK = frozenset([*_LOWER.split(), "omega", *_UPPER.split()])
_INDEXED = re.compile(r"([A-Za-z]+?)_?(\d+)")


def coordinate_of(axis: str) -> str:
    """The coordinate whose start values an axis has: "x1" of "start_x1"; of a parameter its name."""
    return axis.removeprefix("start_")


def is_angle(variable: xr.DataArray) -> bool:
    """Return whether values of a variable are angles from -pi to pi."""
    return str(variable.attrs.get("long_name", "")).startswith("angle ")


def symbol_of(name: str, index: int | str = "") -> str:
    """A name as mathematics, with a dot for a rate and with an index: "x1", "theta_dot", "drive", "start_x1"."""
    if (coordinate := coordinate_of(name)) != name:
        return f"{symbol_of(coordinate)[:-1]}(0)$"
    base = name.removesuffix("_dot")
    letters, subscript = _letters(base) or (rf"\mathrm{{{base}}}".replace("_", r"\_"), "")
    subscript = ",".join(part for part in (subscript, str(index)) if part)
    whole = f"{letters}_{{{subscript}}}" if len(subscript) > 1 else f"{letters}_{subscript}" if subscript else letters
    return rf"$\dot{{{whole}}}$" if base != name else f"${whole}$"


def axis_label(variable: xr.DataArray, words: str = "", symbol: str = "") -> str:
    """Label of a variable: its words, its symbol where it has one, and its units.

    Args:
        words: in place of the variable's own, and of the symbol that its name makes.
        symbol: in place of that symbol; left out where the words have one, between dollars.
    """
    name = str(variable.name)
    own, named = _words(variable)
    if not words and not symbol and (named or is_symbol(name)):
        symbol = symbol_of(name)
    parts = (words or own, "" if "$" in words else symbol)
    return with_units(" ".join(filter(None, parts)), variable)


def is_symbol(name: str) -> bool:
    """Return whether a name is a symbol and no word: "x1" and "theta_dot" are, "period" is not."""
    return _letters(name.removesuffix("_dot")) is not None


def with_units(label: str, variable: xr.DataArray) -> str:
    """A label with the units of a variable, or what it counts, where these are known."""
    units = str(variable.attrs.get("counted_in") or variable.attrs.get("units", ""))
    said = {"": "", "1": "" if variable.dtype.kind in "iu" else " (dimensionless)"}
    return label + said.get(units, f" ({units})")


def title_of(data: xr.Dataset, axes: Iterable[str]) -> str:
    """Title of a drawing: the values of some axes that a dataset is at, and the section that it is on."""
    parts = [f"{symbol_of(name)} = {float(np.asarray(data[name]).item()):.10g}" for name in axes]
    if "section" in data.attrs:
        parts.append(f"on {data.attrs['section']}")
    return ", ".join(parts)


def words_of(variable: xr.DataArray) -> str:
    """Words of a variable, without its name."""
    return _words(variable)[0]


def _words(variable: xr.DataArray) -> tuple[str, bool]:
    """The long name up to the equation it may end with and without the variable's own name; whether that was there."""
    words = str(variable.attrs.get("long_name", "")).split(" = ")[0]
    *before, last = words.split(" ")
    return (" ".join(before), True) if last in (coordinate_of(str(variable.name)), "") else (words, False)


def _letters(name: str) -> tuple[str, str] | None:
    """Letter and index of a name that is a symbol: one letter or the name of a Greek one, and a number perhaps."""
    if name in _SYMBOLS:
        return _SYMBOLS[name], ""
    indexed = _INDEXED.fullmatch(name)
    base, subscript = indexed.groups() if indexed else (name, "")
    if base in _GREEK:
        return f"\\{base}", subscript
    return (base, subscript) if len(base) == 1 else None
