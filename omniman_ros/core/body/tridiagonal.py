"""Block-tridiagonal systems by cyclic reduction: few and large operations on arrays."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def solved(middle: Array, beside: Array, right: Array) -> Array:
    """Solution (n, m) of a symmetric, positive definite block-tridiagonal system.

    Every second unknown is eliminated, then of the rest every second one, and so on.

    Args:
        middle: Blocks (n, m, m) on the diagonal.
        beside: Blocks (n - 1, m, m) to the right of those; to the left are their transposes.
        right: Right side (n, m).
    """
    if len(middle) == 1:
        only: Array = np.asarray(np.linalg.solve(middle, right[:, :, None])[:, :, 0], dtype=float)
        return only
    # Unknown 2 j + 1 is eliminated; it has a neighbour after it but perhaps for the last.
    odd, count = middle[1::2], (len(middle) - 1) // 2
    before, after = beside[0::2], beside[1::2]  # 2 j to 2 j + 1, and 2 j + 1 to 2 j + 2
    packed = np.zeros((len(odd), middle.shape[1], 2 * middle.shape[1] + 1))
    size = middle.shape[1]
    packed[:, :, :size] = np.swapaxes(before, 1, 2)
    packed[:count, :, size : 2 * size] = after
    packed[:, :, -1] = right[1::2]
    share = np.linalg.solve(odd, packed)
    to_before, to_after, own = share[:, :, :size], share[:, :, size : 2 * size], share[:, :, -1]
    inner, side = middle[0::2].copy(), right[0::2].copy()
    inner[: len(odd)] -= before @ to_before
    side[: len(odd)] -= (before @ own[:, :, None])[:, :, 0]
    back = np.swapaxes(after, 1, 2)
    inner[1 : count + 1] -= back @ to_after[:count]
    side[1 : count + 1] -= (back @ own[:count, :, None])[:, :, 0]
    even = solved(inner, -(before[:count] @ to_after[:count]), side)
    result = np.empty_like(right)
    result[0::2] = even
    result[1::2] = own - (to_before @ even[: len(odd), :, None])[:, :, 0]
    result[1 : 2 * count : 2] -= (to_after[:count] @ even[1 : count + 1, :, None])[:, :, 0]
    return result
