"""Words and colours of flags."""

from __future__ import annotations

import numpy as np
import xarray as xr

from jaxnh.exceptions import InputError, ResultError
from jaxnh.plotting.style import BLUE, GREEN, MANY, ORANGE, PURPLE, SKY, VERMILION, YELLOW

FAILED = "#000000"
"""Colour of failed lanes."""

NONE = "#b8b8b8"
"""Colour of lanes without a value."""

HYPERCHAOTIC = "#7f2704"
"""Colour of hyperchaos: that of chaos, darker."""

_MEANINGS = {
    "periodic": BLUE,
    "quasiperiodic": ORANGE,
    "chaotic": VERMILION,
    "hyperchaotic": HYPERCHAOTIC,
    "undecided": NONE,
    "failed": FAILED,
}
_OTHER_MEANINGS = (PURPLE, GREEN, SKY, YELLOW, *MANY)


def labels(variable: xr.DataArray) -> xr.DataArray:
    """Return the words that a variable's whole numbers stand for, of its shape; "" where a number stands for none.

    Args:
        variable: of a result, with attributes `flag_values` and `flag_meanings` as the CF conventions have them.

    Raises:
        InputError: it is no such variable.
        ResultError: `flag_values` and `flag_meanings` are not equally many.
    """
    if not isinstance(variable, xr.DataArray) or "flag_meanings" not in variable.attrs:  # pyright: ignore[reportUnnecessaryIsInstance]
        name = getattr(variable, "name", None) or f"a {type(variable).__name__}"
        raise InputError(
            f"{name} has no words: labels are of a variable with flag_meanings, as tree['verdict']['kind']"
        )
    words = {value: word for value, (word, _) in meanings(variable).items()}
    text = np.vectorize(lambda value: words.get(int(value), ""), otypes=[object])(variable.to_numpy())
    return variable.copy(data=text).drop_attrs().assign_attrs(long_name=variable.attrs.get("long_name", ""))


def meanings(variable: xr.DataArray) -> dict[int, tuple[str, str]]:
    """Words and colour of every flag.

    Raises:
        ResultError: there are no `flag_meanings`, or they and `flag_values` are not equally many.
    """
    if "flag_meanings" not in variable.attrs:
        raise ResultError(
            f"{variable.name} has no flag_meanings, the words of its numbers; xarray keeps attributes where asked: "
            "xarray.set_options(keep_attrs=True)"
        )
    words = str(variable.attrs["flag_meanings"]).split()
    values = np.atleast_1d(variable.attrs.get("flag_values", np.arange(len(words))))
    if len(values) != len(words):
        raise ResultError(f"{variable.name} has {len(values)} flag_values and {len(words)} flag_meanings")
    others = iter(_OTHER_MEANINGS * len(words))
    return {
        int(value): (word.replace("_", " "), _MEANINGS.get(word) or next(others))
        for value, word in zip(values, words, strict=True)
    }
