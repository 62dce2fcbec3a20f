"""Origin of the numbers of a sweep, and what they have cost."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import NamedTuple

from jaxnh import __version__

_LIBRARIES = ("jax", "jaxlib", "diffrax", "equinox", "numpy", "h5py")
_version_of = functools.cache(version)  # read from files


class SecondsSpent(NamedTuple):
    """Cost of a piece: seconds, of these compiling, lane-periods, and the devices."""

    seconds: float
    compile_seconds: float
    lane_periods: float
    device: str


@dataclass(frozen=True)
class Provenance:
    """Origin of the numbers of a sweep.

    Attributes:
        config_sha256: hash of the config.
        versions: of the package and the libraries that the numbers rest on.
        machine: kind of processor and options of the compiler, which the last bits of chaotic lanes rest on.
    """

    config_sha256: str
    versions: Mapping[str, str]
    machine: Mapping[str, str]


def versions() -> dict[str, str]:
    """Versions of the package, under the name jaxnh, and of the libraries that the numbers rest on."""
    return {"jaxnh": __version__, **{name: _version_of(name) for name in _LIBRARIES}}
