"""Words and numbers of the analysis `basins` on attractors: kinds, changes, and whether two labellings agree."""

from __future__ import annotations

import numpy as np

from jaxnh.analyses.basins.continuation import CHANGES
from jaxnh.analyses.verdict import KINDS


def kinds(attractors):
    """Kinds of the attractors that are there, in words."""
    return [KINDS[kind] for kind in attractors["kind"].values if kind >= 0]


def same_partition(ours, theirs):
    """Return whether two labels of the same starts say the same, whatever the labels are."""
    pairs = set(zip(ours, theirs, strict=True))
    return len(pairs) == len(set(ours)) == len(set(theirs))


def grid(tree, *names):
    """Starts of all lanes, (names, lanes)."""
    return np.stack(
        [a.ravel() for a in np.meshgrid(*(tree["basins"][f"start_{n}"].values for n in names), indexing="ij")]
    )


def changes(attractors, name):
    """(kind, number, value, error) of each change along an axis."""
    kind, number = (attractors[f"change_{k}"].values.tolist() for k in ("kind", "attractor"))
    value, error = (attractors[f"change_{name}{k}"].values.tolist() for k in ("", "_error"))
    return sorted(zip([CHANGES[k] for k in kind], number, value, error, strict=True))
