"""The type of the arrays that the cores compute with, and their declaration in data objects."""

import copy
from collections.abc import Mapping
from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.errors import OmnimanError
from omniman_ros.core.parameters import Place

#: An array of 64-bit floats; docstrings give its shape, units and frame
Array = NDArray[np.float64]
#: Size of an axis: a number, a symbol of the object such as "K" or "K - 1", or any axes
Size = int | str | EllipsisType

FLOAT: "np.dtype[Any]" = np.dtype(np.float64)  #: Type of the items of most arrays
#: Kinds of numpy's types that an array of a kind accepts
_ACCEPTED: Mapping[str, str] = {"f": "fiu", "i": "iu", "u": "iu", "b": "b"}


class Shape:
    """Declaration of an array of a data object, whose constructor checks, copies and freezes it.

    It stands in the type of the field: `poses: Annotated[Array, Shape("K", 3)]`.

    Args:
        sizes: Size of each axis; a symbol has one value in the whole object.
        unit: Unit as text.
        low: Smallest value, or None.
        high: Largest value, or None.
        finite: Whether infinity and NaN are refused.
        increasing: Whether each value of the only axis must be above the one before.
        spread: Whether a single number stands for all items; other arrays bind the sizes.
    """

    def __init__(
        self,
        *sizes: Size,
        unit: str = "",
        low: float | None = None,
        high: float | None = None,
        finite: bool = True,
        increasing: bool = False,
        spread: bool = False,
    ) -> None:
        self._sizes = tuple(map(_parsed, sizes))
        self._unit = f" {unit}" if unit else ""
        self._low, self._high, self._finite = low, high, finite
        self._increasing, self._spread = increasing, spread
        self._place, self._kind = Place("array"), FLOAT
        #: Shape if all sizes are numbers
        self._fixed: tuple[int, ...] | None = None

    def of(self, place: Place, kind: "np.dtype[Any]") -> "Shape":
        """Return the declaration of a certain field with a type of its items."""
        made = copy.copy(self)
        made._place, made._kind = place, kind
        made._finite = self._finite and kind.kind == "f"
        if all(size is not ... and not size[0] for size in self._sizes):
            made._fixed = tuple(size[1] for size in self._sizes)
        return made

    def check(self, value: Any, known: dict[str, Any]) -> Any:
        """Return the value as a read-only array that nobody else can write.

        Args:
            value: An array, or a sequence of numbers.
            known: Sizes of the object's symbols so far; those of this array are added.

        Raises:
            InputError: The value has another type or shape, is not finite, is out of range, or
                does not increase; a ParameterError in a group of parameters.
        """
        result = self._converted(value)
        if self._spread and result.ndim == 0:
            result = _frozen(np.full([known[size[0]] for size in self._sizes], result))
        if result.shape != self._fixed:
            self._check_shape(result, known)
        if self._finite:
            finite = np.isfinite(result)
            if np.count_nonzero(finite) != result.size:
                raise self._refusal_at(result, ~finite, "not a finite number")
        if self._low is not None and (below := result < self._low).any():
            raise self._refusal_at(result, below, f"below the minimum {self._low:g}{self._unit}")
        if self._high is not None and (above := result > self._high).any():
            raise self._refusal_at(result, above, f"above the maximum {self._high:g}{self._unit}")
        if self._increasing and (falls := result[1:] <= result[:-1]).any():
            reason = f"not above the one before, {result[:-1][falls][0]:g}{self._unit}"
            raise self._refusal_at(result, np.concatenate([[False], falls]), reason)
        return result

    def _converted(self, value: Any) -> Any:
        """Return the value itself if nobody can write it, else a read-only copy."""
        kind = self._kind
        if type(value) is np.ndarray and value.dtype is kind:
            # The same layout in memory: products of matrices round by it.
            return value if _is_frozen(value) else _frozen(value.copy(order="K"))
        try:
            given = np.asarray(value)
        except ValueError:  # rows of different length
            given = np.empty(1, dtype=object)
        is_empty_list = given.shape == (0,)
        if given.dtype.kind not in _ACCEPTED[kind.kind] and not is_empty_list:
            name = given.dtype.name if given is value else type(value).__name__
            raise self._place.refusal(value, f"expected an array of {kind.name}, got {name}")
        result = given.astype(kind)
        if kind.kind in "iu" and given.dtype != kind and (other := result != given).any():
            raise self._refusal_at(given, other, f"beyond {kind.name}")
        return _frozen(result)

    def _check_shape(self, value: Any, known: dict[str, Any]) -> None:
        """Compare the shape with the declaration, and bind the symbols that have no size yet."""
        shape, sizes = value.shape, self._sizes
        if ... in sizes:
            begin, more = sizes.index(...), len(shape) - len(sizes) + 1
            free = shape[begin : begin + max(more, 0)]
            if more < 0 or known.setdefault("...", free) != free:
                raise self._shape_refusal(shape, known)
            shape = shape[:begin] + shape[begin + more :]
            sizes = sizes[:begin] + sizes[begin + 1 :]
        if len(shape) != len(sizes):
            raise self._shape_refusal(value.shape, known)
        for size, declared in zip(shape, sizes, strict=True):
            symbol, more = declared
            fits = size == more
            if symbol:
                fits = known.setdefault(symbol, size - more) + more == size and size >= more
            if not fits:
                raise self._shape_refusal(value.shape, known)

    def _shape_refusal(self, shape: tuple[int, ...], known: dict[str, Any]) -> OmnimanError:
        """Return the error that names the expected shape, and the symbols' sizes so far."""
        texts: list[str] = []
        bound: dict[str, int] = {}
        for size in self._sizes:
            if size is ...:
                texts.append("...")
                continue
            symbol, more = size
            bound |= {symbol: known[symbol]} if symbol in known else {}
            texts.append(f"{symbol} {more:+d}" if symbol and more else symbol or str(more))
        expected = f"({', '.join(texts)}{',' if len(texts) == 1 else ''})"
        where = " and ".join(f"{symbol} = {size}" for symbol, size in bound.items())
        return self._place.refusal(
            shape, f"expected {expected}{f' with {where}' if where else ''}", at=".shape"
        )

    def _refusal_at(self, value: Any, wrong: Any, reason: str) -> OmnimanError:
        """Return the error that names the first wrong value."""
        index = tuple(np.argwhere(wrong)[0].tolist())
        at = f"[{', '.join(map(str, index))}]" if index else ""
        return self._place.refusal(value[index].item(), reason, at=at)


def _parsed(size: Size) -> Any:
    """Return the ellipsis, or a symbol and what is added to it; the symbol of a number is ""."""
    if isinstance(size, int):
        return "", size
    if not isinstance(size, str):
        return size
    symbol, *more = size.split(maxsplit=1)
    return symbol, int("".join(more).replace(" ", "") or 0)


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array


def _is_frozen(value: NDArray[Any]) -> bool:
    """Return whether neither an array nor the one whose memory it uses can be written."""
    if value.flags.writeable:
        return False
    owner = value.base
    return owner is None or (isinstance(owner, np.ndarray) and not owner.flags.writeable)
