"""Numbers that name the parts of a packed model; the layout itself is described in `kernels`."""

from typing import Any

Numbers = Any
"""A field of a frozen model that takes any array_like and, once checked, is a float64 array."""

HEADER = 5

LINEAR, TANH = 0, 1
"""Envelope kinds."""

POLYNOMIAL, SINE, SATURATION = 0, 1, 2
"""Kinds of memoryless terms."""
