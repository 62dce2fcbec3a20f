"""Normal forms on the centre manifold of an equilibrium, to any order, and their coefficients. Host code.

With critical eigenvectors q_i of eigenvalues λ_i, the manifold is H(w) = Σ h_m w^m / m! and the motion on it
w_i' = λ_i w_i + Σ g_{i,m} w^m / m!, by F(H(w)) = H'(w) w' order by order (Kuznetsov, SIAM J. Numer. Anal. 36 (1999)
1104). Derivatives of F(H) are sums over the ways to divide the variables among multilinear forms of F.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxnh.orbits.continuation.equilibrium_curves import FieldPlane
from jaxnh.orbits.newton import solve

Order = tuple[int, ...]
"""Powers of the variables of the centre manifold."""

PAIR = ((1,), (-1,))
"""Frequencies of w, w̄ of a Hopf point, in its own."""


class LinearisedEquilibria(NamedTuple):
    """Equilibria of lanes, u (lanes, d) and values (lanes, 2), with their linearisations A (lanes, d, d)."""

    u: Float[np.ndarray, "lanes d"]
    values: Float[np.ndarray, "lanes 2"]
    matrix: Float[np.ndarray, "lanes d d"]


class CentreManifold(NamedTuple):
    """Coefficients by order: h (lanes, d) of the manifold, and g (lanes,) of the i-th variable's motion.

    Attributes:
        h: those of the manifold.
        g: those of resonant terms, by variable and order.
        left: left eigenvectors p_i with p_i · q_i = 1, (lanes, d) each, without conjugation.
    """

    h: Mapping[Order, Complex[np.ndarray, "lanes d"]]
    g: Mapping[tuple[int, Order], Complex[np.ndarray, " lanes"]]
    left: Sequence[Complex[np.ndarray, "lanes d"]]


def multilinear(
    plane: FieldPlane, at: LinearisedEquilibria, vectors: Sequence[Complex[np.ndarray, "lanes d_or_more"]]
) -> Complex[np.ndarray, "lanes d"]:
    """The form F^(k)(v_1, …, v_k) of complex vectors, which may have parts of both parameters after the coordinates."""
    lanes, d = at.u.shape
    parts = list[list[tuple[complex, np.ndarray]]]()
    for vector in vectors:
        whole = np.concatenate([vector, np.zeros((lanes, d + 2 - vector.shape[1]))], axis=1)
        both = [(1.0 + 0j, np.real(whole)), (1j, np.imag(whole))]
        parts.append([(factor, part) for factor, part in both if np.any(part)] or both[:1])
    terms = list(itertools.product(*parts))
    ways = np.stack([np.stack([part for _, part in term], axis=1) for term in terms], axis=1)  # (lanes, terms, k, d+2)
    u, values = (np.repeat(leaf, len(terms), axis=0) for leaf in (at.u, at.values))
    forms = plane.mixed(u, values, ways.reshape(-1, len(vectors), d + 2)).reshape(lanes, len(terms), d)
    factors = np.array([math.prod(factor for factor, _ in term) for term in terms])
    return np.sum(factors[:, None] * forms, axis=1)


def centre_manifold(
    plane: FieldPlane,
    at: LinearisedEquilibria,
    vectors: Sequence[Complex[np.ndarray, "lanes d"]],
    eigenvalues: Sequence[Complex[np.ndarray, " lanes"]],
    frequencies: Sequence[tuple[int, ...]],
    wanted: Sequence[Order],
) -> CentreManifold:
    """The manifold and its normal form up to the orders that are wanted.

    Args:
        plane: the field.
        at: equilibria.
        vectors, eigenvalues: q_i and λ_i.
        frequencies: of the variables in independent ones: terms of a variable's own frequency are resonant.
        wanted: orders; all that divide them are computed.
    """
    count, d = len(vectors), at.u.shape[1]
    unit = [tuple(int(i == k) for i in range(count)) for k in range(count)]
    h = dict[Order, np.ndarray](zip(unit, vectors, strict=True))
    g, left = dict[tuple[int, Order], np.ndarray](), _left_vectors(at.matrix, vectors, eigenvalues)
    ranges = [range(max(order[k] for order in wanted) + 1) for k in range(count)]
    orders = [m for m in itertools.product(*ranges) if sum(m) > 1 and any(_divides(m, order) for order in wanted)]
    for m in sorted(orders, key=sum):
        rest = np.zeros(at.u.shape, complex)
        for parts, number in _divisions(m).items():
            if len(parts) > 1:
                rest += number * multilinear(plane, at, [h[part] for part in parts])
        for (i, n), value in g.items():
            if _divides(n, m) and n != m:
                other = tuple(a - b + c for a, b, c in zip(m, n, unit[i], strict=True))
                number = math.prod(math.comb(a, b) for a, b in zip(m, n, strict=True))
                rest = rest - number * value[:, None] * h[other]
        turn = tuple(sum(k * f[j] for k, f in zip(m, frequencies, strict=True)) for j in range(len(frequencies[0])))
        resonant = [i for i in range(count) if tuple(frequencies[i]) == turn]
        growth = np.sum([k * x for k, x in zip(m, eigenvalues, strict=True)], axis=0)
        matrix = growth[:, None, None] * np.eye(d) - at.matrix
        for i in resonant:
            g[i, m] = np.sum(left[i] * rest, axis=1)
            rest = rest - g[i, m][:, None] * vectors[i]
            matrix = matrix + vectors[i][:, :, None] * left[i][:, None, :]  # regular, and p_i · h_m = 0
        h[m] = solve(matrix, rest)  # no numbers at zero–Hopf points on curves of Hopf points
    return CentreManifold(h, g, left)


def first_lyapunov(
    plane: FieldPlane,
    at: LinearisedEquilibria,
    vector: Complex[np.ndarray, "lanes d"],
    frequency: Float[np.ndarray, " lanes"],
) -> Float[np.ndarray, " lanes"]:
    """The real part of the cubic coefficient g₂₁/2 of Hopf points, in units of the coordinates; |q| = 1."""
    turns = (1j * frequency, -1j * frequency)
    manifold = centre_manifold(plane, at, (vector, np.conj(vector)), turns, PAIR, [(2, 1)])
    return np.real(manifold.g[0, (2, 1)]) / 2.0


def _left_vectors(
    matrix: np.ndarray, vectors: Sequence[np.ndarray], eigenvalues: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Left eigenvectors, by singular values, p_i · q_i = 1."""
    left = list[np.ndarray]()
    for vector, value in zip(vectors, eigenvalues, strict=True):
        p = np.conj(np.linalg.svd(matrix - value[:, None, None] * np.eye(matrix.shape[-1]))[0][..., -1])
        left.append(p / np.sum(p * vector, axis=1, keepdims=True))
    return left


def _divides(part: Order, whole: Order) -> bool:
    return all(a <= b for a, b in zip(part, whole, strict=True))


def _divisions(m: Order) -> Counter[tuple[Order, ...]]:
    """The number of ways in which the variables of an order are divided into the same parts."""
    labels = [k for k, power in enumerate(m) for _ in range(power)]
    divisions = Counter[tuple[Order, ...]]()
    for blocks in _partitions(list(range(len(labels)))):
        parts = [tuple(sum(labels[i] == k for i in block) for k in range(len(m))) for block in blocks]
        divisions[tuple(sorted(parts))] += 1
    return divisions


def _partitions(items: list[int]) -> Iterator[list[list[int]]]:
    """All partitions of a set."""
    if not items:
        yield []
        return
    first, *others = items
    for blocks in _partitions(others):
        yield [[first], *blocks]
        for k in range(len(blocks)):
            yield [*blocks[:k], [first, *blocks[k]], *blocks[k + 1 :]]
