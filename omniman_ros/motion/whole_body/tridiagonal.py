"""Solution of block-tridiagonal systems by cyclic reduction, in few large array operations."""

import numpy as np

from omniman_ros.core.arrays import Array


def solve_block_tridiagonal(middle: Array, beside: Array, right: Array) -> Array:
    """Solve a symmetric, positive definite block-tridiagonal system.

    Every second unknown is eliminated, then every second one of the remaining ones, and so on.

    Args:
        middle: Blocks (n, m, m) on the diagonal.
        beside: Blocks (n - 1, m, m) to the right of the diagonal; those to the left are their
            transposes.
        right: Right-hand side (n, m).

    Returns:
        Solution (n, m).
    """
    if len(middle) == 1:
        single = np.linalg.solve(middle, right[:, :, None])[:, :, 0]
        return np.asarray(single, dtype=float)
    # Unknowns 2 j + 1 are eliminated; only the last of them may have no successor.
    odd, count = middle[1::2], (len(middle) - 1) // 2
    before, after = beside[0::2], beside[1::2]  # 2 j to 2 j + 1, and 2 j + 1 to 2 j + 2
    packed = np.zeros((len(odd), middle.shape[1], 2 * middle.shape[1] + 1))
    size = middle.shape[1]
    packed[:, :, :size] = np.swapaxes(before, 1, 2)
    packed[:count, :, size : 2 * size] = after
    packed[:, :, -1] = right[1::2]
    solution = np.linalg.solve(odd, packed)
    to_before, to_after, constant = (
        solution[:, :, :size],
        solution[:, :, size : 2 * size],
        solution[:, :, -1],
    )
    inner, side = middle[0::2].copy(), right[0::2].copy()
    inner[: len(odd)] -= before @ to_before
    side[: len(odd)] -= (before @ constant[:, :, None])[:, :, 0]
    after_t = np.swapaxes(after, 1, 2)
    inner[1 : count + 1] -= after_t @ to_after[:count]
    side[1 : count + 1] -= (after_t @ constant[:count, :, None])[:, :, 0]
    even = solve_block_tridiagonal(inner, -(before[:count] @ to_after[:count]), side)
    result = np.empty_like(right)
    result[0::2] = even
    result[1::2] = constant - (to_before @ even[: len(odd), :, None])[:, :, 0]
    result[1 : 2 * count : 2] -= (to_after[:count] @ even[1 : count + 1, :, None])[:, :, 0]
    return result
