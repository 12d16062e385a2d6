"""Sixteen float32 at once, as a number that numba kernels calculate with.

Plain loops over 16 points are unrolled too early and compiled to scalar code. A value of this type is an LLVM vector,
which LLVM maps to whatever registers the machine has: `load(points, at) * 2.0 + weight` is three vector instructions.
Operands of `+ - * /` are two of these, or one and a float32. Operations are never reordered, and fused only where
`fused` says so: a kernel that has just been compiled gives the same bits as one that numba stored.
"""

from __future__ import annotations

import operator
from typing import no_type_check

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 16
_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_OPERATIONS = {operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv"}


class FloatLanes(types.Type):
    """The numba type of sixteen float32."""

    def __init__(self) -> None:
        super().__init__(name="FloatLanes")


float_lanes = FloatLanes()


@register_model(FloatLanes)
class _FloatLanesModel(models.PrimitiveModel):
    @no_type_check
    def __init__(self, manager, numba_type) -> None:
        super().__init__(manager, numba_type, _VECTOR)


@no_type_check
def _every(builder, value):
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), mask)


@no_type_check
def _define(operation, instruction) -> None:
    """Teach numba an operator between lanes, and between lanes and a float32."""

    @infer_global(operation)
    class Typing(AbstractTemplate):
        def generic(self, args, kws):
            fits = len(args) == 2 and float_lanes in args and set(args) <= {float_lanes, types.float32}
            return signature(float_lanes, *args) if fits else None

    @no_type_check
    def lower(context, builder, signature, arguments):
        operands = [
            value if kind == float_lanes else _every(builder, value)
            for value, kind in zip(arguments, signature.args, strict=True)
        ]
        return getattr(builder, instruction)(*operands)

    for operands in ((float_lanes, float_lanes), (float_lanes, types.float32), (types.float32, float_lanes)):
        lower_builtin(operation, *operands)(lower)


for _operation, _instruction in _OPERATIONS.items():
    _define(_operation, _instruction)


@no_type_check
def _address(context, builder, array_type, array, at):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [at]), _VECTOR.as_pointer())


@no_type_check
def _is_float32_array(array) -> bool:
    return isinstance(array, types.Array) and array.dtype == types.float32 and array.layout == "C"


@intrinsic
@no_type_check
def load(typing_context, array, at):
    """array.flat[at : at + LANES]; a float32 array in C order, no bounds check."""
    if not _is_float32_array(array):
        return None

    def generate(context, builder, signature, arguments):
        value = builder.load(_address(context, builder, signature.args[0], *arguments))
        value.align = 4
        return value

    return float_lanes(array, types.intp), generate


@intrinsic
@no_type_check
def store(typing_context, array, at, value):
    """array.flat[at : at + LANES] = value; a float32 array in C order, no bounds check."""
    if not _is_float32_array(array):
        return None

    def generate(context, builder, signature, arguments):
        builder.store(arguments[2], _address(context, builder, signature.args[0], *arguments[:2])).align = 4
        return context.get_dummy_value()

    return types.void(array, types.intp, float_lanes), generate


@intrinsic
@no_type_check
def every(typing_context, value):
    """The same float32 in every lane."""
    return float_lanes(types.float32), lambda context, builder, signature, arguments: _every(builder, arguments[0])


@intrinsic
@no_type_check
def fused(typing_context, left, right, added):
    """left * right + added in each lane, rounded once; each of the three lanes or a float32."""
    kinds = left, right, added
    if not set(kinds) <= {float_lanes, types.float32}:
        return None

    def generate(context, builder, signature, arguments):
        operands = [
            value if kind == float_lanes else _every(builder, value)
            for value, kind in zip(arguments, signature.args, strict=True)
        ]
        return _call(builder, "fma", operands)

    return float_lanes(*kinds), generate


@no_type_check
def _call(builder, name, operands):
    """Call one of LLVM's functions of vectors."""
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(operands))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f32"), operands)


@intrinsic
@no_type_check
def square_root(typing_context, value):
    """Square root of each lane, correctly rounded."""

    return float_lanes(float_lanes), lambda context, builder, signature, arguments: _call(builder, "sqrt", arguments)


@intrinsic
@no_type_check
def inverse_root(typing_context, value):
    """1 over the square root of each lane, to a relative 2^-21.

    By the machine's own estimate and a step of Newton's, if it has one.
    """

    def generate(context, builder, signature, arguments):
        ones = ir.Constant(_VECTOR, [1.0] * LANES)
        return builder.fdiv(ones, _call(builder, "sqrt", arguments), flags=("arcp",))

    return float_lanes(float_lanes), generate


@intrinsic
@no_type_check
def larger(typing_context, left, right):
    """The larger of two in each lane; `right` where `left` is not a number."""

    def generate(context, builder, signature, arguments):
        return builder.select(builder.fcmp_ordered(">", *arguments), *arguments)

    return float_lanes(float_lanes, float_lanes), generate


@intrinsic
@no_type_check
def above(typing_context, value, bound):
    """1 in each lane where `value` is larger than `bound`, 0 elsewhere."""

    def generate(context, builder, signature, arguments):
        ones, zeros = (ir.Constant(_VECTOR, [number] * LANES) for number in (1.0, 0.0))
        return builder.select(builder.fcmp_ordered(">", *arguments), ones, zeros)

    return float_lanes(float_lanes, float_lanes), generate


@intrinsic
@no_type_check
def any_above(typing_context, value, bound):
    """True if `value` is larger than `bound` in any lane."""

    def generate(context, builder, signature, arguments):
        bits = builder.bitcast(builder.fcmp_ordered(">", *arguments), ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(float_lanes, float_lanes), generate
