"""Results beside results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import xarray as xr

_OF_A_RUN = ("history", "wall_seconds", "compile_seconds", "lane_periods", "device")


def same_leaves(result: Any, expected: Any) -> None:
    """Equal leaves of two pytrees, to the bit."""
    for ours, other in zip(jax.tree.leaves(result), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(ours, other)


def same_tree(tree: xr.DataTree, expected: xr.DataTree, *, but_for: tuple[str, ...] = ()) -> None:
    """Equal groups, variables, dimensions, bits and attributes, but for what a file has besides or a run has spent.

    Args:
        tree: of a file, perhaps.
        expected: of a run in memory.
        but_for: attributes of the root that differ.
    """
    assert list(tree.children) == list(expected.children)
    for name, group in expected.children.items():
        ours, other = tree[name].to_dataset().load(), group.to_dataset()
        assert list(ours.variables) == list(other.variables), name
        assert set(ours.coords) == set(other.coords), name
        assert set(ours.attrs) | {"axes"} == set(other.attrs) | {"axes"}, name
        same_attrs(ours.attrs, {key: value for key, value in other.attrs.items() if key != "axes"})
        for key, item in other.variables.items():
            assert (ours[key].dims, ours[key].dtype) == (item.dims, item.dtype), (name, key)
            assert ours[key].values.tobytes() == item.values.tobytes(), (name, key)
            assert set(ours[key].attrs) - {"sha256"} == set(item.attrs), (name, key)
            same_attrs(ours[key].attrs, item.attrs)
    assert {*tree.attrs, *but_for, "content_sha256"} == {*expected.attrs, *but_for, "content_sha256"}
    same_attrs(tree.attrs, {key: value for key, value in expected.attrs.items() if key not in (*_OF_A_RUN, *but_for)})


def same_attrs(found: Mapping[Any, Any], expected: Mapping[Any, Any]) -> None:
    """Equal values of all attributes that are expected."""
    for key, value in expected.items():
        np.testing.assert_array_equal(found[key], value, err_msg=str(key))
