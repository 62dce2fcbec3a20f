"""Quasi-velocities of a definition: what it says of them, and what is seen of their rates before any state is known.

A definition with `rates` has

    rates(q, u, t)        the rates of the coordinates, linear in the quasi-velocities u
    quasi_velocities      their names; T, Q and f are then functions of (q, u, t), and Q has a number for each of them
    dependent             names of those that the constraints f, linear in them, give: they are no part of the state
    norms                 coordinates, by name, the sum of whose squares stays one, for each such sum
    structure_constants   c[i][j][k], where the rates do not determine them

The equations of motion are in `kinematics`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxnh.exceptions import InputError
from jaxnh.systems.definition import Definition
from jaxnh.systems.elimination import is_positive_definite
from jaxnh.systems.jourdain import Equations, mass_matrix
from jaxnh.systems.kinematics import Kinematics, StructureConstants
from jaxnh.systems.tracing import Program, constants

KEYS = ("rates", "quasi_velocities", "dependent", "norms", "structure_constants")
"""Keys of a definition that go with quasi-velocities."""

_STATES = 24  # random ones at which brackets are computed
_CLOSE = 1e-10  # of the brackets: what is constant is so to rounding
_FULL_RANK = 1e-8  # least singular value of vector fields that are independent, in units of the largest


class QuasiVelocities(NamedTuple):
    """Quasi-velocities of a system.

    Attributes:
        everything: names of all of them.
        dependent: numbers of those that constraints give and that a state leaves out.
        norms: coordinates, by number, the sum of whose squares is one, for each such sum.
        structure: structure constants; None where brackets are no constants.
        definite: whether the mass matrix is the same at all states, and positive definite.
    """

    everything: tuple[str, ...]
    dependent: tuple[int, ...]
    norms: tuple[tuple[int, ...], ...]
    structure: StructureConstants | None
    definite: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of those that a state has."""
        return tuple(name for number, name in enumerate(self.everything) if number not in self.dependent)


def equations_of(definition: Definition, quasi: QuasiVelocities | None) -> Equations:
    """The equations of a definition."""
    T, Q, f = definition["T"], definition["Q"], definition.get("f")
    if quasi is None:
        return Equations(T, Q, f)
    return Equations(T, Q, f, Kinematics(definition["rates"], quasi.structure), quasi.definite)


def quasi_velocities_of(define: Callable[..., Definition], parameters: Mapping[str, float]) -> QuasiVelocities | None:
    """The quasi-velocities of a definition; None where its velocities are those of its coordinates.

    Raises:
        InputError: as of `structure_constants`.
    """
    return _quasi_velocities(define, tuple(parameters.items()))


@functools.lru_cache(maxsize=64)
def _quasi_velocities(
    define: Callable[..., Definition], parameters: tuple[tuple[str, float], ...]
) -> QuasiVelocities | None:
    values = dict(parameters)
    definition = define(**values)
    if "rates" not in definition:
        return None
    names, everything = tuple(definition["coordinates"]), tuple(definition["quasi_velocities"])
    norms = tuple(tuple(names.index(name) for name in group) for group in definition.get("norms", ()))
    dependent = tuple(sorted(everything.index(name) for name in definition.get("dependent", ())))
    k, n = len(names), len(everything)
    given = definition.get("structure_constants")
    given = None if given is None else tuple(tuple(map(tuple, rows)) for rows in np.asarray(given, float).tolist())
    with jax.enable_x64(True):  # whoever loads a config in a script has not started a session yet
        structure = structure_constants(define, values, (k, n), norms, given)
        equations = equations_of(definition, QuasiVelocities(everything, dependent, norms, structure, False))
        mass = constants(lambda *at: mass_matrix(equations, at, k), *(0.0,) * (k + n + 1))
    definite = all(entry is not None for row in mass for entry in row) and is_positive_definite(mass)
    return QuasiVelocities(everything, dependent, norms, structure, definite)


