"""The innermost sum of the scan, in vectors: what a compiler makes of the plain loop takes a third longer."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

GROUP = 16  # responses of at most 7 that a signed byte can sum
LANES = 128  # positions at once: two to eight registers, whatever the processor has

WORD = ir.IntType(64)
BYTES = ir.VectorType(ir.IntType(8), LANES)
WORDS = ir.VectorType(ir.IntType(16), LANES)


@intrinsic  # type: ignore[untyped-decorator]  # numba ships no types
def add_vectors(
    _context: Any, maps: Any, offsets: Any, p: Any, n: Any, position: Any, words: Any, at: Any
) -> Any:
    """words[at + l] += sum of maps[offsets[p, n + k] + position + l] over k < GROUP, for each l < LANES.

    maps (M,) int8, offsets (P, N) int64 and words (B,) int16 are contiguous; nothing is checked. With
    n = 0 the words begin anew.
    """
    signature = types.void(maps, offsets, p, n, position, words, at)
    return signature, _generate


def _generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    maps, offsets, words = (
        context.make_array(signature.args[i])(context, builder, arguments[i]) for i in (0, 1, 5)
    )
    _, _, p, n, position, _, at = arguments
    count = cgutils.unpack_tuple(builder, offsets.shape)[1]
    first = builder.add(builder.mul(p, count), n)
    start = builder.gep(maps.data, [position])
    sums = []
    for k in range(GROUP):
        offset = builder.load(builder.gep(offsets.data, [builder.add(first, WORD(k))]))
        place = builder.bitcast(builder.gep(start, [offset]), BYTES.as_pointer())
        sums.append(builder.load(place, align=1))
    while len(sums) > 1:
        sums = [builder.add(one, other) for one, other in zip(sums[::2], sums[1::2], strict=True)]
    target = builder.bitcast(builder.gep(words.data, [at]), WORDS.as_pointer())
    fresh = builder.icmp_signed("==", n, WORD(0))
    before = builder.select(fresh, WORDS(None), builder.load(target, align=2))
    builder.store(builder.add(builder.sext(sums[0], WORDS), before), target, align=2)
    return context.get_dummy_value()
