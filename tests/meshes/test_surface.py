"""Contact surfaces of distributed meshes: complete, outward, and numbered alike on any number of ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.integrals import quadrature_points
from piezomat.meshes.body_mesh import BodyMesh, Partition, create
from piezomat.meshes.contact.surface import Surface, body_facets, multiplicity, node_coordinates, surface
from piezomat.meshes.shapes import CrossedFibers, FacingHalves, MeshSizes, Shape, StackedBlocks

pytestmark = pytest.mark.mpi

PLANE = StackedBlocks(height=[0.5, 0.25], divisions=[[4, 2], [3, 1]], distortion=0.2, gap=0.1)
SOLID = StackedBlocks(height=[0.5, 0.25], depth=0.5, divisions=[[3, 2, 2], [2, 1, 1]], distortion=0.2, gap=0.1)
KINDS = [(cells, order) for cells in ("simplex", "tensor") for order in (1, 2)]
BLOCKS = [(shape, cells, order) for shape in (PLANE, SOLID) for cells, order in KINDS]
AREAS = {2: {"lower": 3.0, "upper": 2.5}, 3: {"lower": 2.5, "upper": 1.75}}
each_block = pytest.mark.parametrize(("shape", "cells", "order"), BLOCKS)


def striped(centroids: Array, bodies: NDArray[np.int32], ranks: int) -> NDArray[np.int32]:
    """Cells dealt out in turn: every rank meets every other all over the mesh."""
    return np.arange(len(centroids)) % ranks


def all_on_last(centroids: Array, bodies: NDArray[np.int32], ranks: int) -> NDArray[np.int32]:
    """Ranks but the last have no cells."""
    return np.full(len(centroids), ranks - 1)


class Meshed:
    """A mesh, a blocked space of the mesh's own order and the surface of each body."""

    def __init__(
        self, comm: MPI.Comm, shape: Shape, cells: Any, order: Any, partition: Partition | None = None
    ) -> None:
        self.comm = comm
        self.bodies: BodyMesh = create(comm, shape, MeshSizes(0.3, 0.15, order, cells), partition=partition)
        self.dim = self.bodies.mesh.geometry.dim
        self.space = fenicsx.lagrange(self.bodies.mesh, order, self.dim)
        self.surfaces = {name: self.surface(name) for name in self.bodies.bodies}

    def surface(self, name: str) -> Surface:
        if name in self.bodies.bodies:
            facets = body_facets(self.space, self.bodies.cell_body, self.bodies.bodies.index(name))
        else:
            facets = self.bodies.facets[name]
        return surface(self.space, name, facets, self.bodies.order)

    def total(self, value: float) -> float:
        return self.comm.allreduce(float(value))

    def everywhere(self, values: NDArray) -> NDArray:
        """The rows of all ranks."""
        return np.concatenate(self.comm.allgather(values))


def normals(group: Surface) -> tuple[Array, Array, Array]:
    """Places (m, d), outward normals (m, d) and weights (m,) of the quadrature points."""
    points = quadrature_points(group.kind, group.reference)
    x = np.einsum("mk,mkd->md", points.shape, group.reference[points.facet])
    n = point_normals(group.kind, points.xi, group.reference[points.facet], group.orientation[points.facet])
    return x, n, points.weight


@each_block
def test_node_coordinates(shape: Shape, cells: str, order: int, comm: MPI.Comm) -> None:
    meshed = Meshed(comm, shape, cells, order)
    x = node_coordinates(meshed.space)
    np.testing.assert_allclose(x, meshed.space.tabulate_dof_coordinates()[:, : meshed.dim], atol=1e-14)
    for group in meshed.surfaces.values():
        np.testing.assert_array_equal(group.reference, x[group.nodes])


@each_block
@pytest.mark.parametrize("partition", [None, striped, all_on_last])
def test_surfaces_are_closed_and_outward(
    shape: Shape, cells: str, order: int, partition: Partition | None, comm: MPI.Comm
) -> None:
    """Gauss: the normals add up to zero, x . n to the dimension times the volume; areas are those of the blocks."""
    meshed = Meshed(comm, shape, cells, order, partition)
    volumes = {2: {"lower": 0.5, "upper": 0.25}, 3: {"lower": 0.25, "upper": 0.125}}[meshed.dim]
    for name, group in meshed.surfaces.items():
        x, n, weight = normals(group)
        assert meshed.total(weight.sum()) == pytest.approx(AREAS[meshed.dim][name], rel=1e-12)
        assert np.abs(meshed.comm.allreduce(weight @ n)).max() < 1e-12
        flux = meshed.total(np.einsum("m,md,md->", weight, x, n))
        assert flux == pytest.approx(meshed.dim * volumes[name], rel=1e-12)


