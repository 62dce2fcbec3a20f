"""Smooth averages over a run of a lane."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np


def window_weights(at: Any) -> Any:
    """Return the weight exp(−1/(x(1−x))) of a smooth average, x in (0, 1) (Das et al., Nonlinearity 30 (2017) 4111).

    On periodic and quasiperiodic motion such an average converges faster than any power of its length, where a plain
    one does so like its inverse: rotating tangents (complex multipliers) do no harm.
    """
    xp = np if isinstance(at, np.ndarray) else jnp
    return xp.exp(-1.0 / (at * (1.0 - at)))


def half_window_weights(at: Any) -> tuple[Any, Any]:
    """Return the weights of two smooth averages at x in (0, 1): of the whole, and of the half that x lies in."""
    return window_weights(at), window_weights((2.0 * at) % 1.0)
