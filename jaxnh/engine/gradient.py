"""Numbers of analyses as functions of parameters that `jax.grad` differentiates, for inverse design.

An analysis is a search on the host, which no transformation of JAX sees. Its numbers have derivatives by the implicit
function theorem (`analyses.periodic.sensitivities`), which are all that a rule for tangents needs.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxnh.analyses.options.base import Options
from jaxnh.engine.session import Session, name_of
from jaxnh.exceptions import InputError

_KEPT = 256  # results, of other values of the parameters


def gradient(
    session: Session,
    options: Options,
    numbers: str | Sequence[str],
    *,
    where: dict[str, int | float] | None = None,
    **axes: ArrayLike,
) -> Callable[..., Float[Array, ...]]:
    """Return a function of parameters, given by name, to numbers of an analysis; `jax.grad` and `jax.jvp` know it.

    Its derivative is of first order: a second one is zero. Where the analysis does not give a number, or there is no
    derivative in a parameter, it is not a number. Calls with the same values are computed once.

    Args:
        session: runs the analysis.
        options: of `doubling`, `branches`, `period`, `windows` or `basins`.
        numbers: name of a variable that has sensitivities, as `b` of doublings over b; or of several.
        where: values of the result's dimensions that choose one number of a variable, as `{"level": 1}`.
        **axes: the sweep, as of `Session.run`.

    Returns:
        A function of floats by name to a number, or to numbers (names,) where several are named.

    Raises:
        InputError: the analysis gives no derivatives; from the function itself, within `jax.jit` and `jax.vmap`, and as
            `Session.run` does.
    """
    if "sensitivities" not in type(options).model_fields:
        raise InputError(f"{type(options).__name__.removesuffix('Options')} gives no derivatives in parameters")
    asked = options.model_copy(update={"sensitivities": True})
    names = (numbers,) if isinstance(numbers, str) else tuple(numbers)

    solved = _solver(session, asked, names, where or {}, axes)

    def on_host(p: dict[str, Array]) -> tuple[Array, Array]:
        """Numbers (names,) and their derivatives (names, parameters), in the order of the sorted names."""
        keys = tuple(sorted(p))
        values = [p[key] for key in keys]
        if any(isinstance(value, Tracer) for value in values):
            raise InputError(
                "an analysis is a search on the host: differentiate it by jax.grad outside jax.jit and jax.vmap"
            )
        given, rates = solved(keys, tuple(float(value) for value in values))
        return jnp.asarray(given), jnp.asarray(rates)

    @jax.custom_jvp
    def value(p: dict[str, Array]) -> Array:
        return on_host(p)[0]

    @value.defjvp
    def _tangent(primals: tuple[dict[str, Array]], tangents: tuple[dict[str, Array]]) -> tuple[Array, Array]:
        (p,), (dp,) = primals, tangents
        given, rates = on_host(p)
        return given, rates @ jnp.stack([dp[key] for key in sorted(dp)])

    def function(**parameters: ArrayLike) -> Array:
        result = value({name: jnp.asarray(number, jnp.float64) for name, number in parameters.items()})
        return result[0] if isinstance(numbers, str) else result

    return function


def _solver(
    session: Session, options: Options, names: Sequence[str], where: dict[str, int | float], axes: dict[str, ArrayLike]
) -> Callable[[tuple[str, ...], tuple[float, ...]], tuple[np.ndarray, np.ndarray]]:
    """Return a function of names and values of parameters to numbers (names,) and derivatives (names, parameters)."""

    @functools.lru_cache(maxsize=_KEPT)
    def solved(keys: tuple[str, ...], values: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        at = {**axes, **dict(zip(keys, values, strict=True))}
        groups = session.groups({**dict.fromkeys(options.needs), name_of(options): options}, **at)
        data = _with_derivatives(groups, names, where)
        rates = [data[f"{name}_sensitivity"].reindex(parameter=list(keys)).to_numpy() for name in names]
        return np.array([float(data[name]) for name in names]), np.array(rates)

    return solved


def _with_derivatives(
    groups: Mapping[str, xr.Dataset], names: Sequence[str], where: Mapping[str, int | float]
) -> xr.Dataset:
    """Return the group that has derivatives of numbers, at one place of it; not a number where there is no such place.

    Raises:
        InputError: there is no such group, or a variable has more numbers there.
    """
    known = dict[str, tuple[str, ...]]()
    for data in groups.values():
        rates = [str(key) for key in data if f"{key}_sensitivity" in data]
        known |= {name: tuple(map(str, data[name].dims)) for name in rates}
        if all(name in rates and {*data[name].dims} == {*where} for name in names):
            labels = {dim: data[dim].to_numpy() if dim in data.coords else np.arange(data.sizes[dim]) for dim in where}
            return (
                data.assign_coords(labels)[[*names, *(f"{name}_sensitivity" for name in names)]]
                .reindex({dim: [value] for dim, value in where.items()})
                .isel(dict.fromkeys(where, 0))
            )
    words = ", ".join(f"{name} over ({', '.join(dims)})" if dims else name for name, dims in known.items())
    raise InputError(f"{', '.join(names)} at {where} is no single number with derivatives; there are {words or 'none'}")
