"""A CasADi function with buffers of its own: compiled where a compiler is, interpreted elsewhere."""

from __future__ import annotations

import threading
from collections.abc import Callable

import casadi
import numpy as np
from numpy.typing import ArrayLike

from optsc.errors import InvalidValue
from optsc.geometry.rotation import Array
from optsc.robot.kernels.build import shared_library


class Kernel:
    """A function of arrays that runs without allocating.

    Fill `inputs`, call `run`, read `outputs`; or call the kernel itself, which copies and may be used from several
    threads at once. Buffers have CasADi's column-major layout: a matrix (r, c) is a Fortran-ordered array, a vector
    is one-dimensional.

    Attributes:
        inputs, outputs: the buffers; the arrays stay the same for the kernel's life.
        run: evaluates `outputs` from `inputs`; not for several threads at once.
        compiled: whether machine code runs, or CasADi's virtual machine.
    """

    __slots__ = ("_buffer", "_lock", "compiled", "function", "inputs", "outputs", "run")

    inputs: tuple[Array, ...]
    outputs: tuple[Array, ...]
    run: Callable[[], None]

    def __init__(self, function: casadi.Function, *, compiled: bool) -> None:
        self.function, self.compiled = function, compiled
        self.inputs = tuple(_buffer_of(function.sparsity_in(i)) for i in range(function.n_in()))
        self.outputs = tuple(_buffer_of(function.sparsity_out(i)) for i in range(function.n_out()))
        # The function works on the buffers in place and keeps their addresses, so it must not outlive them.
        self._buffer, self.run = function.buffer()
        self._lock = threading.Lock()
        for i, array in enumerate(self.inputs):
            self._buffer.set_arg(i, memoryview(array.reshape(-1, order="A")))
        for i, array in enumerate(self.outputs):
            self._buffer.set_res(i, memoryview(array.reshape(-1, order="A")))

    @property
    def n_in(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def n_out(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    def __call__(self, *arrays: ArrayLike) -> tuple[Array, ...]:
        """Return copies of the outputs for the given inputs; raise `InvalidValue` when shapes do not fit."""
        if len(arrays) != self.n_in:
            raise InvalidValue("number of inputs", len(arrays), str(self.n_in))
        values = [np.asarray(array, dtype=float) for array in arrays]
        for i, (buffer, value) in enumerate(zip(self.inputs, values, strict=True)):
            if buffer.shape != value.shape:
                raise InvalidValue(f"shape of input {self.function.name_in(i)}", value.shape, str(buffer.shape))
        with self._lock:
            for buffer, value in zip(self.inputs, values, strict=True):
                buffer[...] = value
            self.run()
            return tuple(output.copy(order="A") for output in self.outputs)


def _buffer_of(sparsity: casadi.Sparsity) -> Array:
    if not sparsity.is_dense():
        raise InvalidValue("sparsity of a kernel's input or output", str(sparsity), "dense")
    rows, columns = sparsity.shape
    return np.zeros(rows) if columns == 1 else np.zeros((rows, columns), order="F")


def build_kernel(function: casadi.Function) -> Kernel:
    """Return a kernel for a function with dense inputs and outputs, compiled if possible.

    The first build of a function takes seconds, and later ones milliseconds: libraries are kept in the per-user
    cache. Without a compiler CasADi's virtual machine evaluates the same operations; results agree to rounding.

    Raises:
        InvalidValue: an input or output is sparse.
    """
    library = shared_library(function.name(), _source(function))
    if library is None:
        return Kernel(function, compiled=False)
    return Kernel(casadi.external(function.name(), str(library)), compiled=True)


def _source(function: casadi.Function) -> str:
    generator = casadi.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    return generator.dump()
