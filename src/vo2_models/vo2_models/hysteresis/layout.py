"""Numbers that name the parts of a packed model; the layout itself is described in `kernels`."""

from typing import Any

Numbers = Any
"""A field of a frozen model that takes any array_like and, once checked, is a float64 array."""

HEADER = 6

LINEAR, TANH, TABLE = 0, 1, 2
"""Envelope kinds."""

POLYNOMIAL, SINE, SATURATION = 0, 1, 2
"""Kinds of memoryless terms."""
