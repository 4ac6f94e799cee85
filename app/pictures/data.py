"""Data of a picture, read from the folder of a run: bodies, contact points, history; and units with prefixes."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezomat.contact.pairs import Pairs
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.results.files import Value, read_history
from piezomat.results.pieces import read_contact, read_fields
from piezomat.results.vtk import STATUS, IndexEntry, ResultsError, read_index, von_mises
from piezomat.scene.errors import named

# Cells of 2D meshes by VTK type: triangles between their nodes, and their edges from corner to corner.
_TRIANGLES = {
    5: [[0, 1, 2]],
    22: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    9: [[0, 1, 2], [0, 2, 3]],
    28: [[0, 4, 8], [4, 1, 8], [1, 5, 8], [5, 2, 8], [2, 6, 8], [6, 3, 8], [3, 7, 8], [7, 0, 8]],
}
_EDGES = {
    5: [[0, 1], [1, 2], [2, 0]],
    22: [[0, 3, 1], [1, 4, 2], [2, 5, 0]],
    9: [[0, 1], [1, 2], [2, 3], [3, 0]],
    28: [[0, 4, 1], [1, 5, 2], [2, 6, 3], [3, 7, 0]],
}
_PREFIXES = {-18: "a", -15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


@dataclass(frozen=True)
class Bodies:
    """The cells of all ranks at a step, each node once in each body.

    points (n, 3), cells (m, nodes) of one VTK type, displacement (n, 3), potential (n,) or None, stress (m, 6), body
    (m,), and by name what else is known in cells; places (n,), place_names: see `FieldPiece`, as for all units.
    """

    points: Array
    cells: Integers
    cell_type: int
    displacement: Array
    potential: Array | None
    stress: Array
    body: Integers
    in_cells: Mapping[str, Array] = field(default_factory=dict)
    places: Integers | None = None
    place_names: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of bodies."""
        return int(self.body.max(initial=-1)) + 1

    @cached_property
    def dielectric(self) -> Booleans:
        """Whether each body has a permittivity: charge is displaced somewhere in it, or in none (bodies,)."""
        density = self.in_cells.get("electric_displacement")
        every = np.ones(self.count, bool)
        if density is None or not density.any():
            return every
        return np.bincount(self.body, np.abs(density).sum(axis=1), minlength=self.count) > 0.0

    @property
    def flat(self) -> bool:
        """Whether the mesh is two-dimensional."""
        return self.cell_type in _TRIANGLES

    @cached_property
    def size(self) -> float:
        """Largest extent without load, um."""
        return float(np.ptp(self.points, axis=0).max())

    @cached_property
    def von_mises(self) -> Array:
        """Von Mises stress at the nodes (n,), MPa."""
        return self.at_nodes(von_mises(self.stress))

    def at_nodes(self, values: Array) -> Array:
        """Values in the cells (m,) at the nodes (n,): mean of the cells around each, body by body."""
        count = np.bincount(self.cells.ravel(), minlength=len(self.points))
        spread = np.repeat(values, self.cells.shape[1])
        return np.bincount(self.cells.ravel(), spread, minlength=len(self.points)) / np.maximum(count, 1)

    def on_place(self, name: str) -> Booleans:
        """Whether each node (n,) is on a boundary or electrode."""
        if self.places is None or name not in self.place_names:
            return np.zeros(len(self.points), bool)
        return (self.places >> self.place_names.index(name)) & 1 == 1

    def triangles(self, body: int) -> Integers:
        """Triangles between the nodes of a body of a 2D mesh (t, 3)."""
        return self.cells[self.body == body][:, _TRIANGLES[self.cell_type]].reshape(-1, 3)

    @cached_property
    def outline(self) -> Integers:
        """Nodes of the edges on the boundary of each body of a 2D mesh (e, 2 or 3)."""
        edges = self.cells[:, _EDGES[self.cell_type]]
        edges = edges.reshape(-1, edges.shape[-1])
        ends = np.sort(edges[:, [0, -1]], axis=1)
        _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
        return edges[first[count == 1]]

    def vtk(self, points: Array, scalars: Array) -> Any:
        """The cells as a pyvista UnstructuredGrid at other points, with nodal `scalars`."""
        import pyvista

        padded = np.column_stack([np.full(len(self.cells), self.cells.shape[1]), self.cells]).ravel()
        types = np.full(len(self.cells), self.cell_type, np.uint8)
        grid = pyvista.UnstructuredGrid(padded, types, points)
        grid.point_data["scalars"] = scalars
        grid.cell_data["body"] = self.body
        return grid


