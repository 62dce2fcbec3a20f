"""Cases of a test of which only some run in `make test`."""

from __future__ import annotations

import pytest


def some_slow(cases, *quick):
    """Parameters of a test by their ids, of which those named run in `make test` and the others in `make slow`."""
    assert set(quick) < set(cases)
    return [
        pytest.param(
            *(case if isinstance(case, tuple) else (case,)), id=name, marks=[] if name in quick else pytest.mark.slow
        )
        for name, case in cases.items()
    ]
