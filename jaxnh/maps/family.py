"""Lanes that differ in parameters which all lanes of a program share, as d or ω: a map, a table for each value.

The arithmetic of a lane, and so its bits, are those of the map at its own values. The executor alone looks at which
values lanes have (`engine.executor`); in a lane stands the map at its values.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Int

from jaxnh.maps.protocol import ReturnMap
from jaxnh.maps.section import System

Tree = TypeVar("Tree")
Other = TypeVar("Other")
Values = tuple[float, ...]

GROUPS = 32
"""Trees of a stack, whether it needs them or not: all stacks of at most so many run through one program."""


class ParameterFamily(Generic[Tree]):
    """A pytree for every value of some parameters.

    Attributes:
        names: of the parameters, whose values lanes carry under these names.
        together: all values that lanes have, where their trees go through one program as a stack; else each value has
            calls of its own.
        prepare: makes what the trees at some values need in one go, before they are asked for one by one.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        at: Callable[[Values], Tree],
        together: tuple[Values, ...] = (),
        prepare: Callable[[Sequence[Values]], object] = lambda values: None,
    ) -> None:
        """`at` gives the tree at values of the parameters, in the order of the names; it is asked once for each."""
        self.names, self.together, self.prepare = names, together, prepare
        self._at = functools.cache(at)
        self._derived: dict[Hashable, Any] = {}

    def at(self, values: Values) -> Tree:
        """The tree at some values."""
        return self._at(values)

    def groups(self, p: Mapping[str, ArrayLike]) -> tuple[list[Values], Int[np.ndarray, " lanes"]]:
        """Values that lanes have, and for every lane the number of its own among them."""
        if len(self.names) == 1:  # a sort of numbers, many times as fast as one of columns
            values, group = np.unique(np.asarray(p[self.names[0]], float), return_inverse=True)
            return [(value,) for value in values.tolist()], group
        columns = np.stack([np.asarray(p[name], float) for name in self.names])
        values, group = np.unique(columns, axis=1, return_inverse=True)
        return [tuple(column) for column in values.T.tolist()], group.ravel()

    @functools.cached_property
    def stack(self) -> TreeStack:
        """The trees at the values of `together`, in their order."""
        self.prepare(self.together)
        return stack([self.at(values) for values in self.together])

    def derive(self, key: Hashable, make: Callable[[Tree], Other]) -> ParameterFamily[Other]:
        """A family of what is made of each tree; that of a stack is made once under each key."""
        return self._derive(ParameterFamily, key, make)

    def maps(
        self,
        system: System,
        key: Hashable,
        make: Callable[[Tree], ReturnMap],
        prepare: Callable[[Sequence[Tree]], object] = lambda trees: None,
    ) -> MapFamily:
        """Return maps made of each tree, in tables no larger than they need where they are stacked.

        Args:
            system: one of theirs.
            prepare: makes in one go what the maps of several trees need.
        """

        def before(values: Sequence[Values]) -> object:
            return prepare([self.at(value) for value in values])

        kind = functools.partial(MapFamily, system, prepare=before)
        return self._derive(kind, key, lambda tree: make(tree).compact() if self.together else make(tree))

    def _derive(self, kind: Callable[..., Any], key: Hashable, make: Callable[[Tree], Any]) -> Any:
        if not self.together:
            return kind(self.names, lambda values: make(self.at(values)))
        if key not in self._derived:
            self._derived[key] = kind(self.names, lambda values: make(self.at(values)), self.together)
        return self._derived[key]


class MapFamily(ParameterFamily[ReturnMap]):
    """A return map for every value of some parameters.

    Attributes:
        system: of one of them.
        chart: of all.
    """

    def __init__(
        self,
        system: System,
        names: tuple[str, ...],
        at: Callable[[Values], ReturnMap],
        together: tuple[Values, ...] = (),
        prepare: Callable[[Sequence[Values]], object] = lambda values: None,
    ) -> None:
        super().__init__(names, at, together, prepare)
        self.system, self.chart = system, system.chart


Maps = ReturnMap | MapFamily
"""Maps that analyses give to a lane runner: one for all lanes, or one for each value of what they share."""


def padded_like(maps: Maps, other: Maps) -> Maps:
    """Return the maps in tables as large as those of others, which have more steps: both run through one program."""
    if isinstance(maps, ReturnMap) and isinstance(other, ReturnMap):
        return maps.padded_like(other)
    assert isinstance(maps, MapFamily)
    assert isinstance(other, MapFamily)
    return MapFamily(maps.system, maps.names, lambda values: maps.at(values).padded_like(other.at(values)))


class TreeStack(eqx.Module):
    """Pytrees of one structure.

    Attributes:
        trees: their floating-point numbers stacked, (`GROUPS` or more, …); whole numbers are the same in all.
    """

    trees: Any

    def at(self, group: ArrayLike) -> Any:
        """The pytree of a group, which may be traced."""
        return jax.tree.map(
            lambda leaf: leaf[group] if jnp.issubdtype(jnp.result_type(leaf), jnp.floating) else leaf, self.trees
        )


def stack(trees: Sequence[Any]) -> TreeStack:
    """Stack pytrees of one structure, the last of them repeated up to `GROUPS` or the next power of two.

    Raises:
        ValueError: they differ in a whole number.
    """

    places = max(GROUPS, 1 << (len(trees) - 1).bit_length())

    def one(*leaves: Any) -> np.ndarray:
        arrays = [np.asarray(leaf) for leaf in leaves]
        if arrays[0].dtype.kind == "f":
            return np.stack(arrays + arrays[-1:] * (places - len(arrays)))
        if any(not np.array_equal(arrays[0], other) for other in arrays[1:]):
            raise ValueError("trees of one program differ in a whole number")
        return arrays[0]

    return TreeStack(jax.tree.map(one, *trees))
