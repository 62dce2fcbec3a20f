"""What figures call variables: words, symbols and units, from the attributes that result files carry."""

from __future__ import annotations

import xarray as xr

_SYMBOLS = {"x1": "$x_1$", "x2": "$x_2$", "y1": "$y_1$", "y2": "$y_2$", "b": "$b$"}


def first_pair(data: xr.Dataset) -> tuple[str, str]:
    """Names of the first position and its velocity, which is the one that says of what it is the rate.

    The position that a section is of says nothing, as it is the same in all points.
    """
    for name, variable in data.data_vars.items():
        _, rate, position = str(variable.attrs.get("long_name", "")).partition(" = d")
        position = position.removesuffix("/dt")
        if rate and position != data.attrs.get("section_coordinate"):
            return str(data[position].name), str(name)
    raise KeyError("no position and velocity")


def symbol_of(name: str) -> str:
    """A name as it is written in a figure."""
    base = name.removesuffix("_dot")
    letters = base if len(base) == 1 else rf"\mathrm{{{base}}}".replace("_", r"\_")
    return _SYMBOLS.get(name) or (rf"$\dot{{{letters}}}$" if base != name else f"${letters}$")


def named(variable: xr.DataArray) -> tuple[str, str]:
    """What a variable is in words, and its symbol."""
    words, name = (
        str(variable.attrs.get("long_name", f"parameter {variable.name}"))
        .split(" = ")[0]
        .split(" at the ")[0]
        .rsplit(" ", 1)
    )
    return words, symbol_of(name)


def axis_label(variable: xr.DataArray) -> str:
    """What a variable is in words, its symbol and its units."""
    words, symbol = named(variable)
    units = variable.attrs["units"]
    return f"{words} {symbol} ({'dimensionless' if units == '1' else units})"


def lane_title(data: xr.Dataset, index: int) -> str:
    """What stands above a drawing of one lane: its letter, the value of what is swept, and its section."""
    letter = f"({chr(ord('a') + index)}) " if data.sizes["b"] <= 26 else ""
    section = f", on {data.attrs['section']}" if "section" in data.attrs else ""
    return f"{letter}{named(data['b'])[1]} = {float(data['b'][index]):.10g}{section}"


def same_plane(strobes: xr.Dataset, portraits: xr.Dataset) -> bool:
    """Whether strobe points are to be drawn over portraits: of the same lanes, and in the same plane."""
    return "section" not in strobes.attrs and strobes["b"].equals(portraits["b"])
