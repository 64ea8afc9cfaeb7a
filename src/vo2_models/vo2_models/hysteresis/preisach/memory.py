"""The memory of a Preisach operator as a value: turning points that are not wiped out yet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["PreisachState"]

Floats = NDArray[np.float64]


class PreisachState:
    """The memory curve of one device, or of several.

    `PreisachOperator.update` and `run` change it in place; `copy` keeps one. It is as large as the number of
    turning points needs and says nothing about the density: operators on the same range can share it only
    through `PreisachOperator.memory(state.history())`.

    Attributes
    ----------
    array : (size,) or (devices, size) float64, laid out as `preisach.kernels` says. The only content:
        `PreisachState(numpy.load(...))` restores what `numpy.save(..., state.array)` wrote.

    Examples
    --------
    >>> from vo2_models.hysteresis.preisach import PreisachOperator
    >>> operator = PreisachOperator([0.0, 1.0, 2.0], [1.0, 2.0, 1.0])
    >>> state = operator.memory([2.0, 0.5, 1.5])
    >>> state.history().tolist()
    [0.0, 2.0, 0.5, 1.5]
    >>> restored = PreisachState(state.array.copy())
    >>> restored == state, operator.update(0.2, restored) == operator.update(0.2, state.copy())
    (True, True)
    """

    __slots__ = ("array",)

    def __init__(self, array: Floats) -> None:
        checked = np.ascontiguousarray(array, dtype=np.float64)
        if checked.ndim not in (1, 2) or checked.shape[-1] < 5:
            raise ValueError(
                f"array: found shape {checked.shape}, need (size,) or (devices, size) with size >= 5"
            )
        self.array = checked

    def copy(self) -> PreisachState:
        """Return an independent copy."""
        return PreisachState(self.array.copy())

    def __eq__(self, other: object) -> bool:
        """Two states are equal if the same outputs will follow from them."""
        if not isinstance(other, PreisachState) or self.array.shape[:-1] != other.array.shape[:-1]:
            return NotImplemented if not isinstance(other, PreisachState) else False
        mine, theirs = np.atleast_2d(self.array), np.atleast_2d(other.array)
        return all(
            a[0] == b[0] and np.array_equal(a[: 3 + 2 * int(a[0])], b[: 3 + 2 * int(b[0])])
            for a, b in zip(mine, theirs, strict=True)
        )

    __hash__ = None  # type: ignore[assignment]

    def history(self, device: int | None = None) -> Floats:
        """Return the turning points and the present input: a history that leads from negative saturation here."""
        row = self.array if device is None else self.array[device]
        if row.ndim != 1:
            raise ValueError("device: found None, need an index, as the state holds several devices")
        count = int(row[0])
        return np.append(row[3 : 3 + 2 * count : 2], row[1])

    def enlarge(self) -> None:
        """Make room for twice as many turning points."""
        shape = (*self.array.shape[:-1], self.array.shape[-1])
        self.array = np.ascontiguousarray(np.concatenate([self.array, np.zeros(shape)], axis=-1))
