"""`levels` with `refine: boundary` on a chart that is there in full: lanes computed, pixels that differ.

    python -m sweeps.timing.adaptive_charts results/chart_b_d.h5 [--levels 2 3 4 5]

A lane has the same bits at whatever level it is computed, so that the full chart says all; nothing is computed anew.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxnh
from jaxnh.analyses.registry import ANALYSES
from jaxnh.engine.levels.levels import lanes_near_changes


class RefinementShares(NamedTuple):
    """Shares of the places of a chart: computed, and of another kind than in full, of all analyses and of each."""

    computed: float
    differ: float
    by_analysis: tuple[float, ...]


def kinds_of(path: Path) -> dict[str, np.ndarray]:
    """Kinds of motion (n, m, k) of the analyses of a result that tell some apart, by analysis."""
    tree = jaxnh.open_result(path)
    found = {}
    for name, node in tree.children.items():
        classes = ANALYSES[name].classes if name in ANALYSES else None
        if classes is not None:
            kind = classes(node.to_dataset())
            found[name] = kind.reshape(*kind.shape[:2], -1)
    return found


def refined(kinds: Sequence[np.ndarray], levels: int) -> RefinementShares:
    """The chart by so many levels."""
    known = np.zeros(0)
    seen: list[np.ndarray] = []
    for step in (2**k for k in range(levels - 1, -1, -1)):
        truth = [kind[::step, ::step] for kind in kinds]
        n, m = truth[0].shape[:2]
        if not seen:
            seen, known = [kind.copy() for kind in truth], np.ones((n, m), bool)
            continue
        before, lower = known, np.ix_(np.arange(n) // 2, np.arange(m) // 2)
        known = lanes_near_changes(seen, (n, m))
        known[::2, ::2] |= before
        seen = [np.where(known[..., None], kind, old[lower]) for kind, old in zip(truth, seen, strict=True)]
    other = [np.any(kind != one, axis=-1) for kind, one in zip(kinds, seen, strict=True)]
    differ = float(np.mean(np.any(other, axis=0)))
    return RefinementShares(float(known.mean()), differ, tuple(float(np.mean(one)) for one in other))


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m sweeps.timing.adaptive_charts", description="A full chart by levels."
    )
    parser.add_argument("result", type=Path)
    parser.add_argument("--levels", type=int, nargs="+", default=[2, 3, 4, 5])
    args = parser.parse_args()
    kinds = kinds_of(args.result)
    print(f"| levels | lanes computed | pixels that differ | {' | '.join(kinds)} |")
    print("|---|---|---|" + "---|" * len(kinds))
    for levels in args.levels:
        found = refined(list(kinds.values()), levels)
        shares = (found.computed, found.differ, *found.by_analysis)
        print(f"| {levels} | " + " | ".join(f"{100 * share:.2f} %" for share in shares) + " |")


if __name__ == "__main__":
    main()
