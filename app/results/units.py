"""Units of the history's columns, found by name."""

from __future__ import annotations

import re

from piezomat.results.quantities import AXIS, GROUPS, PLACE, Quantity, unit_in


def quantity_of(column: str) -> Quantity | None:
    """The quantity of a column such as `force_z@top`; None for a name that no history has."""
    return next((quantity for pattern, quantity in _patterns() if pattern.fullmatch(column)), None)


def unit_of(column: str, dim: int) -> str:
    """The unit of a column of a history in `dim` dimensions; empty for numbers without a unit and unknown names."""
    quantity = quantity_of(column)
    return unit_in(quantity, dim) if quantity is not None else ""


def symbols(unit: str) -> str:
    """A unit as print has it: uN/um2 is µN/µm²."""
    return unit.replace("um", "µm").replace("uN", "µN").replace("m2", "m²").replace("m3", "m³")


def _patterns() -> list[tuple[re.Pattern[str], Quantity]]:
    """What the names of each quantity's columns look like; a user may have added quantities."""
    found = []
    for quantity in (quantity for group in GROUPS for quantity in group.quantities):
        pattern = re.escape(quantity.name).replace(re.escape(AXIS), "[xyz]").replace(re.escape(PLACE), ".+")
        found.append((re.compile(pattern, re.DOTALL), quantity))
    return found
