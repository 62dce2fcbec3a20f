"""Charts of a result beside those that its groups are: tongues of a rotation number, and shares of basins. No JAX."""

from __future__ import annotations

from collections.abc import Mapping

import xarray as xr

_MOST = 8  # attractors whose shares are charts


def with_charts(groups: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Return the groups with charts that are made of them: `tongues`, and `share_1`, `share_2`, ... of attractors."""
    charts = dict(groups)
    if "rotation" in groups and "denominator" in groups["rotation"]:
        about = {"panel": "integers", "panel_variables": "denominator", "panel_label": "tongues: denominator"}
        charts["tongues"] = groups["rotation"].assign_attrs(about)
    shares = groups.get("attractors")
    if shares is not None and "fraction" in shares and shares["fraction"].ndim > 2:
        for k in range(min(_MOST, shares.sizes["attractor"])):
            words = f"share of the basin of attractor {k + 1}"
            about = {"panel": "curves", "panel_variables": "fraction", "panel_label": words, "panel_levels": "0 1"}
            charts[f"share_{k + 1}"] = shares[["fraction"]].isel(attractor=k, drop=True).assign_attrs(about)
    return charts
