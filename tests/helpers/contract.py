"""Rules that every group of a result keeps to, whatever the analysis, the flow and the number of axes."""

from __future__ import annotations

import re

import numpy as np

_SYMBOLS = {"s", "min", "h", "m", "mm", "km", "kg", "g", "rad", "degree", "N", "Hz", "V", "A", "ohm", "K", "%"}
_FACTOR = re.compile(r"([A-Za-z%]+)(?:\^?(-?\d+))?")
_OF_TIME = {
    "exponents",
    "exponent",
    "repeller_exponents",
    "exponent_sum",
    "transverse",
    "sum_rule_residual",
    "volume_residual",
    "t",
    "time",
    "diffusion",
    "drift",
    "energy_lost",
    "cycle_escape_rate",
    "cycle_exponent",
    "cycle_return_time",
    "motion_exponent",
    "motion_return_time",
    "eigenvalues",
    "saddle_quantity",
}
_ATTRIBUTES = {
    "along",
    "along_flow",
    "angles",
    "axes",
    "complete_to",
    "confirmation_factor",
    "max_denominator",
    "max_harmonics",
    "max_period",
    "method",
    "orbit_reversal",
    "orthonormalisations_per_period",
    "over",
    "refinement_for_tangents",
    "reversal",
    "rotating_angle",
    "rows",
    "search",
    "section",
    "section_coordinate",
    "start_states",
    "strobe_phase",
    "strobes",
    "transient",
    "warnings",
    "within",
}
"""Names of attributes of groups, whatever the analysis: no variable has one of these names."""
_OF_PARAMETER = {"first", "last", "begin", "birth", "end", "limit", "crisis", "doubling", "spacing", "tangency"}
WITHOUT_LANES = (
    "doubling",
    "windows",
    "branches",
    "bifurcations",
    "curves",
    "codimension_two",
    "attractors",
    "homoclinic",
    "connecting_orbits",
    "atlas",
    "curve_orbits",
    "torus_branches",
    "torus_curves",
)


def is_unit(text):
    """Return whether UDUNITS reads it: 1, or known symbols with whole exponents, with blanks, dots or slashes between."""
    factors = [factor.strip("() ") for factor in re.split(r"[ ./]", text) if factor.strip("() ")]
    return bool(factors) and all(
        factor == "1" or ((found := _FACTOR.fullmatch(factor)) and found.group(1) in _SYMBOLS) for factor in factors
    )


def check(name, data, unsaid=()):
    """A group as it is written.

    Args:
        name: of the group.
        data: its dataset.
        unsaid: coordinates, parameters and "t" whose units the system does not say.
    """
    attributes, variables = {str(key) for key in data.attrs}, {str(key) for key in data.variables}
    assert not attributes & variables, "a number is an attribute or a variable"
    assert attributes <= _ATTRIBUTES, f"not among the attributes of groups: {sorted(attributes - _ATTRIBUTES)}"
    others = variables & _ATTRIBUTES - set(unsaid)
    assert not others, f"attributes of other groups are variables here: {sorted(others)}"
    for key, variable in data.variables.items():
        _check_words(str(key), variable, unsaid)
        _check_flags(str(key), variable)
        error = str(key).removesuffix("_error")
        assert error in data.variables, f"{key} is the error of no variable"
    if name not in WITHOUT_LANES:
        status = data["status"]
        assert status.dtype == np.int8
        assert status.attrs["flag_meanings"].split()[0] == "ok"
        assert len(status.attrs["flag_values"]) == len(status.attrs["flag_meanings"].split())
        assert not {"failed", "failure"} & set(data.variables)


def _check_words(key, variable, unsaid):
    assert variable.attrs["long_name"], key
    if "units" in variable.attrs:
        assert is_unit(variable.attrs["units"]), f"{key}: {variable.attrs['units']} is no unit"
        return
    if key.removesuffix("_error").endswith("_sensitivity") and unsaid:
        return  # over a parameter whose unit is not said
    base = key.removesuffix("_error").removeprefix("start_").removeprefix("change_").removeprefix("codimension_two_")
    base = re.sub(
        r"_(points|response|orbit|departure|arrival|crossings|edge|shock|direction|attractor|max|min|mean|std|low|drift)$",
        "",
        base,
    )
    assert base in unsaid or (base in _OF_TIME | _OF_PARAMETER and unsaid), f"{key} has no units"


def _check_flags(key, variable):
    values, attrs = np.asarray(variable.values), variable.attrs
    assert ("flag_values" in attrs) == ("flag_meanings" in attrs), key
    if "flag_values" in attrs:
        flags = np.asarray(attrs["flag_values"])
        assert flags.dtype == values.dtype, f"{key}: flags are of another type"
        assert len(flags) == len(attrs["flag_meanings"].split()), key
        first = attrs.get("valid_min", np.inf)
        assert np.all(np.isin(values, flags) | (values >= first)), f"{key} has a number without a word"
    elif "counted_in" in attrs and values.dtype.kind == "i":
        assert np.all(values > 0), f"{key} has a special number without a flag"