@each_block
def test_normals_point_out_of_the_faces(shape: Shape, cells: str, order: int, comm: MPI.Comm) -> None:
    meshed = Meshed(comm, shape, cells, order)
    out = {"left": -np.eye(meshed.dim)[0], "right": np.eye(meshed.dim)[0]}
    out |= {"bottom": -np.eye(meshed.dim)[-1], "top": np.eye(meshed.dim)[-1]}
    out |= {"lower_contact": out["top"], "upper_contact": out["bottom"]}
    for name, expected in out.items():
        _, n, _ = normals(meshed.surface(name))
        np.testing.assert_allclose(n, np.tile(expected, (len(n), 1)), atol=1e-13)
        assert meshed.total(len(n)) > 0


@pytest.mark.parametrize(("cells", "order"), KINDS)
@pytest.mark.parametrize("shape", [FacingHalves(gap=0.05), CrossedFibers(length=1.0, gap=0.05)])
def test_curved_surfaces_are_outward(shape: Shape, cells: str, order: int, comm: MPI.Comm) -> None:
    """The sides of fibers that meet: normals away from their axes, within what their facets make of the circle."""
    meshed = Meshed(comm, shape, cells, order)
    for name, height in (("lower", -0.525), ("upper", 0.525)):
        x, n, _ = normals(meshed.surface(f"{name}_contact"))
        center = np.zeros_like(x)
        center[:, -1] = height
        if meshed.dim == 3:
            along = 0 if name == "lower" else 1
            center[:, along] = x[:, along]
        radial = (x - center) / np.linalg.norm(x - center, axis=1)[:, None]
        assert np.einsum("md,md->m", radial, n).min(initial=1.0) > 0.9
        assert meshed.total(len(n)) > 0


@each_block
def test_counts_of_facets(shape: Shape, cells: str, order: int, comm: MPI.Comm) -> None:
    meshed = Meshed(comm, shape, cells, order, striped)
    split = 2 if cells == "simplex" and meshed.dim == 3 else 1
    counts = {2: {"lower": 12, "upper": 8}, 3: {"lower": 32 * split, "upper": 10 * split}}[meshed.dim]
    for name, group in meshed.surfaces.items():
        assert meshed.total(len(group)) == counts[name]
        body = meshed.bodies.bodies.index(name)
        assert (meshed.bodies.cell_body[group.cells] == body).all()
        assert group.nodes.shape == group.reference.shape[:2] == (len(group), len(group.kind.nodes))
        assert np.isin(group.orientation, (-1.0, 1.0)).all()


def facets_by_key(meshed: Meshed, name: str) -> tuple[NDArray[np.int64], Array]:
    """Keys of a surface on all ranks, sorted, and the coordinates of the facets' nodes in that order."""
    group = meshed.surfaces[name]
    keys, x = meshed.everywhere(group.key), meshed.everywhere(group.reference)
    order = np.argsort(keys)
    return keys[order], x[order]


@each_block
def test_keys_do_not_depend_on_the_partition(shape: Shape, cells: str, order: int, comm: MPI.Comm) -> None:
    """One key a facet over all bodies, the same for the same facet however the cells are dealt out."""
    alone = Meshed(MPI.COMM_SELF, shape, cells, order)
    for partition in (None, striped, all_on_last):
        meshed = Meshed(comm, shape, cells, order, partition)
        every = np.concatenate([meshed.everywhere(group.key) for group in meshed.surfaces.values()])
        assert len(np.unique(every)) == len(every)
        for name in meshed.surfaces:
            (keys, x), (keys_alone, x_alone) = facets_by_key(meshed, name), facets_by_key(alone, name)
            np.testing.assert_array_equal(keys, keys_alone)
            np.testing.assert_allclose(x, x_alone, atol=1e-14)


@each_block
def test_a_surface_keeps_the_order_of_its_facets(shape: Shape, cells: str, order: int, comm: MPI.Comm) -> None:
    """A surface of chosen facets holds these, one after the other."""
    meshed = Meshed(comm, shape, cells, order)
    facets = body_facets(meshed.space, meshed.bodies.cell_body, 0)
    whole, backwards = meshed.surfaces["lower"], surface(meshed.space, "lower", facets[::-1].copy(), order)
    for field in ("nodes", "reference", "orientation", "key", "cells"):
        np.testing.assert_array_equal(getattr(backwards, field), getattr(whole, field)[::-1])


@each_block
@pytest.mark.parametrize("partition", [None, striped])
def test_multiplicity_counts_the_facets_of_all_ranks(
    shape: Shape, cells: str, order: int, partition: Partition | None, comm: MPI.Comm
) -> None:
    meshed = Meshed(comm, shape, cells, order, partition)
    for group in meshed.surfaces.values():
        found = multiplicity(meshed.space, group)
        assert found.shape == group.nodes.shape
        places = np.rint(meshed.everywhere(group.reference.reshape(-1, meshed.dim)) * 1e9).astype(np.int64)
        _, inverse, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
        expected = count[inverse.ravel()].astype(float)
        np.testing.assert_array_equal(meshed.everywhere(found.ravel()), expected)
        # Every node is counted once in all.
        assert meshed.total((1.0 / found).sum()) == pytest.approx(len(count), rel=1e-12)