@dataclass(frozen=True)
class ContactData:
    """The contact points of all ranks at a step (see `ContactPoints`)."""

    position: Array
    normal: Array
    gap: Array
    pressure: Array
    status: Integers
    pair: Integers

    @property
    def closed(self) -> NDArray[np.bool_]:
        """Which points touch or are bonded."""
        return (self.status == STATUS.index("touching")) | (self.status == STATUS.index("bonded"))

    def of(self, chosen: NDArray[np.bool_]) -> ContactData:
        """Some of the points."""
        return ContactData(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def main(self) -> ContactData:
        """The points of the pair that carries most; of the one that comes closest where none carries."""
        pairs = np.unique(self.pair)
        carried = [np.abs(self.pressure[self.pair == pair]).sum() for pair in pairs]
        nearest = [-self.gap[self.pair == pair].min() for pair in pairs]
        best = int(np.argmax(carried if max(carried) > 0 else nearest))
        return self.of(self.pair == pairs[best])

    @cached_property
    def axes(self) -> tuple[Array, Array, Array]:
        """Mean normal, pointing along its largest component, and two directions across it, as `frame`."""
        signed = self.normal * np.where(self.normal @ self.normal[0] < 0, -1.0, 1.0)[:, None]
        weight = self.closed if self.closed.any() else np.ones(len(self.gap), bool)
        return frame(signed[weight].mean(axis=0))


@dataclass(frozen=True)
class RunData:
    """Everything shown of a run. names: of its bodies, if there is a summary, and of its planes. scene: its tables."""

    title: str
    history: list[dict[str, Value]]
    step: int | None
    bodies: Bodies | None
    contact: ContactData | None
    names: tuple[Sequence[str], Sequence[str]] = ((), ())
    scene: Mapping[str, Any] = field(default_factory=dict)

    @property
    def row(self) -> dict[str, Value]:
        """The row of the history of the step that is shown; the last one without fields."""
        return next((row for row in self.history if row["step"] == self.step), self.history[-1] if self.history else {})

    @property
    def flat(self) -> bool:
        """Whether the run is two-dimensional."""
        if self.bodies is not None:
            return self.bodies.flat
        return not any("force_z@" in name for name in (self.history[0] if self.history else ()))

    @property
    def pairs(self) -> list[str]:
        """Names of the contact pairs, in the order of their numbers."""
        prefix = "contact_force_x@"
        names = self.history[0] if self.history else ()
        return [name.removeprefix(prefix) for name in names if name.startswith(prefix)]

    def pair_name(self, number: int) -> str:
        """The name of the pair of contact points with this number: a listed pair, two bodies, or a plane."""
        bodies, planes = self.names
        return Pairs(tuple(bodies), None, dict(enumerate(self.pairs)), tuple(planes)).result_name(number)

    def column(self, name: str) -> Array:
        """A column of the history, 0 for what is not finite. ResultsError: an entry is no number."""
        try:
            values = np.array([float(row[name]) for row in self.history])
        except ValueError as error:
            raise ResultsError(f"the history's column '{name}' has an entry that is no number: {error}") from error
        return np.nan_to_num(values)


def frame(normal: Array) -> tuple[Array, Array, Array]:
    """Unit normal n (its largest component positive) and t1, t2 across it, t1 nearest the first free axis."""
    largest = int(np.argmax(np.abs(normal)))
    unit = normal / np.linalg.norm(normal) * (1.0 if normal[largest] > 0 else -1.0)
    first = np.eye(3)[0 if largest != 0 else 1]
    first = first - (first @ unit) * unit
    first /= np.linalg.norm(first)
    second = np.cross(unit, first)
    return unit, first, second * (1.0 if second[np.argmax(np.abs(second))] > 0 else -1.0)


def read_run(directory: Path, step: int | None = None) -> RunData:
    """The run of a folder at a step. ResultsError: no results, unreadable ones, or no fields of this step.

    By default that is the last step with fields; but if nothing touches any more in it, the one with fields and the
    largest contact force.
    """
    directory = Path(directory)
    if not (directory / "history.csv").exists():
        raise ResultsError(f"{directory} holds no results of a run: it has no history.csv")
    history = read_history(directory / "history.csv")
    fields, contacts = read_index(directory / "fields.pvd"), read_index(directory / "contact.pvd")
    if not history and not fields:
        raise ResultsError(f"{directory} holds no step of a run yet: there is nothing to show")
    entry, scene = _shown(directory, history, fields, contacts), _scene(directory)
    if step is not None:
        entry = next((e for e in fields if e.step == step), None)
        if entry is None:
            known = named([str(e.step) for e in fields])
            raise ResultsError(f'--step: found {step}; allowed: {known} (output.fields = "all" writes each step)')
    step = entry.step if entry else None
    contact_entry = next((e for e in contacts if e.step == step), contacts[-1] if contacts and not fields else None)
    return RunData(
        title=str(scene.get("title") or directory.resolve().name),
        history=history,
        step=step if step is not None or contact_entry is None else contact_entry.step,
        bodies=_read_bodies(directory, entry) if entry else None,
        contact=_read_contact(directory, contact_entry) if contact_entry else None,
        names=(_bodies(directory), [plane["name"] for plane in scene.get("planes", [])]),
        scene=scene,
    )


def _shown(
    directory: Path, history: list[dict[str, Value]], fields: list[IndexEntry], contacts: list[IndexEntry]
) -> IndexEntry | None:
    if not fields:
        return None
    last = fields[-1]
    touching = next((entry for entry in contacts if entry.step == last.step), None)
    contact = _read_contact(directory, touching) if touching else None
    names = [name for name in (history[0] if history else {}) if name.startswith("contact_force_")]
    if contact is None or contact.closed.any() or not names:
        return last
    force = {int(row["step"]): max(abs(float(row[name])) for name in names) for row in history}
    return max(reversed(fields), key=lambda entry: force.get(entry.step, 0.0))


def _scene(directory: Path) -> dict[str, Any]:
    try:
        with (directory / "scene.toml").open("rb") as file:
            return tomllib.load(file)
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise ResultsError(f"cannot read {directory / 'scene.toml'}: {error}") from error


def _bodies(directory: Path) -> list[str]:
    """Names of the bodies; none of a run that has not ended, which has no summary."""
    summary = directory / "summary.json"
    try:
        return json.loads(summary.read_text(encoding="utf-8"))["bodies"] if summary.exists() else []
    except (OSError, ValueError, KeyError) as error:
        raise ResultsError(f"cannot read {summary}: {error}") from error


def _read_bodies(directory: Path, entry: IndexEntry) -> Bodies | None:
    piece = read_fields(directory, entry)
    if piece is None:
        return None
    grid = piece.grid
    names = ("stress", "strain", "electric_field", "electric_displacement")
    in_cells = {name: getattr(piece, name) for name in names if getattr(piece, name) is not None}
    return Bodies(
        grid.points, grid.cells, grid.cell_type, piece.displacement, piece.potential, piece.stress, piece.body,
        in_cells, piece.places, piece.place_names,
    )  # fmt: skip


def _read_contact(directory: Path, entry: IndexEntry) -> ContactData | None:
    points = read_contact(directory, entry)
    if points is None:
        return None
    return ContactData(
        points.position, points.normal, points.gap, points.pressure, points.status.astype(np.int64), points.pair
    )


def prefixed(values: Sequence[float] | Array, unit: str) -> tuple[float, str]:
    """Factor and unit with an SI prefix in which the largest of `values`, given in `unit`, is 1 to 1000.

    `unit` may have a prefix, and a divisor that stays: "µN/µm" may become "nN/µm".
    """
    match = re.fullmatch(r"(?P<prefix>[afpnµmkMG]?)(?P<unit>N|Pa|V|C)(?P<rest>.*)", unit)
    finite = np.abs(np.asarray(values, float))
    largest = finite[np.isfinite(finite)].max(initial=0.0)
    if match is None or largest == 0:
        return 1.0, unit
    own = next(power for power, prefix in _PREFIXES.items() if prefix == match["prefix"])
    # a hair is allowed, so that 1000 in the smaller unit does not turn into 0.9999 in the larger one
    power = 3 * int(np.floor((np.log10(largest) + own) / 3 + 1e-9))
    power = min(max(power, min(_PREFIXES)), max(_PREFIXES))
    return float(10.0 ** (own - power)), f"{_PREFIXES[power]}{match['unit']}{match['rest']}"


def magnification(displacement: Array, size: float) -> float:
    """1 if the largest displacement is 2 % of the size or more, else a round factor to make it 2 to 5 %."""
    largest = float(np.linalg.norm(displacement, axis=1).max(initial=0.0))
    if largest >= 0.02 * size or largest <= 1e-12 * size:
        return 1.0
    factor = 0.05 * size / largest
    decade = 10.0 ** np.floor(np.log10(factor))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= factor))
