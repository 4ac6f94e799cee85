"""How large a scene would be, from its keys alone: bodies, points of fibers, cells.

What could never end is refused before anything is made. The estimate of cells is within a factor of three for the
shipped scenes. It integrates 1 / size^dimension over each body, about its places of contact and far from them.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.meshes.builders.sizes import LINE, POINT
from piezomat.meshes.gmsh_io.mesh_file import MeshFile
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.shapes.blocks import Cantilever, StackedBlocks
from piezomat.meshes.shapes.fiber_array import FiberArray
from piezomat.meshes.shapes.fibers import CrossedFibers, FacingHalves, FiberOnBlock, ParallelFibers
from piezomat.meshes.shapes.mats import CrossPly, Fibers, Mat
from piezomat.scene.errors import SceneError

LEAST, LARGEST = 1e-12, 1e12  # um
MOST_BODIES = 20_000
MOST_POINTS = 2_000_000  # of all centre lines, half a radius apart
MOST_POINTS_BENT = 8_000  # of one fiber that bends: its heights are found from all pairs of them
# Memory of a run (bytes a cell, order 1): with factors in 2D, multigrid in 3D. Order 2 has 4 and 8 times the nodes.
BYTES = {2: 4_000, 3: 8_000}
# Area of a triangle and volume of a tetrahedron over the power of the length of their edges.
SHARE = {2: 0.433, 3: 0.118}


class Size(NamedTuple):
    """bodies, points of all centre lines and of the longest one, cells; each a float, infinite where it overflows."""

    bodies: float
    points: float = 0.0
    longest: float = 0.0
    cells: float = 0.0


def check_size(geometry: Any, mesh: Any) -> None:
    """Raise SceneError for a geometry and sizes of cells that would not fit here, with the key and the estimate."""
    if isinstance(geometry, (MeshFile, Fibers)):
        _check_file(geometry.file)
    if isinstance(geometry, MeshFile):
        return
    _check_lengths(
        "geometry", geometry.model_dump(exclude={"seed", "angle", "angles", "tilt", "count", "divisions", "file"})
    )
    _check_lengths("mesh", mesh.model_dump(include={"size", "contact_size", "size_factors"}))
    with np.errstate(all="ignore"):
        size = estimate(geometry, mesh)
    key = f"geometry.{_key(geometry)}"
    if not size.bodies <= MOST_BODIES:
        raise SceneError(key, f"about {size.bodies:.3g} bodies", f"at most {MOST_BODIES:,}")
    if not size.points <= MOST_POINTS:
        allowed = f"at most {MOST_POINTS:,}: a shorter or thicker fiber, or fewer"
        raise SceneError(key, f"fibers of about {size.points:.3g} points, half a radius apart", allowed)
    if getattr(geometry, "bend_radius", None) is not None and not size.longest <= MOST_POINTS_BENT:
        allowed = f"at most {MOST_POINTS_BENT:,}, or no bend_radius"
        raise SceneError(key, f"a bending fiber of about {size.longest:.3g} points, half a radius apart", allowed)
    most = mesh.max_cells or most_cells(geometry, mesh.order)
    if not size.cells <= most:
        # A key of the size itself where sizes count, else of the divisions.
        counted = getattr(geometry, "divisions", None) is not None
        key = "geometry.divisions" if counted else "mesh.contact_size" if _graded(geometry, mesh) else "mesh.size"
        why = "mesh.max_cells" if mesh.max_cells else "what the memory here holds; mesh.max_cells raises it"
        raise SceneError(key, f"about {size.cells:.2g} cells", f"at most {most:,} ({why})")


def _check_lengths(path: str, values: Any) -> None:
    """Raise SceneError for a number that no length in um can be: squares and cubes of it would overflow or vanish."""
    if isinstance(values, dict):
        for key, value in values.items():
            _check_lengths(f"{path}.{key}", value)
    elif isinstance(values, list):
        for index, value in enumerate(values):
            _check_lengths(f"{path}[{index}]", value)
    elif isinstance(values, float) and values != 0.0 and not LEAST <= abs(values) <= LARGEST:
        raise SceneError(path, values, f"0, or a size between {LEAST:g} and {LARGEST:g}")


def estimate(geometry: Any, mesh: Any) -> Size:
    """The size of a built shape, whose divisions or sizes of cells are known."""
    far = np.float64(mesh.size if mesh.size is not None else np.inf)
    fine = np.minimum(np.float64(mesh.contact_size or far), far)
    match geometry:
        case StackedBlocks() | Cantilever():
            return Size(_layers(geometry), cells=_blocks(geometry, mesh, far))
        case FiberArray():
            bodies = np.float64(geometry.columns) * geometry.rows
            neighbours = 4.0 if geometry.arrangement == "square" else 6.0
            return _fibers(bodies, geometry.radius, geometry.length, neighbours, fine, far, mesh)
        case ParallelFibers():
            return _fibers(np.float64(geometry.count), geometry.radius, geometry.length, 2.0, fine, far, mesh)
        case CrossPly():
            across = np.hypot(geometry.width, geometry.depth)
            bodies = len(geometry.angles) * (across / geometry.spacing + 1.0)
            length = min(across, 1.5 * max(geometry.width, geometry.depth))
            return _laid(bodies, geometry, length, fine, far, mesh)
        case Fibers():
            return _of_table(geometry, fine, far, mesh)
        case Mat():
            length = geometry.length or min(
                1.5 * min(geometry.width, geometry.depth), np.hypot(geometry.width, geometry.depth)
            )
            return _laid(_of_mat(geometry, length), geometry, length, fine, far, mesh)
        case FacingHalves() | CrossedFibers() | FiberOnBlock():
            return _two_fibers(geometry, fine, far, mesh)
    cells = geometry.measure() / far**geometry.dimension / _share(geometry.dimension, mesh)
    return Size(len(geometry.bodies()), cells=float(cells))


def _two_fibers(geometry: Any, fine: Any, far: Any, mesh: Any) -> Size:
    """Two fibers, or one on a block."""
    length = getattr(geometry, "length", None)
    crossed = isinstance(geometry, CrossedFibers)
    cells = 2.0 * _round(geometry.radius, length, 1.0, fine, far, mesh, POINT if crossed else LINE, crossed)
    if isinstance(geometry, FiberOnBlock):
        cells += _power([geometry.width, geometry.height, length], far, mesh)
    return Size(2.0, cells=float(cells))


def most_cells(geometry: Any, order: int) -> int:
    """Number of cells that the memory of this machine holds."""
    dimension = geometry.dimension
    return int(memory() / (BYTES[dimension] * (2**dimension if order == 2 else 1)))


def memory() -> float:
    """Memory of this machine (bytes), or what this process may use of it."""
    total = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for limit in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        try:
            total = min(total, float(Path(limit).read_text()))
        except (OSError, ValueError):  # no such file, or "max"
            continue
    return total


def _check_file(path: Path) -> None:
    """Raise SceneError for a file that would fill the memory when it is read."""
    try:
        size = path.stat().st_size
    except OSError:
        return  # whoever reads it says so
    most = int(memory() / 20)  # numbers are read whole, and kept three times
    if size > most:
        raise SceneError(
            "geometry.file", f"a file of {size:,} bytes", f"at most {most:,}: a twentieth of the memory here"
        )


def _key(geometry: Any) -> str:
    """The key that gives the number of bodies or the length of fibers."""
    match geometry:
        case FiberArray():
            return "columns" if geometry.columns >= geometry.rows else "rows"
        case ParallelFibers():
            return "count"
        case CrossPly():
            return "width" if geometry.width >= geometry.depth else "depth"
        case Fibers():
            return "file"
        case Mat():
            given = [key for key in ("count", "areal_density", "thickness") if getattr(geometry, key) is not None]
            points = max(geometry.width, geometry.depth) / geometry.radius
            return (
                given[0]
                if given and points < MOST_POINTS_BENT
                else "width"
                if geometry.width >= geometry.depth
                else "depth"
            )
    return "shape"


def _graded(geometry: Any, mesh: Any) -> bool:
    """Whether the contact size decides the number of cells."""
    return not isinstance(geometry, (StackedBlocks, Cantilever)) and (mesh.contact_size or mesh.size) < mesh.size


def _layers(geometry: Any) -> int:
    return len(geometry.height if isinstance(geometry, StackedBlocks) else geometry.layers)


def _blocks(geometry: Any, mesh: Any, far: Any) -> float:
    """Cells of blocks: boxes, or 2 triangles or 6 tetrahedra of each."""
    dimension = geometry.dimension
    each = 1.0 if mesh.cells == "tensor" else (2.0 if dimension == 2 else 6.0)
    if geometry.divisions is not None:
        rows = geometry.divisions if isinstance(geometry, StackedBlocks) else [geometry.divisions] * _layers(geometry)
        return float(each * sum(np.prod(np.array(row, np.float64)) for row in rows))
    if isinstance(geometry, StackedBlocks):
        heights, plane = geometry.height, [geometry.width, geometry.depth]
    else:
        heights, plane = geometry.layers, [geometry.length, geometry.width]
    across = np.prod([np.ceil(extent / far) for extent in plane if extent is not None])
    return float(each * across * sum(np.ceil(height / far) for height in heights))


def _power(extents: list[float | None], far: Any, mesh: Any) -> float:
    """Cells of one size in a box."""
    given = [extent for extent in extents if extent is not None]
    return float(np.prod([max(extent / far, 1.0) for extent in given]) / _share(len(given), mesh))


def _share(dimension: int, mesh: Any) -> float:
    return 1.0 if mesh.cells == "tensor" else SHARE[dimension]


def _fibers(bodies: Any, radius: float, length: float | None, contacts: float, fine: Any, far: Any, mesh: Any) -> Size:
    """Whole parallel fibers."""
    return Size(float(bodies), cells=float(bodies * _round(radius, length, contacts, fine, far, mesh, LINE, False)))


def _laid(bodies: Any, geometry: Any, length: Any, fine: Any, far: Any, mesh: Any) -> Size:
    """Fibers laid on each other: sections swept along layers, close together at crossings."""
    longest = min(np.hypot(geometry.width, geometry.depth), getattr(geometry, "length", None) or np.inf)
    points = 2.0 * longest / geometry.radius
    section = _round(geometry.radius, None, 2.0, fine, far, mesh, LINE, False)
    layers = length / far + 0.5 * (length / geometry.radius) * (geometry.radius / fine)
    each = 1.0 if mesh.cells == "tensor" else 3.0
    return Size(float(bodies), float(bodies * points), float(points), float(bodies * section * layers * each))


def _of_table(geometry: Fibers, fine: Any, far: Any, mesh: Any) -> Size:
    """Fibers swept along the centre lines of a table, those of a table that cannot be read left out."""
    try:
        fibers = geometry.fibers
    except MeshError:
        return Size(0)  # whoever reads it says so
    each = 1.0 if mesh.cells == "tensor" else 3.0
    points, cells = [], 0.0
    for fiber in fibers:
        length = float(np.linalg.norm(np.diff(fiber.points, axis=0), axis=1).sum())
        points.append(2.0 * length / fiber.radius)
        cells += _round(fiber.radius, None, 2.0, fine, far, mesh, LINE, False) * max(length / far, 1.0) * each
    return Size(len(fibers), sum(points), max(points), float(cells))


def _of_mat(geometry: Mat, length: Any) -> float:
    """Number of fibers of a mat."""
    if geometry.count is not None:
        return np.float64(geometry.count)
    if geometry.areal_density is None and geometry.thickness is None:
        return 20.0
    height = np.float64(geometry.areal_density or geometry.thickness)
    share = 1.0 if geometry.areal_density is not None else 0.3  # a mat is mostly holes
    section = np.pi * np.float64(geometry.radius) ** 2
    return share * height * (geometry.width / section) * (geometry.depth / length) + 1.0


def _round(
    radius: float,
    length: float | None,
    contacts: float,
    fine: Any,
    far: Any,
    mesh: Any,
    zone: tuple[float, float],
    crossed: bool,
) -> float:
    """Cells of a fiber: far from contact, and about each place of contact, half a disc or half a ball in it."""
    r, dimension = np.float64(radius), 2 if length is None else 3
    share = _share(dimension, mesh)
    distance = np.linspace(0.0, zone[1], 200)  # in radii
    size = np.interp(distance, zone, (fine / r, far / r))
    if crossed:
        near = _sum(2.0 * np.pi * distance**2 / size**3, distance)
        return float((np.pi * (r / far) ** 2 * max(length / far, 1.0) + contacts * near) / share)
    along = size if mesh.cells != "tensor" else np.full_like(size, far / r)
    layers = 1.0 if length is None else np.maximum(length / r / along, 1.0)
    near = _sum(np.pi * distance / size**2 * layers, distance)
    everywhere = np.pi * (r / far) ** 2 * (1.0 if length is None else max(length / far, 1.0))
    return float((everywhere + contacts * near) / share)


def _sum(values: Array, x: Array) -> float:
    return float((0.5 * (values[1:] + values[:-1]) * np.diff(x)).sum())
