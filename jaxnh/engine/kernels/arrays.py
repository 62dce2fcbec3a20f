"""Operations on the places of arrays: shapes, slices, concatenation, entries at traced places, products."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxnh.engine.kernels.emitter import Emitter, Rule, filled, place_at, result_kind
from jaxnh.engine.kernels.values import (
    Memory,
    Scalars,
    UnsupportedError,
    Value,
    constant,
    in_registers,
    is_known,
    size_of,
    text_of,
)

Rearrangement = Callable[..., np.ndarray]


def rearranged(emitter: Emitter, rearrange: Rearrangement, values: Sequence[Value]) -> Value:
    """Return what a function of NumPy arrays makes of values whose elements it moves, repeats or leaves out."""
    places, first = [], 0
    for value in values:
        places.append(np.arange(first, first + size_of(value.shape)).reshape(value.shape))
        first += size_of(value.shape)
    moved, kind = rearrange(*places), values[0].kind
    if all(isinstance(value, Scalars) for value in values) and in_registers(moved.shape):
        flat = [element for value in values for element in value.flat]  # pyright: ignore[reportAttributeAccessIssue]
        return filled(moved.shape, kind, [flat[k] for k in moved.ravel()])
    if len(values) == 1:
        return _take(emitter, emitter.stored(values[0]), moved.ravel(), moved.shape)
    memory, first = emitter.memory(moved.shape, kind), 0
    for value in values:
        count = size_of(value.shape)
        source = emitter.stored(value) if count > 1 else value
        targets = np.flatnonzero((moved.ravel() >= first) & (moved.ravel() < first + count))
        origins = moved.ravel()[targets] - first
        if len(targets):
            with emitter.each(len(targets)) as i:
                target, origin = (place_at(emitter, numbers, i) for numbers in (targets, origins))
                text = f"{source.name}[{origin}]" if isinstance(source, Memory) else text_of(source.flat[0], kind)
                emitter.line(f"{memory.name}[{target}] = {text};")
        first += count
    return memory


def _take(emitter: Emitter, source: Memory, places: np.ndarray, shape: tuple[int, ...]) -> Value:
    """Return elements of an array in memory at known places."""
    if in_registers(shape):
        return filled(shape, source.kind, [emitter.let(source.kind, f"{source.name}[{k}]") for k in places])
    if (np.diff(places) == 1).all():
        emitter.viewed.add(source.name)
        return Memory(f"({source.name} + {places[0]})" if places[0] else source.name, shape, source.kind)
    memory = emitter.memory(shape, source.kind)
    with emitter.each(len(places)) as i:
        emitter.line(f"{memory.name}[{i}] = {source.name}[{place_at(emitter, places, i)}];")
    return memory


def _rearrangement(equation: Any) -> Rearrangement:
    name, p = equation.primitive.name, equation.params
    if name == "broadcast_in_dim":

        def broadcast(x: np.ndarray) -> np.ndarray:
            shape = [1] * len(p["shape"])
            for axis, target in enumerate(p["broadcast_dimensions"]):
                shape[target] = x.shape[axis]
            return np.broadcast_to(x.reshape(shape), p["shape"])

        return broadcast
    if name == "slice":
        strides = p["strides"] or (1,) * len(p["start_indices"])
        cuts = tuple(map(slice, p["start_indices"], p["limit_indices"], strides))
        return lambda x: x[cuts]
    shape = tuple(equation.outvars[0].aval.shape)
    return {
        "reshape": lambda x: x.reshape(shape),
        "squeeze": lambda x: x.reshape(shape),
        "expand_dims": lambda x: x.reshape(shape),
        "transpose": lambda x: x.transpose(p["permutation"]),
        "rev": lambda x: np.flip(x, p["dimensions"]),
        "tile": lambda x: np.tile(x, p["reps"]),
        "concatenate": lambda *x: np.concatenate(x, axis=p["dimension"]),
        "stack": lambda *x: np.stack(x, axis=p["axis"]),
    }[name]


def split(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write an array's parts along an axis."""
    axis, ends = equation.params["axis"], np.cumsum(equation.params["sizes"])
    starts = [0, *ends[:-1]]

    def part(x: np.ndarray, start: int, end: int) -> np.ndarray:
        return np.take(x, range(start, end), axis)

    cuts = zip(starts, ends, strict=True)
    return [rearranged(emitter, functools.partial(part, start=a, end=b), inputs) for a, b in cuts]


