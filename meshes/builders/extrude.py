"""Bodies extruded from sections: simplices in their outline, or quadrilaterals and bricks in patches."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gmsh
import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.builders.centre_lines import Fiber
from piezomat.meshes.builders.sections import Disc, HalfDisc, Patch, Rectangle
from piezomat.meshes.builders.sizes import (
    LINE,
    PATCH,
    POINT,
    Grading,
    Line,
    MeshSizes,
    Point,
    cells_in,
    straight,
    use_fields,
)
from piezomat.meshes.builders.structured import BodyPatch, Lattice, PatchMesh
from piezomat.meshes.gmsh_io import model as gmsh_model

# Bodies in 2D from which on each is meshed by itself; fewer take no longer together.
MANY = 20
TOGETHER = 50  # bodies that are added to a gmsh model at once


@dataclass(frozen=True)
class Frame:
    """Position of a section: (s, t) are measured from `origin`; in 3D the body extends along `axis`."""

    origin: Point
    s: Point = (1.0, 0.0, 0.0)
    t: Point = (0.0, 1.0, 0.0)
    axis: Point | None = None

    @classmethod
    def upright(cls, across: float, up: float, angle: float | None = None) -> Frame:
        """Frame with t upwards: in 2D (no angle) x and y; in 3D across a body at `angle` degrees from x."""
        if angle is None:
            return cls((across, up, 0.0))
        c, s = float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))
        return cls((-s * across, c * across, up), (-s, c, 0.0), (0.0, 0.0, 1.0), (c, s, 0.0))

    def place(self, section: Array, along: Array | float = 0.0) -> Array:
        """Positions (..., 3) of points (..., 2) of the section, moved along the axis by `along` (...,)."""
        axis = np.asarray(self.axis or (0.0, 0.0, 0.0))
        plane = section[..., :1] * np.asarray(self.s) + section[..., 1:] * np.asarray(self.t)
        return np.asarray(self.origin) + plane + np.asarray(along)[..., None] * axis


@dataclass(frozen=True)
class Body:
    """Section in its frame, in 3D extruded over `length` (um).

    contacts: points of the section where it meets other bodies, in 3D along lines or, if `crossed`, at points in the
    middle of the length; radius (um): scale of the zone of fine cells; ends: groups of the two ends in 3D.
    """

    name: str
    section: HalfDisc | Disc | Rectangle
    frame: Frame
    contacts: Sequence[tuple[float, float]]
    radius: float
    length: float | None = None
    crossed: bool = False
    ends: tuple[str, str] = ("", "")

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return 2 if self.length is None else 3

    @property
    def centre_line(self) -> Fiber:
        """The line of the origin of its section along the body, in 3D: the axis of a disc or half disc."""
        ends = self.frame.place(np.zeros((2, 2)), 0.5 * self.length * np.array([-1.0, 1.0]))
        return Fiber(self.name, ends, self.radius)

    def in_units_of(self, unit: float) -> Body:
        """The body with its lengths in another unit, um."""
        return replace(
            self,
            section=self.section.in_units_of(unit),
            frame=replace(self.frame, origin=tuple(x / unit for x in self.frame.origin)),
            contacts=[(s / unit, t / unit) for s, t in self.contacts],
            radius=self.radius / unit,
            length=None if self.length is None else self.length / unit,
        )


def draw(bodies: Sequence[Body], groups: Iterable[str], sizes: MeshSizes) -> None:
    """Mesh bodies into the current gmsh model and name them and their facet groups, in the order of `groups`."""
    if sizes.tensor:
        _draw_patches(bodies, groups, sizes)
    else:
        _draw_freely(bodies, groups, sizes)


def _draw_patches(bodies: Sequence[Body], groups: Iterable[str], sizes: MeshSizes) -> None:
    """Mesh with quadrilaterals or bricks, patch by patch."""
    mesh = PatchMesh(bodies[0].dimension)
    kinds: dict[tuple[object, ...], list[Patch]] = {}
    for some in _some_at_a_time(bodies):
        for body in some:
            kind = _kind(body, sizes) if len(bodies) >= MANY else (body.name,)
            if kind not in kinds:
                size = Grading.of(sizes, body.name, body.radius, PATCH).about(body.contacts)
                kinds[kind] = body.section.patches(size, sizes.order)
            mesh.add(*_placed(kinds[kind], body, sizes))
    mesh.finish(groups)


def _placed(patches: Sequence[Patch], body: Body, sizes: MeshSizes) -> list[BodyPatch]:
    """The patches of a body's section as those of the body."""
    layers = _layers(body, sizes)
    drawn = []
    for patch in patches:
        sides = {side: [group] for side, group in patch.sides.items()}
        if layers is None:
            points = body.frame.place(patch.points)[..., :2]
        else:
            points = body.frame.place(patch.points[:, :, None, :], layers)
            sides |= {(2, 0): [body.ends[0]], (2, -1): [body.ends[1]]}
        drawn.append(BodyPatch(body.name, Lattice(points, sizes.order, True), sides))
    return drawn


