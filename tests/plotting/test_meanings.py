"""Words for the whole numbers of a result."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import jaxnh

FLAGS = {"flag_values": np.array([-1, 0, 2], np.int8), "flag_meanings": "failed periodic weakly_chaotic"}


def test_words_of_a_variable():
    """Of its shape and axes, whatever its flags are; a number that is none has none."""
    kind = xr.DataArray(
        np.array([[0, 2], [-1, 7]], np.int8), {"b": [1.0, 2.0]}, ("b", "d"), "kind", {**FLAGS, "long_name": "kind"}
    )
    words = jaxnh.labels(kind)
    assert words.dims == kind.dims
    assert words.to_numpy().tolist() == [["periodic", "weakly chaotic"], ["failed", ""]]
    assert words["b"].to_numpy().tolist() == [1.0, 2.0]
    assert words.attrs == {"long_name": "kind"}
    assert jaxnh.labels(kind[0, 0]).item() == "periodic"


@pytest.mark.parametrize("value", [None, xr.DataArray([1.0], name="exponents"), "kind"])
def test_what_has_none(value):
    with pytest.raises(jaxnh.InputError, match="labels are of a variable with flag_meanings"):
        jaxnh.labels(value)
