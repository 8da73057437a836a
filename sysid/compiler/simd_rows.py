"""Rows of SIMD slots: load, combine and store whole vectors.

A loop over a few numbers is unrolled before LLVM could vectorise it; the numbers are then stored
one by one, and the wide load that follows waits for all of them. That cost more than the equations.
Every operation takes pairs of (array, place of the row's first number).
"""

# Why: docs/decisions/kernels.md#d56

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

SLOTS = 8
"""Numbers in a row: one vector of AVX-512, two of AVX2. Four would leave half of AVX-512 idle."""
_ROW = ir.VectorType(ir.DoubleType(), SLOTS)
_PREFETCH_NAME = "llvm.prefetch.p0"
_ARRAY = types.Array(types.float64, 1, "C")


class _Rows:
    """Builds LLVM instructions on rows of arrays."""

    def __init__(self, context: Any, builder: ir.IRBuilder, signature: Any) -> None:
        self.context, self.builder, self.types = context, builder, signature.args

    def _place(self, args: Any, i: int) -> ir.Instruction:
        array = self.context.make_array(self.types[i])(self.context, self.builder, args[i])
        first = self.builder.gep(array.data, [args[i + 1]])
        return self.builder.bitcast(first, _ROW.as_pointer())

    def load(self, args: Any, i: int) -> ir.Instruction:
        """The row of array `args[i]` that begins at number `args[i + 1]`."""
        return self.builder.load(self._place(args, i), align=8)

    def store(self, row: ir.Instruction, args: Any, i: int) -> None:
        """Write a row there."""
        self.builder.store(row, self._place(args, i), align=8)

    def broadcast(self, number: ir.Value) -> ir.Instruction:
        """A row of one number."""
        undefined = ir.Constant(_ROW, ir.Undefined)
        one = self.builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
        first = ir.Constant(ir.VectorType(ir.IntType(32), SLOTS), None)
        return self.builder.shuffle_vector(one, undefined, first)

    def times(self, row: ir.Instruction, scale: ir.Value) -> ir.Instruction:
        """A row times a number, or times another row."""
        other = scale if scale.type == _ROW else self.broadcast(scale)
        return self.builder.fmul(row, other, flags=("contract", "nsz"))

    def plus(self, a: ir.Instruction, b: ir.Instruction) -> ir.Instruction:
        """Sum of two rows."""
        return self.builder.fadd(a, b, flags=("contract", "nsz"))


def _row_operation(arrays: int, numbers: int, write: Callable[[_Rows, Any], None]) -> Any:
    """Signature and code of an operation on rows (array, place) followed by plain numbers."""
    arguments = (_ARRAY, types.int64) * arrays + (types.float64,) * numbers

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        write(_Rows(context, builder, signature), args)
        return context.get_dummy_value()

    return types.void(*arguments), codegen


def _copy(_typing: Any, _to: Any, _a: Any, _source: Any, _b: Any) -> Any:
    """Into the first row: `to = source`."""
    return _row_operation(2, 0, lambda rows, args: rows.store(rows.load(args, 2), args, 0))


def _mix(
    _typing: Any, _to: Any, _a: Any, _x: Any, _b: Any, _y: Any, _c: Any, _p: Any, _q: Any
) -> Any:
    """Into the first row: `to = p x + q y`."""

    def write(rows: _Rows, args: Any) -> None:
        one, other = rows.load(args, 2), rows.load(args, 4)
        mixed = rows.plus(rows.times(one, args[6]), rows.times(other, args[7]))
        rows.store(mixed, args, 0)

    return _row_operation(3, 2, write)


def _add(_typing: Any, _to: Any, _a: Any, _source: Any, _b: Any, _scale: Any) -> Any:
    """Into the first row: `to += scale source`."""

    def write(rows: _Rows, args: Any) -> None:
        rows.store(rows.plus(rows.load(args, 0), rows.times(rows.load(args, 2), args[4])), args, 0)

    return _row_operation(2, 1, write)


def _scale(_typing: Any, _to: Any, _a: Any, _source: Any, _b: Any, _scale: Any) -> Any:
    """Into the first row: `to = scale source`."""

    def write(rows: _Rows, args: Any) -> None:
        rows.store(rows.times(rows.load(args, 2), args[4]), args, 0)

    return _row_operation(2, 1, write)


def _shift(_typing: Any, _to: Any, _a: Any, _source: Any, _b: Any, _number: Any) -> Any:
    """Into the first row: `to = source + number`."""

    def write(rows: _Rows, args: Any) -> None:
        rows.store(rows.plus(rows.load(args, 2), rows.broadcast(args[4])), args, 0)

    return _row_operation(2, 1, write)


def _gather(
    _typing: Any, _to: Any, _a: Any, _x: Any, _b: Any, _y: Any, _c: Any, _scale: Any
) -> Any:
    """Into the first row: `to += scale x y`."""

    def write(rows: _Rows, args: Any) -> None:
        product = rows.times(rows.times(rows.load(args, 2), args[6]), rows.load(args, 4))
        rows.store(rows.plus(rows.load(args, 0), product), args, 0)

    return _row_operation(3, 1, write)


def _above(_typing: Any, _array: Any, _a: Any, _bound: Any) -> Any:
    """Whether all of a row lies above a number."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        rows = _Rows(context, builder, signature)
        over = builder.fcmp_ordered(">", rows.load(args, 0), rows.broadcast(args[2]))
        bits = ir.IntType(SLOTS)
        return builder.icmp_signed("==", builder.bitcast(over, bits), ir.Constant(bits, -1))

    return types.boolean(_ARRAY, types.int64, types.float64), codegen


def _prefetch(_typing: Any, _array: Any, _a: Any) -> Any:
    """Prefetch a place that is needed soon; it may lie outside the array."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: Any) -> Any:
        number, byte = ir.IntType(32), ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        function = builder.module.globals.get(_PREFETCH_NAME) or ir.Function(
            builder.module, kind, _PREFETCH_NAME
        )
        array = context.make_array(signature.args[0])(context, builder, args[0])
        place = builder.bitcast(builder.gep(array.data, [args[1]]), byte)
        # for reading, into all cache levels, data
        builder.call(function, [place, *(ir.Constant(number, n) for n in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(_ARRAY, types.int64), codegen


copy_row: Any = intrinsic(_copy)
mix_row: Any = intrinsic(_mix)
add_row: Any = intrinsic(_add)
scale_row: Any = intrinsic(_scale)
shift_row: Any = intrinsic(_shift)
gather_row: Any = intrinsic(_gather)
row_above: Any = intrinsic(_above)
prefetch: Any = intrinsic(_prefetch)