def _layers(body: Body, sizes: MeshSizes) -> Array | None:
    """Positions of nodes along the axis, symmetric about the middle; None in 2D."""
    if body.length is None:
        return None
    half = 0.5 * body.length
    if not body.crossed:
        cells = cells_in(body.length, sizes.of(body.name)[1])
        return np.linspace(-half, half, cells * sizes.order + 1)
    grading = Grading.of(sizes, body.name, body.radius, LINE)
    line = Line(straight((0.0,), (half,)), lambda x: grading.at(x[:, 0]))
    ahead = line.divide(line.cells, sizes.order)[:, 0]
    return np.concatenate([-ahead[:0:-1], ahead])


def _draw_freely(bodies: Sequence[Body], groups: Iterable[str], sizes: MeshSizes) -> None:
    """Mesh with triangles or tetrahedra inside the outlines."""
    if bodies[0].dimension == 3 or len(bodies) < MANY:
        entities, facets = _mesh_freely(bodies, sizes)
    else:
        entities, facets = _mesh_one_by_one(bodies, sizes)
    gmsh_model.add_groups(bodies[0].dimension, entities)
    gmsh_model.add_groups(bodies[0].dimension - 1, {group: facets[group] for group in groups})


def _mesh_freely(bodies: Sequence[Body], sizes: MeshSizes) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
    """Draw and mesh bodies in the current gmsh model: entities by body, and of the boundary by group.

    They are drawn in units of the least diameter. gmsh's tolerances are lengths: in other units cells were others, a
    force 5 % off, and bodies of 1e5 um got none.
    """
    dim, unit = bodies[0].dimension, 2.0 * min(body.radius for body in bodies)
    bodies, sizes = [body.in_units_of(unit) for body in bodies], sizes.in_units_of(unit)
    entities: dict[str, list[int]] = {}
    facets: dict[str, list[int]] = {}
    fields = []
    for body in bodies:
        entity, named = _draw_outline(body)
        entities[body.name] = [entity]
        for group, facet in named:
            facets.setdefault(group, []).append(facet)
        places = [tuple(body.frame.place(np.array(contact)).tolist()) for contact in body.contacts]
        grading = Grading.of(sizes, body.name, body.radius, POINT if body.crossed else LINE)
        fields.append(grading.field((dim, entity), places, None if body.crossed else body.frame.axis))
    use_fields(fields)
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    gmsh.model.mesh.generate(dim)
    gmsh.model.mesh.setOrder(sizes.order)
    if sizes.order > 1:
        # Repairs the cells that the curved boundary has made invalid and leaves the others.
        gmsh.model.mesh.optimize("HighOrder")
    gmsh.model.mesh.affineTransform(np.column_stack([unit * np.eye(3), np.zeros(3)]).ravel())
    return entities, facets


def _mesh_one_by_one(bodies: Sequence[Body], sizes: MeshSizes) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
    """The same in 2D with a model for each body, and copies of bodies that differ by their place alone.

    In one model gmsh evaluates the size fields of all bodies everywhere, so that the time grows with the square of
    their number: 300 fibers took 22 s, 3,000 would take half an hour.
    """
    whole = gmsh.model.getCurrent()
    kinds: dict[tuple[object, ...], _Meshed] = {}
    drawn = []
    for body in bodies:
        kind = _kind(body, sizes)
        if kind not in kinds:
            kinds[kind] = _Meshed.of(body, sizes)
        drawn.append(kinds[kind])
    gmsh.model.setCurrent(whole)
    entities = {body.name: [number] for number, body in enumerate(bodies, start=1)}
    groups = dict.fromkeys(group for meshed in drawn for group in meshed.facets)
    facets = {group: [number] for number, group in enumerate(groups, start=1)}
    nodes, elements = _Tags(), _Tags()
    for some in _some_at_a_time(list(zip(bodies, drawn, strict=True))):
        for body, meshed in some:
            meshed.add(body, entities[body.name][0], facets, nodes, elements)
    return entities, facets


def _some_at_a_time(bodies: Sequence[Any]) -> Iterator[Sequence[Any]]:
    """Bodies a few at a time, the current gmsh model being one of their own if there are many.

    gmsh looks up all nodes of a model for each entity that gets elements. What is added to that model comes into the
    present one through a file, with its tags. For 3,000 fibers this takes 25 s instead of 78.
    """
    if len(bodies) <= TOGETHER:
        yield bodies
        return
    whole = gmsh.model.getCurrent()
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "bodies.msh"
        for first in range(0, len(bodies), TOGETHER):
            gmsh.model.add("bodies")
            yield bodies[first : first + TOGETHER]
            gmsh.option.setNumber("Mesh.SaveAll", 1)
            gmsh_model.write(file)
            gmsh.option.setNumber("Mesh.SaveAll", 0)
            gmsh.model.remove()
            gmsh.model.setCurrent(whole)
            gmsh.merge(str(file))