def structure_constants(
    define: Callable[..., Definition],
    parameters: Mapping[str, float],
    sizes: tuple[int, int],
    norms: Sequence[Sequence[int]],
    given: StructureConstants | None = None,
) -> StructureConstants | None:
    """Structure constants of a definition's rates, from brackets at random states; None where they are no constants.

    Args:
        define: parameters by name to the definition.
        parameters: values of all of them.
        sizes: numbers of coordinates and of quasi-velocities.
        norms: coordinates, by number, the sum of whose squares is one, for each such sum.
        given: structure constants that the definition says itself, which its brackets are held against.

    Raises:
        InputError: the rates are not linear in u, change a norm, do not determine what they should, or contradict
            the constants given.
    """
    k, n = sizes
    rates = Program(
        lambda q, u, t, p: tuple(jnp.asarray(rate, float) for rate in define(**p)["rates"](q, u, t)),
        (0.0,) * k, (0.0,) * n, 0.0, dict(parameters),
    )  # fmt: skip
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (_STATES, k))
    for group in norms:
        q[:, list(group)] /= np.linalg.norm(q[:, list(group)], axis=1, keepdims=True)
    columns, brackets, bent = _columns_and_brackets(rates, q, n, dict(parameters))
    size = max(np.abs(columns).max(), 1e-300)
    if bent > _CLOSE * size:
        raise InputError("rates must be linear in the quasi-velocities")
    for group in norms:
        changes = np.einsum("sna,sa->sn", columns[:, :, list(group)], q[:, list(group)])
        if np.abs(changes).max() > _CLOSE * size:
            raise InputError("the rates do not keep the sum of squares that norms says they do")
    fields = columns.transpose(0, 2, 1).reshape(-1, n)
    if given is not None:
        gap = np.einsum("ijk,ska->sija", np.array(given), columns) - brackets
        if np.abs(gap).max() > _CLOSE * size:
            raise InputError("structure_constants are not those of the rates")
        return given
    singular = np.linalg.svd(fields, compute_uv=False)
    if len(singular) < n or singular[-1] < _FULL_RANK * singular[0]:
        raise InputError(
            "a combination of the quasi-velocities moves no coordinate: add the coordinates that it moves, or give "
            "structure_constants, c[i][j][k] with [X_i, X_j] = sum over k of c[i][j][k] X_k"
        )
    targets = brackets.transpose(0, 3, 1, 2).reshape(-1, n * n)
    constants = np.linalg.lstsq(fields, targets, rcond=None)[0]
    alike = np.abs(fields @ constants - targets).max() < _CLOSE * size
    if alike and not _depends_on_time_or_parameters(rates, k, n):
        whole = np.round(constants)
        constants = np.where(np.abs(constants - whole) < _CLOSE, whole, constants) + 0.0
        return tuple(tuple(map(tuple, rows)) for rows in constants.T.reshape(n, n, n).tolist())
    least = np.linalg.svd(columns, compute_uv=False)[:, -1].min() if n <= k else 0.0
    if least < _FULL_RANK * size:
        raise InputError("the rates do not determine the quasi-velocities, and their brackets are no constants")
    return None


def _depends_on_time_or_parameters(rates: Program, k: int, n: int) -> bool:
    return rates.output_depends([0] * (k + n) + [1] * (len(rates.inputs) - k - n))


def _columns_and_brackets(
    rates: Program, states: np.ndarray, n: int, parameters: dict[str, float]
) -> tuple[np.ndarray, np.ndarray, float]:
    """X_j (states, j, k), [X_i, X_j] (states, i, j, k), and the largest second derivative of the rates by u."""

    def field(q: Any, u: Any) -> Any:
        return jnp.stack(rates(tuple(q), tuple(u), jnp.float64(0.3), parameters))

    def by_u(q: Any, u: Any) -> Any:
        return jax.jacfwd(field, 1)(q, u).T

    def at(q: Any) -> Any:
        u = jnp.linspace(0.3, 0.9, n)
        columns, slopes = by_u(q, u), jax.jacfwd(by_u)(q, u)
        moved = jnp.einsum("jab,ib->ija", slopes, columns)
        return columns, moved - moved.transpose(1, 0, 2), jnp.abs(jax.jacfwd(by_u, 1)(q, u)).max()

    columns, brackets, bent = map(np.asarray, jax.jit(jax.vmap(at))(states))
    return columns, brackets, float(bent.max())
