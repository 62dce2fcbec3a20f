"""A small result of two equal groups, as storage writes it."""

from __future__ import annotations

import numpy as np
import xarray as xr

from jaxnh.storage.hdf5 import write

ATTRS = {"title": "Täst δ", "jaxnh_version": "0", "steps": 160, "error_estimate": 3.5e-11, "config": "a: 1\nb: 2\n"}


def variable(dims, data, long_name, units="1", **attrs):
    return dims, data, {"long_name": long_name, "units": units, **attrs}


def group():
    """Two dimensions, one of them without a coordinate of its own; an array large enough to be compressed."""
    b, x = np.linspace(1, 2, 7), np.random.default_rng(8).normal(size=(7, 900))
    flags = {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "periodic chaotic"}
    variables = {
        "b": variable("b", b, "coupling b"),
        "x1": variable(("b", "strobe"), x, "position x1", "length"),
        "residual": variable("b", np.array([np.nan, *b[1:]]), "residual"),
        "kind": variable("b", np.arange(7, dtype=np.int8) % 2, "kind of motion", **flags),
    }
    return xr.Dataset(variables, attrs={"levels_found": 3, "delta_limit": np.nan, "warnings": "one\ntwo"})


def write_group(path):
    """The result as a file."""
    write(path, ATTRS, {"diagram": group(), "second": group()})
