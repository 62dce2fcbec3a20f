"""Branches of tori by a session: their numbers and curves in one dataset, and one of them without what is filled up."""

from __future__ import annotations

import numpy as np

import jaxnh

STEPS = {"transient": 256, "periods": 256}


def follow(session, max_period=1, **axes):
    """Numbers and curves of all branches."""
    groups = session.groups({"torus_branches": STEPS | {"max_period": max_period}}, **axes)
    return groups["torus_branches"].merge(groups["torus_curves"], combine_attrs="override")


def branch(data, number=0):
    """Variables of a branch by name, without what is beyond its end."""
    one = data.isel(torus_branch=number)
    known = np.isfinite(one[str(data.attrs["along"])].to_numpy())
    return one.isel(torus_point=known)


def ends(data):
    return [jaxnh.labels(data[name]).to_numpy().tolist() for name in ("begins", "ends")]