def unstack(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write an array's entries along an axis."""
    axis = equation.params["axis"]
    return [
        rearranged(emitter, functools.partial(np.take, indices=k, axis=axis), inputs)
        for k in range(inputs[0].shape[axis])
    ]


def pad(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write an array with a number around it, and between its entries."""
    widths = equation.params["padding_config"]

    def padded(x: np.ndarray, fill: np.ndarray) -> np.ndarray:
        for axis, (low, high, inner) in enumerate(widths):
            count = x.shape[axis]
            shape = [*x.shape]
            shape[axis] = max(0, low + high + count + inner * max(0, count - 1))
            wide, moved = np.full(shape, fill), np.moveaxis
            for k in range(count):
                if 0 <= low + k * (inner + 1) < shape[axis]:
                    moved(wide, axis, 0)[low + k * (inner + 1)] = moved(x, axis, 0)[k]
            x = wide
        return x

    return [rearranged(emitter, padded, inputs)]


def iota(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Return counters along an axis."""
    aval = equation.outvars[0].aval
    shape = [1] * len(aval.shape)
    shape[equation.params["dimension"]] = -1
    numbers = np.arange(aval.shape[equation.params["dimension"]]).astype(aval.dtype).reshape(shape)
    value = constant(np.broadcast_to(numbers, aval.shape))
    return [value if in_registers(aval.shape) else emitter.stored(value)]


def _corner(emitter: Emitter, starts: Sequence[Value], shape: Sequence[int], sizes: Sequence[int]) -> list[Any]:
    """Return the clamped places where a block of such sizes begins in an array of a shape."""
    corner = []
    for start, length, size in zip(starts, shape, sizes, strict=True):
        (place,), most = emitter.scalars(start).flat, length - size
        if is_known(place):
            corner.append(min(max(int(place), 0), most))
        else:
            corner.append(0 if most == 0 else emitter.let("int", f"within({place}, {most})"))
    return corner


def _offsets(shape: Sequence[int], sizes: Sequence[int]) -> np.ndarray:
    """Return places in an array, row by row, of the elements of a block at its begin."""
    return np.arange(size_of(tuple(shape))).reshape(shape)[tuple(slice(size) for size in sizes)].ravel()


def _base(emitter: Emitter, corner: Sequence[Any], shape: Sequence[int]) -> Any:
    strides = [size_of(tuple(shape[k + 1 :])) for k in range(len(shape))]
    if all(map(is_known, corner)):
        return sum(c * s for c, s in zip(corner, strides, strict=True))
    return emitter.let("int", " + ".join(f"{c} * {s}" for c, s in zip(corner, strides, strict=True)))


def dynamic_slice(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write a block of an array at a place that is known when the lane is."""
    value, *starts = inputs
    sizes = tuple(equation.params["slice_sizes"])
    corner = _corner(emitter, starts, value.shape, sizes)
    if all(map(is_known, corner)):
        cuts = tuple(slice(c, c + size) for c, size in zip(corner, sizes, strict=True))
        return [rearranged(emitter, lambda x: x[cuts], [value])]
    source, base = emitter.stored(value), _base(emitter, corner, value.shape)
    offsets = _offsets(value.shape, sizes)
    if in_registers(sizes):
        elements = [emitter.let(value.kind, f"{source.name}[{base} + {k}]") for k in offsets]
        return [filled(sizes, value.kind, elements)]
    if (np.diff(offsets) == 1).all():  # as one of several tables
        emitter.viewed.add(source.name)
        return [Memory(f"({source.name} + {base})", sizes, value.kind)]
    memory = emitter.memory(sizes, value.kind)
    with emitter.each(len(offsets)) as i:
        emitter.line(f"{memory.name}[{i}] = {source.name}[{base} + {place_at(emitter, offsets, i)}];")
    return [memory]


def dynamic_update_slice(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write an array with a block replaced, in place where nothing else sees it."""
    value, update, *starts = inputs
    corner, offsets = _corner(emitter, starts, value.shape, update.shape), _offsets(value.shape, update.shape)
    base = _base(emitter, corner, value.shape)
    if isinstance(value, Scalars):
        return [_with_elements(emitter, value, base, offsets, emitter.scalars(update))]
    memory = _own_memory(emitter, value)
    if isinstance(update, Scalars):
        for offset, element in zip(offsets, update.flat, strict=True):
            emitter.line(f"{memory.name}[{base} + {offset}] = {text_of(element, value.kind)};")
    else:
        with emitter.each(len(offsets)) as i:
            emitter.line(f"{memory.name}[{base} + {place_at(emitter, offsets, i)}] = {update.name}[{i}];")
    return [memory]


def _own_memory(emitter: Emitter, value: Memory) -> Memory:
    """Return an array that may be changed: itself, where nothing else sees it, or a copy."""
    if value.free and value.name not in emitter.viewed:
        return value
    memory = emitter.memory(value.shape, value.kind)
    emitter.copied(value, memory)
    return memory


def _with_elements(emitter: Emitter, value: Scalars, base: Any, offsets: np.ndarray, update: Scalars) -> Scalars:
    """Return variables of which some are replaced, at a place that may be known only when the lane is."""
    elements = value.flat
    for offset, new in zip(offsets, update.flat, strict=True):
        if is_known(base):
            elements[base + offset] = new
            continue
        for k, old in enumerate(elements):
            element = f"{base} + {offset} == {k} ? {text_of(new, value.kind)} : {text_of(old, value.kind)}"
            elements[k] = emitter.let(value.kind, element)
    return filled(value.shape, value.kind, elements)


def _window_places(
    dimensions: Sequence[int], batch: Sequence[int], shape: Sequence[int]
) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Return (place among indices, place in the window) of every element of gathered or scattered updates."""
    return [(tuple(place[k] for k in batch), tuple(place[k] for k in dimensions)) for place in np.ndindex(*shape)]


def gather(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write entries of an array at places; places outside are clamped to it, or give NaN or zero."""
    value, indices = inputs
    p, shape = equation.params, tuple(equation.outvars[0].aval.shape)
    numbers = p["dimension_numbers"]
    if numbers.operand_batching_dims or not in_registers(shape):
        raise UnsupportedError("a gather of many entries")
    batch = [k for k in range(len(shape)) if k not in numbers.offset_dims]
    kept = [k for k in range(len(value.shape)) if k not in numbers.collapsed_slice_dims]
    places, elements = emitter.scalars(indices).elements, []
    drop = "FILL" in str(p["mode"])
    for where, window in _window_places(numbers.offset_dims, batch, shape):
        starts: list[Any] = [0] * len(value.shape)
        for axis, place in zip(numbers.start_index_map, places[where], strict=True):
            starts[axis] = place
        sizes = [*p["slice_sizes"]]
        inside = _bounds_test(starts, value.shape, sizes) if drop else "true"
        given = [constant(np.asarray(s)) if is_known(s) else Scalars(np.array(s, object), "int") for s in starts]
        corner = _corner(emitter, given, value.shape, sizes)
        offset = [0] * len(value.shape)
        for axis, step in zip(kept, window, strict=True):
            offset[axis] = step
        element = _entry(emitter, value, corner, offset)
        fill = "NOT_A_NUMBER" if value.kind in ("double", "float") else "0"
        elements.append(element if inside == "true" else emitter.let(value.kind, f"({inside}) ? {element} : {fill}"))
    return [filled(shape, value.kind, elements)]


def _bounds_test(starts: Sequence[Any], shape: Sequence[int], sizes: Sequence[int]) -> str:
    tests = []
    for start, length, size in zip(starts, shape, sizes, strict=True):
        if is_known(start):
            if not 0 <= start <= length - size:
                return "false"
        else:
            tests.append(f"{start} >= 0 && {start} <= {length - size}")
    return " && ".join(tests) or "true"


def _entry(emitter: Emitter, value: Value, corner: Sequence[Any], offset: Sequence[int]) -> Any:
    strides = [size_of(value.shape[k + 1 :]) for k in range(len(value.shape))]
    shift = sum(o * s for o, s in zip(offset, strides, strict=True))
    base = _base(emitter, corner, value.shape)
    if is_known(base) and isinstance(value, Scalars):
        return value.flat[base + shift]
    return emitter.let(value.kind, f"{emitter.stored(value).name}[{base} + {shift}]")


def scatter(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write an array with entries set or added to at places; those outside are left out."""
    value, indices, updates = inputs
    p = equation.params
    numbers = p["dimension_numbers"]
    if numbers.operand_batching_dims or not in_registers(updates.shape):
        raise UnsupportedError("a scatter of many entries")
    batch = [k for k in range(len(updates.shape)) if k not in numbers.update_window_dims]
    kept = [k for k in range(len(value.shape)) if k not in numbers.inserted_window_dims]
    places, elements = emitter.scalars(indices).elements, value.flat if isinstance(value, Scalars) else []
    strides = [size_of(value.shape[k + 1 :]) for k in range(len(value.shape))]
    memory = _own_memory(emitter, value) if isinstance(value, Memory) else None
    adds, new = equation.primitive.name == "scatter-add", emitter.scalars(updates)
    for (where, window), update in zip(
        _window_places(numbers.update_window_dims, batch, updates.shape), new.flat, strict=True
    ):
        starts: list[Any] = [0] * len(value.shape)
        for axis, place in zip(numbers.scatter_dims_to_operand_dims, places[where], strict=True):
            starts[axis] = place
        for axis, step in zip(kept, window, strict=True):
            starts[axis] = starts[axis] + step if is_known(starts[axis]) else f"({starts[axis]} + {step})"
        inside = _bounds_test(starts, value.shape, [1] * len(value.shape))
        flat = " + ".join(f"{text_of(s, 'int')} * {stride}" for s, stride in zip(starts, strides, strict=True)) or "0"
        place = emitter.let("int", f"({inside}) ? {flat} : -1")
        if memory:
            emitter.line(
                f"if ({place} >= 0) {memory.name}[{place}] {'+' if adds else ''}= {text_of(update, value.kind)};"
            )
        for k, old in enumerate(elements):
            before, put = text_of(old, value.kind), text_of(update, value.kind)
            changed = f"{before} + {put}" if adds else put
            elements[k] = emitter.let(value.kind, f"{place} == {k} ? {changed} : {before}")
    return [memory or filled(value.shape, value.kind, elements)]


def dot_general(emitter: Emitter, equation: Any, inputs: Sequence[Value]) -> list[Value]:
    """Write a product of arrays, summed over the contracted axes."""
    contracted, batch = equation.params["dimension_numbers"]
    shape, kind = tuple(equation.outvars[0].aval.shape), result_kind(equation)
    left, right = (_rows(value.shape, axes, kept) for value, axes, kept in zip(inputs, contracted, batch, strict=True))
    pairs = [(left[b, i], right[b, j]) for b, i, j in np.ndindex(left.shape[0], left.shape[1], right.shape[1])]
    if all(in_registers(value.shape) for value in inputs) and in_registers(shape):
        x, y = (emitter.scalars(value).flat for value in inputs)
        products = [
            [f"{text_of(x[i], inputs[0].kind)} * {text_of(y[j], inputs[1].kind)}" for i, j in zip(*pair, strict=True)]
            for pair in pairs
        ]
        return [filled(shape, kind, [emitter.let(kind, " + ".join(terms) or "0") for terms in products])]
    sources = [emitter.stored(value) for value in inputs]
    firsts = [np.array([pair[k][0] for pair in pairs]) for k in (0, 1)]
    offsets = [pairs[0][k] - pairs[0][k][0] for k in (0, 1)]

    def product_at(first: Sequence[Any]) -> str:
        total = emitter.variable(kind, "0")
        with emitter.each(len(offsets[0])) as i:
            factors = [
                f"{source.name}[{begin} + {place_at(emitter, steps, i)}]"
                for source, begin, steps in zip(sources, first, offsets, strict=True)
            ]
            emitter.line(f"{total} += {' * '.join(factors)};")
        return total

    if in_registers(shape):
        return [filled(shape, kind, [product_at(first) for first in zip(*firsts, strict=True)])]
    memory = emitter.memory(shape, kind)
    with emitter.each(len(pairs)) as i:
        first = [emitter.let("int", place_at(emitter, numbers, i)) for numbers in firsts]
        emitter.line(f"{memory.name}[{i}] = {product_at(first)};")
    return [memory]


def _rows(shape: tuple[int, ...], axes: Sequence[int], batch: Sequence[int]) -> np.ndarray:
    """Return places of an array's elements as (batch, rest, contracted)."""
    rest = [k for k in range(len(shape)) if k not in axes and k not in batch]
    moved = np.arange(size_of(shape)).reshape(shape).transpose([*batch, *rest, *axes])
    return moved.reshape([size_of(tuple(shape[k] for k in some)) for some in (batch, rest, axes)])


def rules() -> dict[str, Rule]:
    """The rules of operations on arrays, by the name of the primitive."""
    moved = (
        "broadcast_in_dim",
        "slice",
        "reshape",
        "squeeze",
        "expand_dims",
        "transpose",
        "rev",
        "concatenate",
        "stack",
        "tile",
    )
    table: dict[str, Rule] = dict.fromkeys(
        moved, lambda emitter, equation, inputs: [rearranged(emitter, _rearrangement(equation), inputs)]
    )
    table |= {
        "split": split,
        "unstack": unstack,
        "pad": pad,
        "iota": iota,
        "gather": gather,
        "dot_general": dot_general,
    }
    table |= {"dynamic_slice": dynamic_slice, "dynamic_update_slice": dynamic_update_slice}
    return table | dict.fromkeys(("scatter", "scatter-add"), scatter)
