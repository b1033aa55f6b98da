"""Convex pieces of a simple polygon."""

from omniman_ros.core.arrays import Array

Ring = list[int]  #: Numbers of the corners of a piece, counter-clockwise


def convex_pieces(corners: Array) -> list[Array]:
    """Return convex polygons (k, 2) whose union is a simple one (K, 2), all counter-clockwise [m].

    Ears are cut off until triangles are left (Meisters, Polygons have ears, 1975); neighbours are
    joined again wherever the result is convex (Hertel and Mehlhorn, 1983).
    """
    ring = list(range(len(corners)))
    pieces = [ring] if _is_convex(corners, ring) else _joined(corners, _triangles(corners, ring))
    return [corners[piece] for piece in pieces]


def _rotated(corners: Array, a: int, b: int, c: int) -> float:
    """Return twice the area of a triangle [m^2], above zero if it is counter-clockwise."""
    (ax, ay), (bx, by), (cx, cy) = corners[[a, b, c]].tolist()
    return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


def _is_convex(corners: Array, ring: Ring) -> bool:
    return all(
        _rotated(corners, ring[k - 2], ring[k - 1], ring[k]) >= 0.0 for k in range(len(ring))
    )


def _triangles(corners: Array, ring: Ring) -> list[Ring]:
    """Return triangles whose union is the polygon."""
    found, left = [], list(ring)
    while len(left) > 3:
        k = next(k for k in range(len(left)) if _is_ear(corners, left, k))
        ear = [left[k - 2], left[k - 1], left[k]]
        if _rotated(corners, *ear) > 0.0:
            found.append(ear)
        del left[k - 1]
    return [*found, left]


def _is_ear(corners: Array, ring: Ring, k: int) -> bool:
    """Return whether the corner before number k can be cut off."""
    a, b, c = ring[k - 2], ring[k - 1], ring[k]
    turn = _rotated(corners, a, b, c)
    if turn <= 0.0:
        return turn == 0.0
    return not any(
        min(_rotated(corners, a, b, p), _rotated(corners, b, c, p), _rotated(corners, c, a, p))
        >= 0.0
        for p in ring
        if p not in (a, b, c)
    )


def _joined(corners: Array, pieces: list[Ring]) -> list[Ring]:
    for i, first in enumerate(pieces):
        for j in range(i):
            ring = _join(first, pieces[j])
            if ring is not None and _is_convex(corners, ring):
                rest = [piece for k, piece in enumerate(pieces) if k not in (i, j)]
                return _joined(corners, [*rest, ring])
    return pieces


def _join(first: Ring, second: Ring) -> Ring | None:
    """Return the ring around two pieces that share a side, or None."""
    for k, end in enumerate(first):
        begin = first[k - 1]
        if begin in second and second[second.index(begin) - 1] == end:
            m = second.index(begin)
            return [*first[k:], *first[:k], *(second[m + 1 :] + second[:m])[:-1]]
    return None
