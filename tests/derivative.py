"""Derivatives by differences, to check those of forms and laws."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def slope(f: Callable[[float], Any], step: float) -> Any:
    """f'(0) by central differences, exact for polynomials up to degree 4 but for rounding."""
    return (8.0 * (f(step) - f(-step)) - (f(2.0 * step) - f(-2.0 * step))) / (12.0 * step)
