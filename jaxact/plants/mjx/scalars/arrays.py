"""What operations on arrays do to their single numbers, by the names of JAX's primitives.

Each rule takes the arrays of `jaxact.plants.mjx.scalars.numbers`, the operation's parameters, and
the shapes and types of its results; it gives the results, or None where it does not apply.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial, reduce
from typing import Any

import jax
import numpy as np

from jaxact.plants.mjx.scalars.numbers import Arithmetic, Array, is_known, objects, settled

Rule = Callable[[Arithmetic, Sequence[Array], dict[str, Any], Sequence[Any]], Any]


def moved(name: str, inputs: Sequence[Array], params: dict[str, Any], out: Any) -> Any:
    """The results of an operation that only moves numbers; None of any other.

    Args:
        name: of the primitive.
        inputs: its operands; the first ones are moved.
        params: of the operation.
        out: shape and type of its first result.
    """
    rule = _MOVES.get(name)
    if rule is None:
        return None
    if not all(map(is_known, inputs)):
        inputs = [objects(each) for each in inputs]
    return rule(inputs, params, out)


def _broadcast(inputs: Sequence[Array], params: dict[str, Any], out: Any) -> list[Array]:
    shape, kept = params["shape"], params["broadcast_dimensions"]
    thin = [inputs[0].shape[kept.index(axis)] if axis in kept else 1 for axis in range(len(shape))]
    return [np.broadcast_to(inputs[0].reshape(thin), shape)]


def _sliced(inputs: Sequence[Array], params: dict[str, Any], out: Any) -> list[Array]:
    starts, stops = params["start_indices"], params["limit_indices"]
    steps = params["strides"] or (1,) * len(starts)
    return [inputs[0][tuple(map(slice, starts, stops, steps))]]


def _counted(inputs: Sequence[Array], params: dict[str, Any], out: Any) -> list[Array]:
    shape, axis = params["shape"], params["dimension"]
    row = np.arange(shape[axis], dtype=out.dtype)
    return [
        np.broadcast_to(row.reshape([-1 if d == axis else 1 for d in range(len(shape))]), shape)
    ]


def _padded(inputs: Sequence[Array], params: dict[str, Any], out: Any) -> list[Array]:
    array, value = inputs
    found = np.full(out.shape, value[()], array.dtype)
    for at in np.ndindex(array.shape):
        place = tuple(
            low + i * (1 + between)
            for i, (low, _, between) in zip(at, params["padding_config"], strict=True)
        )
        if all(0 <= i < size for i, size in zip(place, out.shape, strict=True)):
            found[place] = array[at]
    return [found]


def _split(inputs: Sequence[Array], params: dict[str, Any], out: Any) -> list[Array]:
    return np.split(inputs[0], np.cumsum(params["sizes"])[:-1], params["axis"])


def _unstacked(inputs: Sequence[Array], params: dict[str, Any], out: Any) -> list[Array]:
    rows = np.moveaxis(inputs[0], params["axis"], 0)
    return [rows[place, ...] for place in range(len(rows))]


_MOVES: dict[str, Callable[[Sequence[Array], dict[str, Any], Any], list[Array]]] = {
    "reshape": lambda x, p, out: [x[0].reshape(out.shape)],
    "squeeze": lambda x, p, out: [x[0].reshape(out.shape)],
    "expand_dims": lambda x, p, out: [x[0].reshape(out.shape)],
    "transpose": lambda x, p, out: [np.transpose(x[0], p["permutation"])],
    "rev": lambda x, p, out: [np.flip(x[0], p["dimensions"])],
    "concatenate": lambda x, p, out: [np.concatenate(x, p["dimension"])],
    "stack": lambda x, p, out: [np.stack(x, p["axis"])],
    "unstack": _unstacked,
    "tile": lambda x, p, out: [np.tile(x[0], p["reps"])],
    "empty": lambda x, p, out: [np.zeros(out.shape, out.dtype)],
    "iota": _counted,
    "broadcast_in_dim": _broadcast,
    "slice": _sliced,
    "split": _split,
    "pad": _padded,
}


def combined(
    arithmetic: Arithmetic, name: str, inputs: Sequence[Array], params: dict[str, Any], out: Any
) -> Any:
    """The results of a sum, product or look-up; None of an operation without a rule here.

    Args:
        arithmetic: computes.
        name, inputs, params, out: as for `moved`.
    """
    rule = _RULES.get(name)
    return None if rule is None else rule(arithmetic, inputs, params, out)


def _reduction(operation: str, start: Any) -> Rule:
    def reduced(arithmetic: Arithmetic, inputs: Any, params: dict[str, Any], out: Any) -> Any:
        axes = tuple(int(axis) for axis in params["axes"])
        length = math.prod(inputs[0].shape[axis] for axis in axes)
        if length == 0 and start is None:
            return None
        last = range(inputs[0].ndim - len(axes), inputs[0].ndim)
        rows = objects(np.moveaxis(inputs[0], axes, last)).reshape((*out.shape, length))
        found = np.empty(out.shape, object)
        for at in np.ndindex(out.shape):
            numbers = list(rows[at])
            found[at] = (
                reduce(partial(arithmetic.of, operation), numbers)
                if numbers
                else out.dtype.type(start)
            )
        return [settled(found, out.dtype)]

    return reduced


def _product(arithmetic: Arithmetic, inputs: Any, params: dict[str, Any], out: Any) -> Any:
    """As `jax.lax.dot_general`: batch axes, then the free ones of both."""
    (left_sum, right_sum), (left_batch, right_batch) = params["dimension_numbers"]

    def ordered(array: Array, summed: Sequence[int], batch: Sequence[int]) -> Array:
        array = arithmetic.converted(array, out.dtype)
        free = [axis for axis in range(array.ndim) if axis not in (*summed, *batch)]
        turned = np.transpose(objects(array), (*batch, *free, *summed))
        sizes = [math.prod(array.shape[axis] for axis in axes) for axes in (batch, free, summed)]
        return turned.reshape(sizes)

    left = ordered(inputs[0], left_sum, left_batch)
    right = ordered(inputs[1], right_sum, right_batch)
    found = np.empty((left.shape[0], left.shape[1], right.shape[1]), object)
    zero = out.dtype.type(0)
    for b, i, j in np.ndindex(found.shape):
        terms = (arithmetic.of("mul", x, y) for x, y in zip(left[b, i], right[b, j], strict=True))
        found[b, i, j] = reduce(partial(arithmetic.of, "add"), terms, zero)
    return [settled(found.reshape(out.shape), out.dtype)]


def _cholesky(arithmetic: Arithmetic, inputs: Any, params: dict[str, Any], out: Any) -> Any:
    """The lower factor of positive definite matrices, shape (..., n, n)."""
    size = out.shape[-1]
    found = objects(np.zeros(out.shape, out.dtype))
    matrices = objects(inputs[0])
    for batch in np.ndindex(out.shape[:-2]):
        rows, matrix = found[batch], matrices[batch]
        for i in range(size):
            for j in range(i + 1):
                rest = matrix[i, j]
                for k in range(j):
                    term = arithmetic.of("mul", rows[i, k], rows[j, k])
                    rest = arithmetic.of("sub", rest, term)
                divided = i != j
                rows[i, j] = (
                    arithmetic.of("div", rest, rows[j, j])
                    if divided
                    else arithmetic.of("sqrt", rest)
                )
    return [settled(found, out.dtype)]


def _solved(arithmetic: Arithmetic, inputs: Any, params: dict[str, Any], out: Any) -> Any:
    """As `jax.lax.linalg.triangular_solve`, of real matrices."""
    matrices, values = map(objects, inputs)
    lower, turned = params["lower"], params["transpose_a"]
    if not params["left_side"]:
        values, turned = np.swapaxes(values, -1, -2), not turned
    if turned:
        matrices, lower = np.swapaxes(matrices, -1, -2), not lower
    found = np.empty(values.shape, object)
    size = matrices.shape[-1]
    order = range(size) if lower else range(size - 1, -1, -1)
    for *batch, column in np.ndindex((*values.shape[:-2], values.shape[-1])):
        matrix, given, solution = (each[tuple(batch)] for each in (matrices, values, found))
        for place, i in enumerate(order):
            rest = given[i, column]
            for j in order[:place]:
                term = arithmetic.of("mul", matrix[i, j], solution[j, column])
                rest = arithmetic.of("sub", rest, term)
            if not params["unit_diagonal"]:
                rest = arithmetic.of("div", rest, matrix[i, i])
            solution[i, column] = rest
    found = found if params["left_side"] else np.swapaxes(found, -1, -2)
    return [settled(found, out.dtype)]


_CLIPPED = jax.lax.GatherScatterMode.CLIP
_DROPPED = jax.lax.GatherScatterMode.FILL_OR_DROP


def _places(
    shape: Sequence[int],
    starts: Array,
    window: Sequence[int],
    moving: Sequence[int],
    fixed: Sequence[int],
    indexed: Sequence[int],
    pairs: Sequence[tuple[int, int]],
    full: Sequence[int],
    mode: Any,
) -> Iterator[tuple[tuple[int, ...], tuple[int, ...] | None]]:
    """Where the numbers of a window are in a large array, by JAX's rules of gather and scatter.

    Args:
        shape: of the array of windows.
        starts: index vectors along the last axis.
        window: size of a window along each axis of the large array.
        moving: axes of the array of windows that run inside a window.
        fixed: axes of the large array along which a window has no axis of its own.
        indexed: axes of the large array that the index vectors count.
        pairs: axes of the large array that run along with an axis of `starts`.
        full: shape of the large array.
        mode: of indices out of bounds.

    Yields:
        Index into the array of windows, index into the large one (None: out of bounds).
    """
    free = [axis for axis in range(len(full)) if axis not in fixed]
    for at in np.ndindex(*shape):
        batch = tuple(i for axis, i in enumerate(at) if axis not in moving)
        start = np.zeros(len(full), int)
        start[list(indexed)] = starts[batch]
        if mode == _CLIPPED:
            start = np.clip(start, 0, np.subtract(full, window))
        inside = bool(np.all((start >= 0) & (start <= np.subtract(full, window))))
        for axis, along in pairs:
            start[axis] = batch[along]
        for axis, along in zip(free, moving, strict=True):
            start[axis] += at[along]
        yield at, tuple(map(int, start)) if inside else None


def _gathered(arithmetic: Arithmetic, inputs: Any, params: dict[str, Any], out: Any) -> Any:
    """As `jax.lax.gather`, of known indices."""
    array, starts = inputs
    if not is_known(starts):
        return None
    numbers = params["dimension_numbers"]
    along = numbers.operand_batching_dims
    places = _places(
        out.shape,
        starts,
        params["slice_sizes"],
        numbers.offset_dims,
        (*numbers.collapsed_slice_dims, *along),
        numbers.start_index_map,
        list(zip(along, numbers.start_indices_batching_dims, strict=True)),
        array.shape,
        params["mode"],
    )
    found = np.empty(out.shape, array.dtype)
    for at, place in places:
        if place is None and params["mode"] != _DROPPED:
            return None
        found[at] = _filling(params["fill_value"], out.dtype) if place is None else array[place]
    return [found if is_known(found) else settled(found, out.dtype)]


def _filling(given: Any, dtype: np.dtype) -> Any:
    """What a gather finds out of bounds."""
    if given is not None:
        return dtype.type(given)
    if dtype.kind == "f":
        return dtype.type(np.nan)
    return dtype.type(True) if dtype.kind == "b" else np.iinfo(dtype).min


def _scattered(operation: str | None) -> Rule:
    """As one of JAX's scatters, to known indices; without an operation, what was there is lost."""

    def scattered(arithmetic: Arithmetic, inputs: Any, params: dict[str, Any], out: Any) -> Any:
        array, starts, updates = inputs
        if not is_known(starts):
            return None
        numbers = params["dimension_numbers"]
        along = numbers.operand_batching_dims
        fixed = (*numbers.inserted_window_dims, *along)
        moving = numbers.update_window_dims
        sizes = iter([updates.shape[axis] for axis in moving])
        window = [1 if axis in fixed else next(sizes) for axis in range(array.ndim)]
        places = _places(
            updates.shape,
            starts,
            window,
            moving,
            fixed,
            numbers.scatter_dims_to_operand_dims,
            list(zip(along, numbers.scatter_indices_batching_dims, strict=True)),
            array.shape,
            params["mode"],
        )
        found, updates = objects(array).copy(), objects(updates)
        for at, place in places:
            if place is not None:
                new = updates[at]
                found[place] = arithmetic.of(operation, found[place], new) if operation else new
        return [settled(found, out.dtype)]

    return scattered


