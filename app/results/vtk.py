"""Pieces: fields and contact points of one rank for VTK; and the .pvd index that names the files of all ranks."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.results.atomic import write_text

STATUS = ("apart", "touching", "bonded", "broken")
AXES = ("x", "y", "z")
STRESSES = ("xx", "yy", "zz", "yz", "xz", "xy")
# Names of the components of each field; ParaView's own would call the third shear of a stress XZ.
COMPONENTS = {
    "displacement": AXES,
    "stress": STRESSES,
    "strain": STRESSES,
    "electric_field": AXES,
    "electric_displacement": AXES,
    "poling": AXES,
    "normal": AXES,
}
# the file of one rank and one step
PIECE = re.compile(r"step_(?P<step>\d{4,})_rank_(?P<rank>\d{4,})\.vt[up]")

# VTK's cell type of each (dolfinx cell, number of nodes)
_VTK_CELLS = {
    ("triangle", 3): 5,
    ("triangle", 6): 22,
    ("quadrilateral", 4): 9,
    ("quadrilateral", 9): 28,
    ("tetrahedron", 4): 10,
    ("tetrahedron", 10): 24,
    ("hexahedron", 8): 12,
    ("hexahedron", 27): 29,
}


class ResultsError(ValueError):
    """The folder holds no results, or results that do not fit; the message says what."""


@dataclass(frozen=True)
class Grid:
    """This rank's cells: points (n, 3) um, cells (m, nodes) in VTK's order of nodes, one VTK cell type."""

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    cell_type: int


def grid(mesh: Any) -> Grid:
    """This rank's cells of a dolfinx mesh; its points are the geometry's nodes, in their local order."""
    cell_type, nodes = fenicsx.cell_name(mesh), fenicsx.nodes_per_cell(mesh)
    points = np.array(mesh.geometry.x, float).reshape(-1, 3)
    cells = np.empty((0, nodes), np.int64)
    if len(points):
        order = fenicsx.vtk_permutation(cell_type, nodes)
        cells = fenicsx.geometry_dofmap(mesh)[:, order].astype(np.int64)
    return Grid(points, cells, _VTK_CELLS[cell_type, nodes])


@dataclass(frozen=True)
class FieldPiece:
    """Fields of this rank's cells; the electric ones are None where there is no potential.

    At the grid's points: displacement (n, 3) um, potential (n,) V. In its cells: stress (m, 6) MPa and strain (m, 6),
    which has engineering shears, both in the order 11 22 33 23 13 12; body (m,), its number; electric_field (m, 3)
    V/um; electric_displacement (m, 3) pC/um2; poling (m, 3), a unit vector, zero where a material has no axes.
    body_names: by its number. At the points besides: places (n,), whose bit i says whether the point belongs to the
    boundary or electrode with number i of `place_names`.
    """

    grid: Grid
    displacement: NDArray[np.float64]
    stress: NDArray[np.float64]
    body: NDArray[np.integer]
    potential: NDArray[np.float64] | None = None
    electric_field: NDArray[np.float64] | None = None
    electric_displacement: NDArray[np.float64] | None = None
    strain: NDArray[np.float64] | None = None
    poling: NDArray[np.float64] | None = None
    body_names: tuple[str, ...] = ()
    places: NDArray[np.integer] | None = None
    place_names: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.grid.cells)

    @property
    def von_mises(self) -> NDArray[np.float64]:
        """Von Mises stress in the cells (m,), MPa."""
        return von_mises(self.stress)

    def vtk(self) -> Any:
        """The piece as a pyvista UnstructuredGrid; ValueError where an array's length is wrong."""
        import pyvista

        cells, nodes = self.grid.cells.shape
        padded = np.column_stack([np.full(cells, nodes), self.grid.cells]).ravel()
        types = np.full(cells, self.grid.cell_type, np.uint8)
        data = pyvista.UnstructuredGrid(padded, types, self.grid.points)
        _attach(data.point_data, len(self.grid.points), self, ("displacement", "potential", "places"))
        in_cells = ("stress", "von_mises", "strain", "electric_field", "electric_displacement", "poling", "body")
        _attach(data.cell_data, cells, self, in_cells)
        _name(data, "body_names", self.body_names)
        if self.places is not None:
            _name(data, "place_names", self.place_names)
        return data