class _Tags:
    """Tags not yet given to a node or element."""

    def __init__(self) -> None:
        self.first = 1

    def take(self, count: int) -> Integers:
        """The next `count` tags."""
        tags = np.arange(self.first, self.first + count)
        self.first += count
        return tags


def _kind(body: Body, sizes: MeshSizes) -> tuple[object, ...]:
    """What bodies in 2D have in common that differ by their place alone; contacts are equal up to rounding."""
    contacts = {tuple(np.round(np.divide(point, body.radius), 9).tolist()) for point in body.contacts}
    return body.section, body.radius, frozenset(contacts), sizes.of(body.name)


@dataclass(frozen=True)
class _Meshed:
    """A body in 2D, meshed by itself.

    origin (3,), um: of its frame; x (n, 3), um: nodes; cells (k, nodes) and facets (l, nodes) of each group, numbered
    through `x`, with their gmsh types.
    """

    origin: Point
    x: Array
    cells: Integers
    cell_type: int
    facets: dict[str, Integers]
    facet_type: int

    def add(self, body: Body, entity: int, facets: dict[str, list[int]], nodes: _Tags, elements: _Tags) -> None:
        """Add a copy for this body to the current gmsh model, with entities of the body and of each group."""
        tags = nodes.take(len(self.x))
        x = self.x + np.subtract(body.frame.origin, self.origin)
        gmsh.model.addDiscreteEntity(2, entity)
        gmsh.model.mesh.addNodes(2, entity, tags, x.ravel())
        cells = tags[self.cells]
        gmsh.model.mesh.addElementsByType(entity, self.cell_type, elements.take(len(cells)), cells.ravel())
        there = {tag for _, tag in gmsh.model.getEntities(1)}
        for group, numbers in self.facets.items():
            (boundary,) = facets[group]
            if boundary not in there:
                gmsh.model.addDiscreteEntity(1, boundary)
            facet_tags = elements.take(len(numbers))
            gmsh.model.mesh.addElementsByType(boundary, self.facet_type, facet_tags, tags[numbers].ravel())

    @classmethod
    def of(cls, body: Body, sizes: MeshSizes) -> _Meshed:
        """Mesh a body in a gmsh model of its own, which is removed."""
        gmsh.model.add("body")
        entities, groups = _mesh_freely([body], sizes)
        tags, x = gmsh_model.nodes()
        order = np.argsort(tags)
        (cells,) = gmsh_model.elements(2, entities[body.name][0])
        found = {group: [e for tag in tags for e in gmsh_model.elements(1, tag)] for group, tags in groups.items()}
        facets = {group: np.concatenate([e.nodes for e in of_group]) for group, of_group in found.items()}
        kind = next(e.type for of_group in found.values() for e in of_group)
        gmsh.model.remove()
        numbers = {group: np.searchsorted(tags[order], nodes) for group, nodes in facets.items()}
        return cls(body.frame.origin, x[order], np.searchsorted(tags[order], cells.nodes), cells.type, numbers, kind)


def _draw_outline(body: Body) -> tuple[int, list[tuple[str, int]]]:
    """Draw one body: its entity, and the group of each entity of its boundary."""
    occ = gmsh.model.occ
    outline = body.section.outline()
    start = 0.0 if body.length is None else -0.5 * body.length
    corners = [occ.addPoint(*body.frame.place(np.array(edge.start), start)) for edge in outline]
    center = occ.addPoint(*body.frame.place(np.zeros(2), start))
    curves = []
    for edge, a, b in zip(outline, corners, corners[1:] + corners[:1], strict=True):
        curves.append(occ.addCircleArc(a, center, b) if edge.round else occ.addLine(a, b))
    occ.remove([(0, center)])
    section = occ.addPlaneSurface([occ.addCurveLoop(curves)])
    groups = [edge.group for edge in outline]
    if body.length is None:
        occ.synchronize()
        return section, list(zip(groups, curves, strict=True))
    made = occ.extrude([(2, section)], *(body.length * np.asarray(body.frame.axis)))
    occ.synchronize()
    # Each curve of the section bounds the section and the face swept from it.
    swept = [(set(gmsh.model.getAdjacencies(1, curve)[0].tolist()) - {section}).pop() for curve in curves]
    ends = zip(body.ends, (section, made[0][1]), strict=True)
    return made[1][1], [*zip(groups, swept, strict=True), *ends]
