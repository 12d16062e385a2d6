"""Three operations on 16 float32 at once, for the inner loops of the blending kernels.

Written as plain loops they are unrolled too early and then vectorised across the wrong loop, with gathers: three times
slower. Here the vector type is spelled out; LLVM maps it to whatever registers the machine has.
"""

from __future__ import annotations

from typing import no_type_check

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LANES = 16
_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_CONTRACT = ("contract",)


def _load(context, builder, array_type, array, at):
    """The vector at array.flat[at : at + LANES] and its address; float32 arrays, C order, no bounds check."""
    data = context.make_array(array_type)(context, builder, array).data
    address = builder.bitcast(builder.gep(data, [at]), _VECTOR.as_pointer())
    value = builder.load(address)
    value.align = 4
    return value, address


def _store(builder, value, address):
    builder.store(value, address).align = 4


def _is_float32_array(array) -> bool:
    return isinstance(array, types.Array) and array.dtype == types.float32 and array.layout == "C"


@intrinsic
@no_type_check
def add_scaled(typing_context, target, target_at, source, source_at, factor):
    """target.flat[target_at + k] += factor * source.flat[source_at + k] for k < LANES."""
    if not (_is_float32_array(target) and _is_float32_array(source)):
        return None

    def generate(context, builder, signature, arguments):
        target_type, _, source_type, _, _ = signature.args
        sums, address = _load(context, builder, target_type, arguments[0], arguments[1])
        values, _ = _load(context, builder, source_type, arguments[2], arguments[3])
        one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), arguments[4], ir.Constant(ir.IntType(32), 0))
        every = builder.shuffle_vector(
            one, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        )
        _store(builder, builder.fadd(sums, builder.fmul(values, every, _CONTRACT), _CONTRACT), address)
        return context.get_dummy_value()

    return types.void(target, types.intp, source, types.intp, types.float32), generate


@intrinsic
@no_type_check
def add_product(typing_context, target, target_at, first, first_at, second, second_at):
    """Add a product of 16 numbers each, for k < LANES.

    target.flat[target_at + k] += first.flat[first_at + k] * second.flat[second_at + k].
    """
    if not (_is_float32_array(target) and _is_float32_array(first) and _is_float32_array(second)):
        return None

    def generate(context, builder, signature, arguments):
        target_type, _, first_type, _, second_type, _ = signature.args
        sums, address = _load(context, builder, target_type, arguments[0], arguments[1])
        a, _ = _load(context, builder, first_type, arguments[2], arguments[3])
        b, _ = _load(context, builder, second_type, arguments[4], arguments[5])
        _store(builder, builder.fadd(sums, builder.fmul(a, b, _CONTRACT), _CONTRACT), address)
        return context.get_dummy_value()

    return types.void(target, types.intp, first, types.intp, second, types.intp), generate


@intrinsic
@no_type_check
def lane_sum(typing_context, source, source_at):
    """Sum of source.flat[source_at : source_at + LANES], pairwise."""
    if not _is_float32_array(source):
        return None

    def generate(context, builder, signature, arguments):
        vector, _ = _load(context, builder, signature.args[0], arguments[0], arguments[1])
        lanes = LANES
        while lanes > 1:
            lanes //= 2
            half = ir.VectorType(ir.IntType(32), lanes)
            low = builder.shuffle_vector(vector, vector, ir.Constant(half, list(range(lanes))))
            high = builder.shuffle_vector(vector, vector, ir.Constant(half, list(range(lanes, 2 * lanes))))
            vector = builder.fadd(low, high)
        return builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))

    return types.float32(source, types.intp), generate
