"""Example of a gmsh mesh for your own scene: three parallel fibers packed as in a mat, two below and one above.

    .venv/bin/python scripts/make_fiber_mesh.py mat.msh                  three fibers that touch, 2D
    .venv/bin/python scripts/make_fiber_mesh.py mat.msh --above 0.3      a thinner one above
    .venv/bin/python scripts/make_fiber_mesh.py mat.msh --gmsh           shows it in gmsh's window, if there is one

The mesh of the scene app/scenes/own_mesh.toml is made by this script. Copy and change it: it needs gmsh alone and shows
all that a mesh for piezomat must have.

- One physical group of dimension 2 (in 3D: volumes) a body: its name is the key in the scene's [bodies]. Bodies that
  meet in contact share no nodes; those that share nodes are bonded.
- One physical group of dimension 1 (in 3D: surfaces) for each part of the outside that a [[boundaries]] row or a
  contact pair names. What no row names is free, and can touch other bodies if contact.pairs is "auto".
- One type of cells: all triangles, or all quadrilaterals (3D: tetrahedra or hexahedra). A 2D mesh lies in x-y.
- Lengths are in micrometres. MSH 4.1 or 2.2, text or binary, of any order: the scene's mesh.order decides.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import gmsh

FLAT = 0.6  # the two lower fibers and the upper one end in a flat, bonded to its electrode, so many radii from the axis


def cut_disc(x: float, y: float, radius: float, flat: float) -> int:
    """Surface of a disc, cut off at the height `flat` (below its axis: the lower part is cut off)."""
    disc = gmsh.model.occ.addDisk(x, y, 0, radius, radius)
    height = 2 * radius
    box = gmsh.model.occ.addRectangle(x - height, flat - height if flat < y else flat, 0, 2 * height, height)
    (_, surface), *_ = gmsh.model.occ.cut([(2, disc)], [(2, box)])[0]
    return surface


def draw(radius: float, above: float) -> tuple[list[int], list[tuple[float, float]]]:
    """Surfaces of the left, the right and the upper fiber, and the points where they touch."""
    left, right = (-radius, 0.0), (radius, 0.0)
    axis = (0.0, math.sqrt((radius + above) ** 2 - radius**2))
    bodies = [cut_disc(*center, radius, center[1] - FLAT * radius) for center in (left, right)]
    bodies.append(cut_disc(*axis, above, axis[1] + FLAT * above))
    share = radius / (radius + above)
    touches = [(0.0, 0.0), *((x * (1 - share), axis[1] * share) for x in (left[0], right[0]))]
    # Circles become polygons: a vertex of both where they touch, so that there is neither an overlap nor a gap.
    for number, others in enumerate(((0, 1), (0, 2), (1, 2))):
        points = [(0, gmsh.model.occ.addPoint(*touches[i], 0)) for i in others]
        parts, _ = gmsh.model.occ.fragment([(2, bodies[number])], points)
        bodies[number] = next(tag for dim, tag in parts if dim == 2)
    gmsh.model.occ.synchronize()
    return bodies, touches


def name_groups(bodies: list[int]) -> None:
    """Physical groups: three bodies, and the flats that are bonded to electrodes."""
    for surface, name in zip(bodies, ("left", "right", "above"), strict=True):
        gmsh.model.addPhysicalGroup(2, [surface], name=name)
    flats = {"bottom": bodies[:2], "top": bodies[2:]}
    for name, surfaces in flats.items():
        curves = gmsh.model.getBoundary([(2, s) for s in surfaces], combined=False, oriented=False)
        lines = [tag for dim, tag in curves if gmsh.model.getType(dim, tag) == "Line"]
        gmsh.model.addPhysicalGroup(1, lines, name=name)


def set_sizes(touches: list[tuple[float, float]], radius: float, size: float, fine: float) -> None:
    """Cells of size `fine` within a fifth of a radius of where the fibers touch, growing to `size` one radius away."""
    fields = gmsh.model.mesh.field
    sizes = []
    for x, y in touches:
        distance, threshold = fields.add("MathEval"), fields.add("Threshold")
        fields.setString(distance, "F", f"Sqrt((x-({x!r}))^2+(y-({y!r}))^2)")
        fields.setNumber(threshold, "InField", distance)
        options = {"SizeMin": fine, "SizeMax": size, "DistMin": 0.2 * radius, "DistMax": radius}
        for option, value in options.items():
            fields.setNumber(threshold, option, value)
        sizes.append(threshold)
    least = fields.add("Min")
    fields.setNumbers(least, "FieldsList", sizes)
    fields.setAsBackgroundMesh(least)
    for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)


def main() -> None:
    """Draw, name, mesh, write."""
    parser = argparse.ArgumentParser(description="Makes the mesh of three fibers, two below and one above.")
    parser.add_argument("out", type=Path, help="the mesh file to write (.msh)")
    parser.add_argument("--radius", type=float, default=0.5, help="of the two lower fibers (um, default 0.5)")
    parser.add_argument("--above", type=float, default=0.5, help="radius of the upper fiber (um, default 0.5)")
    parser.add_argument("--size", type=float, default=0.08, help="of cells away from contact (um, default 0.08)")
    parser.add_argument("--fine", type=float, default=0.015, help="of cells where fibers touch (um, default 0.015)")
    parser.add_argument("--gmsh", action="store_true", help="show the mesh in gmsh's window")
    arguments = parser.parse_args()
    for name in ("radius", "above", "size", "fine"):
        if not getattr(arguments, name) > 0:
            parser.error(f"--{name} must be greater than 0")
    if arguments.out.suffix != ".msh":
        parser.error(f"{arguments.out}: the name of a mesh file ends in .msh")

    gmsh.initialize(argv=[], interruptible=False)
    try:
        gmsh.option.setNumber("General.Verbosity", 2)
        gmsh.option.setNumber("Mesh.Binary", 1)
        bodies, touches = draw(arguments.radius, arguments.above)
        name_groups(bodies)
        set_sizes(touches, arguments.radius, arguments.size, min(arguments.fine, arguments.size))
        gmsh.model.mesh.generate(2)
        gmsh.write(str(arguments.out))
        nodes = len(gmsh.model.mesh.getNodes()[0])
        if arguments.gmsh:
            gmsh.fltk.run()
    finally:
        gmsh.finalize()
    print(f"{nodes} nodes in {arguments.out}: bodies left, right, above; facet groups bottom, top")


if __name__ == "__main__":
    main()