def _window(arithmetic: Arithmetic, inputs: Any, params: dict[str, Any], out: Any) -> Any:
    """As `jax.lax.dynamic_slice`, at a known place."""
    array, *starts = inputs
    if not all(map(is_known, starts)):
        return None
    return [array[_within(array.shape, starts, out.shape)]]


def _with_window(arithmetic: Arithmetic, inputs: Any, params: dict[str, Any], out: Any) -> Any:
    """As `jax.lax.dynamic_update_slice`, at a known place."""
    array, update, *starts = inputs
    if not all(map(is_known, starts)):
        return None
    found = objects(array).copy()
    found[_within(array.shape, starts, update.shape)] = objects(update)
    return [settled(found, out.dtype)]


def _within(full: Sequence[int], starts: Sequence[Any], sizes: Sequence[int]) -> tuple[slice, ...]:
    firsts = [
        min(max(int(start), 0), whole - size)
        for start, whole, size in zip(starts, full, sizes, strict=True)
    ]
    return tuple(slice(first, first + size) for first, size in zip(firsts, sizes, strict=True))


_RULES: dict[str, Rule] = {
    "reduce_sum": _reduction("add", 0),
    "reduce_prod": _reduction("mul", 1),
    "reduce_max": _reduction("max", None),
    "reduce_min": _reduction("min", None),
    "reduce_and": _reduction("and", True),
    "reduce_or": _reduction("or", False),
    "dot_general": _product,
    "cholesky": _cholesky,
    "triangular_solve": _solved,
    "gather": _gathered,
    "scatter": _scattered(None),
    "scatter-add": _scattered("add"),
    "scatter-mul": _scattered("mul"),
    "dynamic_slice": _window,
    "dynamic_update_slice": _with_window,
}
