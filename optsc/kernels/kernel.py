"""Compiled kernels: a CasADi function with its buffers, compiled where a compiler is, interpreted elsewhere."""

from __future__ import annotations

import functools
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.kernels.build import shared_library


class Kernel:
    """A function of arrays that runs without allocating.

    Fill `inputs`, call `run`, read `outputs`; or call the kernel itself, which copies and may be used from
    several threads at once. Buffers have CasADi's column-major layout: a matrix (r, c) is a Fortran-ordered
    array, a column is one-dimensional.

    Attributes:
        function: what is evaluated.
        compiled: whether machine code runs, or CasADi's virtual machine.
        inputs, outputs: the buffers; they stay the same arrays for the kernel's life, but for `bind`, `bind_output`.
        run: evaluates `outputs` from `inputs`; not for several threads at once.
    """

    __slots__ = ("_bound", "_lock", "compiled", "function", "inputs", "outputs", "run")

    run: Callable[[], None]

    def __init__(self, function: casadi.Function, *, compiled: bool) -> None:
        self.function, self.compiled = function, compiled
        self.inputs = tuple(_allocated(function.sparsity_in(i)) for i in range(function.n_in()))
        self.outputs = tuple(_allocated(function.sparsity_out(i)) for i in range(function.n_out()))
        self._bound: Any
        self._bound, evaluate = function.buffer()
        for i, array in enumerate(self.inputs):
            self._bound.set_arg(i, array.reshape(-1, order="F").data)
        for i, array in enumerate(self.outputs):
            self._bound.set_res(i, array.reshape(-1, order="F").data)
        self.run = functools.partial(evaluate)
        self._hold()
        self._lock = threading.Lock()

    def bind(self, index: int, array: Array) -> None:
        """Read an input from ``array`` from now on: memory of the caller's, in column-major order without gaps.

        Raises `InvalidValue` for another shape or layout.
        """
        self._checked(self.inputs[index], array, f"input {self.function.name_in(index)}")
        self._bound.set_arg(index, array.reshape(-1, order="F").data)
        self.inputs = (*self.inputs[:index], array, *self.inputs[index + 1 :])
        self._hold()

    def bind_output(self, index: int, array: Array) -> None:
        """Write an output to ``array`` from now on, which no input may overlap; see `bind`."""
        self._checked(self.outputs[index], array, f"output {self.function.name_out(index)}")
        self._bound.set_res(index, array.reshape(-1, order="F").data)
        self.outputs = (*self.outputs[:index], array, *self.outputs[index + 1 :])
        self._hold()

    @staticmethod
    def _checked(buffer: Array, array: Array, name: str) -> None:
        if array.shape != buffer.shape or not array.flags.f_contiguous or array.dtype != np.float64:
            raise InvalidValue(name, (array.shape, array.dtype), f"{buffer.shape} float64, F order")

    def _hold(self) -> None:
        # The evaluator knows bare addresses, so whoever holds `run` has to hold what they belong to.
        run: Any = self.run
        run.held = (self._bound, self.inputs, self.outputs)

    def __call__(self, *arrays: ArrayLike) -> tuple[Array, ...]:
        """Return copies of the outputs for the given inputs; raise `InvalidValue` when shapes do not fit."""
        if len(arrays) != len(self.inputs):
            raise InvalidValue(f"number of inputs of {self.function.name()}", len(arrays), str(len(self.inputs)))
        values = [np.asarray(array, dtype=float) for array in arrays]
        for i, (buffer, value) in enumerate(zip(self.inputs, values, strict=True)):
            if buffer.shape != value.shape:
                raise InvalidValue(f"shape of input {self.function.name_in(i)}", value.shape, str(buffer.shape))
        with self._lock:
            for buffer, value in zip(self.inputs, values, strict=True):
                buffer[...] = value
            self.run()
            return tuple(output.copy(order="K") for output in self.outputs)


