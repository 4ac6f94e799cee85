"""What colours the bodies: a field or one of its components at the nodes, its limits, its map of colours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from piezomat.forms.arrays import Array, Booleans
from piezomat.pictures.data import Bodies, prefixed
from piezomat.results.vtk import COMPONENTS, ResultsError
from piezomat.scene.errors import named, near, shown

# Both can be told apart by colour-blind readers; the first also in grey.
SEQUENTIAL, DIVERGING = "viridis", "RdBu_r"
# A field changes sign where its smaller extreme is more than this part of the larger one.
SIGNED = 0.1
UNITS = {
    "potential": "V",
    "displacement": "um",
    "von_mises": "MPa",
    "stress": "MPa",
    "strain": "",
    "electric_field": "V/um",
    "electric_displacement": "pC/um2",
}
WORDS = {"von_mises": "von Mises stress"}


class Field(NamedTuple):
    """Nodal values in the unit of the label; shown (bodies,): whether a body has the field, the others are grey."""

    values: Array
    label: str
    limits: tuple[float, float]
    extend: str
    colours: str
    shown: Booleans


def field_of(bodies: Bodies, name: str | None = None, component: str | None = None) -> Field:
    """A field at the nodes; by default the potential if there is one, else the von Mises stress.

    component: x, y, z, or xx ... xy of stress and strain; by default the magnitude of a vector, the von Mises stress,
    and the strain along the upright axis. ResultsError: there is no such field or component.
    """
    if name is None:
        name = "potential" if bodies.potential is not None else "von_mises"
    if name not in UNITS:
        raise ResultsError(f"--field: found {shown(name)}; allowed: {named(list(UNITS))}{near(name, list(UNITS))}")
    if name == "stress" and component is None:
        name = "von_mises"
    values, words = _values(bodies, name, component)
    factor, unit = prefixed(values, UNITS[name])
    values = factor * values
    unit = unit.replace("um", "µm").replace("m2", "m²")
    label = f"{words} ({unit})" if unit else words
    low, high, extend = float(values.min()), float(values.max()), "neither"
    if name == "von_mises":  # corners are singular
        low, high = 0.0, float(np.percentile(values, 99.8))
        extend = "max" if high < values.max() else "neither"
    colours = SEQUENTIAL
    if low < 0.0 < high and min(-low, high) > SIGNED * max(-low, high):
        colours, most = DIVERGING, max(-low, high)
        low, high = -most, most
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-300):
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    electric = name in ("potential", "electric_field", "electric_displacement")
    has = bodies.dielectric if electric else np.ones(bodies.count, bool)
    return Field(values, label, (low, high), extend, colours, has)


def _values(bodies: Bodies, name: str, component: str | None) -> tuple[Array, str]:
    """Nodal values of a field and the words for them."""
    words = WORDS.get(name, name.replace("_", " "))
    if name in ("potential", "von_mises"):
        if component is not None:
            raise ResultsError(f"--component: found {shown(component)}; allowed: nothing, {words} is a number")
        if name == "von_mises":
            return bodies.von_mises, words
        if bodies.potential is None:
            raise ResultsError("--field: found potential; allowed: a field of the run, which has no potential")
        return bodies.potential, words
    field = bodies.displacement if name == "displacement" else bodies.in_cells.get(name)
    if field is None:
        raise ResultsError(f"--field: found {name}, which the results do not hold; allowed: displacement, von_mises")
    if component is None and name == "strain":
        component = "yy" if bodies.flat else "zz"
    if component is None:
        values, words = np.linalg.norm(field, axis=1), f"magnitude of the {words}"
    else:
        known = COMPONENTS[name]
        if component not in known:
            raise ResultsError(f"--component: found {shown(component)}; allowed: {named(list(known))}")
        values, words = field[:, known.index(component)], f"{words} {component}"
    return (values if name == "displacement" else bodies.at_nodes(values)), words
