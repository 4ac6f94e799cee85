"""How cells hang together: shared facets, double nodes on each other, and bodies joined by nodes alone."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.body_mesh import create
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.gmsh_io.mesh_file import MeshFile
from piezomat.meshes.joints import CellFacets, Joint, connected_parts, doubtful_joints
from piezomat.meshes.shapes import MeshSizes

Cells = list[tuple[int, int]]


def grid(nodes: int, split: Iterable[tuple[int, int]] = (), below: Cells | None = None) -> tuple[Array, dict]:
    """Nodes of a grid of unit squares, and the number of each; those in `split` exist twice: ("again", i, j)."""
    number = {(i, j): i + nodes * j for j in range(nodes) for i in range(nodes)}
    x = [[float(i), float(j)] for j in range(nodes) for i in range(nodes)]
    for i, j in split:
        number["again", i, j] = len(x)
        x.append([float(i), float(j)])
    return np.array(x), number


def squares(cells: Cells, number: dict, upper: Cells = ()) -> Integers:
    """Corners of unit squares at (i, j); those in `upper` use split nodes where there are any."""

    def at(i: int, j: int, again: bool) -> int:
        return number.get(("again", i, j), number[i, j]) if again else number[i, j]

    around = ((0, 0), (1, 0), (1, 1), (0, 1))
    return np.array([[at(i + a, j + b, (i, j) in upper) for a, b in around] for i, j in cells])


def joints(x: Array, cells: Integers, body: list[int], kind: str = "quadrilateral") -> list[Joint]:
    return doubtful_joints(CellFacets(kind, x, cells), np.array(body), connected_parts(cells))


ROW = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)]
ABOVE = ROW[3:]
SPLIT = [(i, 1) for i in range(4)]


def test_shared_nodes_are_no_doubt() -> None:
    x, number = grid(4)
    for body in ([0] * 6, [0, 0, 0, 1, 1, 1], [0, 1, 2, 3, 4, 5]):
        assert joints(x, squares(ROW, number), body) == []


def test_double_nodes_of_a_body_are_found_and_those_of_two_bodies_may_meet() -> None:
    x, number = grid(4, SPLIT)
    cells = squares(ROW, number, ABOVE)
    assert joints(x, cells, [0] * 6) == [Joint("double nodes", (0, 0), False, 4, (0.0, 1.0))]
    assert joints(x, cells, [0, 0, 0, 1, 1, 1]) == []


@pytest.mark.parametrize("gap", [0.0, 1e-9, -1e-9, 1e-3])
def test_what_lies_on_each_other_does_so_up_to_rounding(gap: float) -> None:
    x, number = grid(4, SPLIT)
    x[16:, 1] += gap
    found = joints(x, squares(ROW, number, ABOVE), [0] * 6)
    assert [joint.nodes for joint in found] == ([4] if abs(gap) < 1e-6 else [])


def test_a_crack_has_sides_and_a_tip() -> None:
    x, number = grid(4, SPLIT[:2])
    found = joints(x, squares(ROW, number, ABOVE), [2] * 6)
    assert [(joint.kind, joint.bodies, joint.bonded) for joint in found] == [("double nodes", (2, 2), True)]
    assert found[0].nodes == 2  # the tip is shared
    # Two bodies that are bonded beside it do not meet either.
    (between,) = joints(x, squares(ROW, number, ABOVE), [0, 0, 0, 1, 1, 1])
    assert between.bodies == (0, 1) and between.bonded


@pytest.mark.parametrize("body", [[0, 0], [0, 1]])
def test_cells_that_share_one_node_are_on_a_hinge(body: list[int]) -> None:
    x, number = grid(3)
    assert joints(x, squares([(0, 0), (1, 1)], number), body) == [
        Joint("hinge", (body[0], body[1]), False, 1, (1.0, 1.0))
    ]
    # A third cell beside both joins them.
    assert joints(x, squares([(0, 0), (1, 1), (1, 0)], number), [*body, 2]) == []


def test_a_hinge_between_bodies_that_are_bonded_elsewhere() -> None:
    ring = [(i, j) for i in range(4) for j in range(4) if {i, j} & {0, 3}]
    x, number = grid(5)
    (found,) = joints(x, squares([*ring, (1, 1), (2, 2)], number), [0] * len(ring) + [1, 1])
    assert found == Joint("hinge", (1, 1), True, 1, (2.0, 2.0))


def boxes(path: Path, joint: str, size: float, bodies: int = 1) -> MeshFile:
    """Two boxes on each other, of one body or two, whose joint is "shared", "double" or "edge": shifted to one edge."""
    with gmsh_model.session():
        occ = gmsh.model.occ
        shift = 1.0 if joint == "edge" else 0.0
        made = [(3, occ.addBox(0, 0, 0, 1, 1, 0.5)), (3, occ.addBox(shift, 0, 0.5, 1, 1, 0.5))]
        if joint != "double":
            occ.fragment(made[:1], made[1:])
        occ.synchronize()
        for number in range(bodies):
            members = [tag for place, (_, tag) in enumerate(made) if place % bodies == number]
            gmsh.model.addPhysicalGroup(3, members, name=f"body_{number}")
        for point in gmsh.model.getEntities(0):
            below = gmsh.model.getValue(*point, [])[2] < 0.1
            gmsh.model.mesh.setSize([point], size if below else 0.4)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))
    return MeshFile(file=path)


@pytest.mark.mpi
@pytest.mark.parametrize(("joint", "bodies"), [("shared", 1), ("double", 1), ("double", 2), ("edge", 1), ("edge", 2)])
@pytest.mark.parametrize("size", [0.4, 0.2])
def test_boxes_of_tetrahedra(comm: MPI.Comm, shared_tmp_path: Path, joint: str, bodies: int, size: float) -> None:
    """Also where the two sides of the joint have other facets, and on every rank."""
    if comm.rank == 0:
        boxes(shared_tmp_path / "boxes.msh", joint, size, bodies)
    comm.barrier()
    found = create(comm, MeshFile(file=shared_tmp_path / "boxes.msh"), MeshSizes(1.0, 1.0)).joints
    if joint == "shared" or (joint == "double" and bodies == 2):
        assert found == ()
        return
    (one,) = found
    assert one.kind == {"double": "double nodes", "edge": "hinge"}[joint]
    assert one.bodies == (0, bodies - 1) and not one.bonded
    assert one.nodes > 2 and one.place[2] == pytest.approx(0.5)
    if joint == "edge":
        assert one.place[0] == pytest.approx(1.0)
