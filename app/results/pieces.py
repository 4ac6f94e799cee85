"""Fields and contact points of all ranks as one piece, joined in memory or read from the folder of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array, Integers
from piezomat.results.vtk import ContactPoints, FieldPiece, Grid, IndexEntry, ResultsError

_FIELDS = (
    "displacement",
    "potential",
    "stress",
    "electric_field",
    "electric_displacement",
    "strain",
    "places",
    "poling",
)
_AT_POINTS = ("displacement", "potential", "places")


def joined_fields(parts: Sequence[FieldPiece]) -> FieldPiece | None:
    """The cells of all parts, each node once in each body; None without cells."""
    parts = [part for part in parts if len(part)]
    if not parts:
        return None
    starts = np.cumsum([0] + [len(part.grid.points) for part in parts[:-1]])
    cells = np.vstack([part.grid.cells + start for part, start in zip(parts, starts, strict=True)])
    points = np.vstack([part.grid.points for part in parts])
    body = np.concatenate([part.body for part in parts])
    node, cells = _merge(points, cells, body)
    values: dict[str, Array] = {}
    for name in _FIELDS:
        found = [getattr(part, name) for part in parts]
        if all(entry is not None for entry in found):
            whole = np.concatenate(found)
            values[name] = whole[node] if name in _AT_POINTS else whole
    grid = Grid(points[node], cells, parts[0].grid.cell_type)
    names = {"body_names": parts[0].body_names, "place_names": parts[0].place_names}
    return FieldPiece(grid=grid, body=body, **names, **values)


def joined_contact(parts: Sequence[ContactPoints]) -> ContactPoints | None:
    """The contact points of all parts; None without any."""
    parts = [part for part in parts if len(part)]
    if not parts:
        return None
    names = {number: name for part in parts for number, name in part.pair_names.items()}

    def all_of(name: str) -> NDArray[Any] | None:
        found = [getattr(part, name) for part in parts]
        return np.concatenate(found) if all(entry is not None for entry in found) else None

    columns = ("position", "normal", "gap", "pressure", "status", "pair", "potential_jump")
    return ContactPoints(*(all_of(name) for name in columns), dict(sorted(names.items())))


def read_fields(directory: Path, entry: IndexEntry) -> FieldPiece | None:
    """The fields of a step in the folder of a run, of all ranks. ResultsError: a file is missing or damaged."""
    return joined_fields([_field_piece(data) for data in _read(directory, entry) if data.n_cells])


def read_contact(directory: Path, entry: IndexEntry) -> ContactPoints | None:
    """The contact points of a step in the folder of a run, of all ranks. ResultsError: as `read_fields`."""
    return joined_contact([_contact_part(data) for data in _read(directory, entry) if data.n_points])


def _field_piece(data: Any) -> FieldPiece:
    nodes = data.get_cell(0).n_points
    grid = Grid(
        np.asarray(data.points, float),
        data.cells.reshape(-1, nodes + 1)[:, 1:].astype(np.int64),
        int(data.celltypes[0]),
    )
    values = {name: np.array(data[name]) for name in _FIELDS if name in data.array_names}
    names = {name: _texts(data, name) for name in ("body_names", "place_names")}
    return FieldPiece(grid=grid, body=np.array(data["body"], np.int64), **names, **values)


def _contact_part(data: Any) -> ContactPoints:
    names = _texts(data, "pair_names")
    numbers = [int(number) for number in data.field_data["pair_numbers"]] if names else []
    jump = np.array(data["potential_jump"]) if "potential_jump" in data.point_data else None
    columns = [np.array(data[name]) for name in ("normal", "gap", "pressure", "status", "pair")]
    return ContactPoints(np.asarray(data.points, float), *columns, jump, dict(zip(numbers, names, strict=True)))


def _texts(data: Any, name: str) -> tuple[str, ...]:
    array = data.GetFieldData().GetAbstractArray(name)
    return () if array is None else tuple(array.GetValue(i) for i in range(array.GetNumberOfValues()))


def _read(directory: Path, entry: IndexEntry) -> list[Any]:
    import pyvista

    for file in entry.files:
        if not (directory / file).is_file():
            raise ResultsError(f"{directory / file}, a result of step {entry.step}, is missing")
    return [pyvista.read(directory / file) for file in entry.files]


def _merge(points: Array, cells: Integers, body: Integers) -> tuple[Integers, Integers]:
    """Nodes that stand for all at the same place in the same body, and the cells in their numbers.

    Copies of a node on several ranks have the same coordinates to the last bit.
    """
    pairs, place = np.unique(body[:, None] * len(points) + cells, return_inverse=True)
    node_body, node = np.divmod(pairs, len(points))
    rows = np.column_stack([node_body, points[node]])
    _, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return node[first], which.reshape(-1)[place].reshape(cells.shape)