class BatchKernel:
    """A function applied to many items by one compiled loop; may be used from several threads at once.

    The number of items is free: they are taken through the loop `size` at a time, the last time with zeros in
    place of those that are missing.
    """

    def __init__(self, kernel: Kernel, size: int, shared: int) -> None:
        self._kernel, self.size = kernel, size
        self._items = [_rows(buffer, size) for buffer in kernel.inputs[: len(kernel.inputs) - shared]]
        self._shared = kernel.inputs[len(kernel.inputs) - shared :]
        self._results = [_rows(buffer, size) for buffer in kernel.outputs]
        self._stale = 0
        self._lock = threading.Lock()

    @property
    def compiled(self) -> bool:
        """Whether machine code runs, or CasADi's virtual machine."""
        return self._kernel.compiled

    def __call__(self, *items: Array, shared: Sequence[ArrayLike] = ()) -> tuple[Array, ...]:
        """Return one array (N, ...) for each output.

        Args:
            items: one array (N, r) for each input that differs from item to item. Matrices, here and in the
                results, are flattened column by column.
            shared: the inputs that all items have in common.
        """
        count = len(items[0])
        results = tuple(np.empty((count, rows.shape[1])) for rows in self._results)
        with self._lock:
            for buffer, value in zip(self._shared, shared, strict=True):
                buffer[...] = value
            for start in range(0, count, self.size):
                used = min(self.size, count - start)
                for rows, values in zip(self._items, items, strict=True):
                    rows[:used] = values[start : start + used]
                    if used < self._stale:
                        rows[used : self._stale] = 0.0
                self._stale = used
                self._kernel.run()
                for result, rows in zip(results, self._results, strict=True):
                    result[start : start + used] = rows[:used]
        return results


def _allocated(sparsity: casadi.Sparsity) -> Array:
    if not sparsity.is_dense():
        raise InvalidValue("sparsity of a kernel's input or output", str(sparsity), "dense")
    rows, columns = sparsity.shape
    return np.zeros(rows) if columns == 1 else np.zeros((rows, columns), order="F")


def _rows(buffer: Array, size: int) -> Array:
    """Return a view with one row for each item: items side by side are one after another in memory."""
    return buffer.reshape(-1, order="F").reshape(size, -1)


def build_kernel(function: casadi.Function) -> Kernel:
    """Return a kernel for a function with dense inputs and outputs, compiled if possible.

    The first build of a function takes up to a second or so, later ones milliseconds: libraries are kept in
    the per-user cache. Without a compiler CasADi's virtual machine evaluates the same operations, and results
    agree to rounding.

    Raises:
        InvalidValue: an input or output is sparse.
    """
    generator = casadi.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    library = shared_library(function.name(), generator.dump())
    if library is None:
        return Kernel(function, compiled=False)
    try:
        return Kernel(casadi.external(function.name(), str(library)), compiled=True)
    except RuntimeError as error:
        warnings.warn(f"{library} cannot be loaded, so {function.name()} runs interpreted: {error}", stacklevel=2)
        return Kernel(function, compiled=False)


def build_batch_kernel(function: casadi.Function, size: int, shared: int = 0) -> BatchKernel:
    """Return a kernel that applies ``function`` to many items, ``size`` at a time.

    The last ``shared`` inputs are the same for all items.

    Raises:
        InvalidValue: an input or output is sparse.
    """
    first_shared = function.n_in() - shared
    inputs = [
        casadi.MX.sym(function.name_in(i), *_batched(function.size_in(i), size if i < first_shared else 1))
        for i in range(function.n_in())
    ]
    mapped = function.map("mapped", "serial", size, list(range(first_shared, function.n_in())), [])
    batch = casadi.Function(f"{function.name()}_{size}", inputs, mapped.call(inputs))
    return BatchKernel(build_kernel(batch), size, shared)


def _batched(shape: tuple[int, int], times: int) -> tuple[int, int]:
    return shape[0], shape[1] * times