@dataclass(frozen=True)
class ContactPoints:
    """Contact points of this rank.

    position (n, 3) now, um; normal (n, 3) of the surface met; gap (n,) um; pressure (n,) MPa, negative where
    adhesion pulls; status (n,), place in `STATUS`; pair (n,), number of the contact pair; potential_jump (n,)
    V, None where there is no potential. pair_names: of the pairs and planes of the points, by number.
    """

    position: NDArray[np.float64]
    normal: NDArray[np.float64]
    gap: NDArray[np.float64]
    pressure: NDArray[np.float64]
    status: NDArray[np.integer]
    pair: NDArray[np.integer]
    potential_jump: NDArray[np.float64] | None = None
    pair_names: Mapping[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.position)

    def vtk(self) -> Any:
        """The points as a pyvista PolyData; ValueError where an array's length is wrong."""
        import pyvista

        data = pyvista.PolyData(np.asarray(self.position, float)) if len(self) else pyvista.PolyData()
        names = ("normal", "gap", "pressure", "potential_jump", "status", "pair")
        _attach(data.point_data, len(self), self, names)
        _name(data, "status_names", STATUS)
        if self.pair_names:
            _name(data, "pair_names", tuple(self.pair_names.values()))
            data.field_data["pair_numbers"] = np.array(list(self.pair_names), np.int32)
        return data


@dataclass(frozen=True)
class IndexEntry:
    """A step in a .pvd index: its number, its time, its files relative to the index."""

    step: int
    time: float
    files: tuple[Path, ...]


def von_mises(stress: NDArray[np.float64]) -> NDArray[np.float64]:
    """Von Mises stress (m,) of stresses (m, 6), MPa."""
    s11, s22, s33, s23, s13, s12 = stress.T
    shear = s23**2 + s13**2 + s12**2
    return np.sqrt(((s11 - s22) ** 2 + (s22 - s33) ** 2 + (s33 - s11) ** 2) / 2 + 3 * shear)


def xml(data: Any) -> bytes:
    """The file of a pyvista UnstructuredGrid or PolyData. OSError: VTK could not write it.

    VTK writes to memory, since it neither raises nor keeps the process alive where a disk is full.
    """
    import vtkmodules.vtkIOXML as vtk_io

    grid = data.IsA("vtkUnstructuredGrid")
    writer = vtk_io.vtkXMLUnstructuredGridWriter() if grid else vtk_io.vtkXMLPolyDataWriter()
    writer.SetInputData(data)
    writer.SetDataModeToBinary()
    writer.SetCompressorTypeToZLib()  # its level is lower than that of a new writer: half the time
    writer.SetWriteToOutputString(True)
    written = writer.Write()
    text = writer.GetOutputString()
    if not written or not text.rstrip().endswith("</VTKFile>"):
        raise OSError("VTK could not write its file")
    return text.encode()


def read_index(path: Path) -> list[IndexEntry]:
    """The steps named in a .pvd index, in order; none where it does not exist. ResultsError: unreadable."""
    if not path.exists():
        return []
    found: dict[int, tuple[float, list[Path]]] = {}
    try:
        for data in ET.parse(path).getroot().iter("DataSet"):
            file = Path(data.attrib["file"])
            match = PIECE.fullmatch(file.name)
            if match is None:
                raise ValueError(f"it names a file {file}")
            found.setdefault(int(match["step"]), (float(data.attrib["timestep"]), []))[1].append(file)
    except (ET.ParseError, KeyError, ValueError) as error:
        raise ResultsError(f"{path} is not an index of results: {error}") from error
    return [IndexEntry(step, time, tuple(files)) for step, (time, files) in sorted(found.items())]


def write_index(path: Path, entries: Sequence[IndexEntry]) -> None:
    """Write a .pvd index of the steps, as a whole or not at all."""
    root = ET.Element("VTKFile", type="Collection", version="0.1", byte_order="LittleEndian")
    collection = ET.SubElement(root, "Collection")
    for entry in sorted(entries, key=lambda entry: entry.step):
        for part, file in enumerate(entry.files):
            place = {"timestep": repr(entry.time), "group": "", "part": str(part), "file": file.as_posix()}
            ET.SubElement(collection, "DataSet", place)
    ET.indent(root)
    write_text(path, '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n")


def _attach(data: Any, length: int, source: object, names: Sequence[str]) -> None:
    """Put those attributes of `source` that are not None into VTK's data; ValueError if a length is wrong."""
    for name in names:
        values = getattr(source, name)
        if values is None:
            continue
        values = np.asarray(values)
        if len(values) != length:
            raise ValueError(f"{name} has {len(values)} values where {length} are needed")
        if length:
            data[name] = values.astype(np.int32 if values.dtype.kind in "iub" else float)
            for component, text in enumerate(COMPONENTS.get(name, ())):
                data.get_array(name).VTKObject.SetComponentName(component, text)


def _name(data: Any, name: str, texts: Sequence[str]) -> None:
    """Put texts into VTK's field data; pyvista would refuse what is not ASCII."""
    from vtkmodules.vtkCommonCore import vtkStringArray

    array = vtkStringArray()
    array.SetName(name)
    for text in texts:
        array.InsertNextValue(text)
    data.GetFieldData().AddArray(array)
