"""Contact integrals: weights, derivatives of whole batches, balance of forces, and an interface form in UFL."""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
import pytest
import ufl
from mpi4py import MPI
from petsc4py import PETSc
from scipy.spatial import cKDTree

from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import CURVED_LINE, facet_kind
from piezomat.forms.contact.integrals import (
    FacetPairs,
    PointForces,
    SlavePoints,
    contact_vectors,
    nodal_points,
    quadrature_points,
)
from piezomat.forms.contact.laws.cohesive import CohesiveLaw
from piezomat.forms.contact.laws.equal_potential import ConductingBonds, EqualPotential
from piezomat.forms.contact.laws.penalty import NormalPenalty
from piezomat.forms.contact.laws.response import Response
from piezomat.meshes.body_mesh import create
from piezomat.meshes.contact.surface import node_coordinates
from piezomat.scene import Scene
from tests.bulk import assemble_matrix, assemble_vector
from tests.derivative import slope
from tests.facets import KINDS, PairBatch, warped_facets

each_kind = pytest.mark.parametrize("name", KINDS)


# --- Weights --------------------------------------------------------------------------------------


def fine_integrals(name: str, facets: Array) -> Array:
    """Integrals (f, n) over facets of their shape functions, by a rule much finer than theirs."""
    kind = facet_kind(name)
    x, w = np.polynomial.legendre.leggauss(12)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    if kind.dim == 1:
        points, weights = x[:, None], w
    else:
        a, b = (axis.ravel() for axis in np.meshgrid(x, x, indexing="ij"))
        points, weights = np.column_stack([a, b]), np.outer(w, w).ravel()
        if kind.simplex:  # the square folded into the triangle
            points, weights = np.column_stack([a, b * (1.0 - a)]), weights * (1.0 - a)
    tangents = [np.einsum("qk,fkd->fqd", kind.shape(points, (i,)), facets) for i in range(kind.dim)]
    if kind.dim == 1:
        stretch = np.linalg.norm(tangents[0], axis=2)
    else:
        stretch = np.linalg.norm(np.cross(tangents[0], tangents[1]), axis=2)
    return np.einsum("fq,q,qk->fk", stretch, weights, kind.shape(points))


def by_facet(points: SlavePoints, facets: int, count: int) -> Array:
    """Weights (facets, count) by facet and place."""
    weights = np.zeros((facets, count))
    weights[points.facet, points.place] = points.weight
    return weights


@each_kind
def test_weights_share_the_area(name: str, rng: np.random.Generator) -> None:
    kind = facet_kind(name)
    for warp, bound in ((0.0, 1e-13), (0.05, 3e-3)):  # the area of a warped facet is no polynomial
        facets = warped_facets(kind, rng, 9, warp) * rng.uniform(0.1, 3.0, (9, 1, 1))
        exact = fine_integrals(name, facets)
        area = exact.sum(axis=1)
        points = quadrature_points(kind, facets)
        np.testing.assert_allclose(np.bincount(points.facet, points.weight), area, rtol=bound)
        np.testing.assert_array_equal(points.area, points.weight)
        nodal = nodal_points(kind, facets)
        share = by_facet(nodal, 9, len(kind.nodes))
        np.testing.assert_allclose(share.sum(axis=1), area, rtol=bound)
        np.testing.assert_array_equal(nodal.area, nodal.weight)
        few = 0.02 if name == "tri6" and warp else 0.0  # corners have next to nothing, which goes to the sides
        np.testing.assert_allclose(share / area[:, None], exact / area[:, None], atol=bound + few)
        assert nodal.weight.min() > 0.0


@each_kind
def test_points_say_where_they_are(name: str, rng: np.random.Generator) -> None:
    kind = facet_kind(name)
    facets = warped_facets(kind, rng, 4)
    for points, xi, first in (
        (quadrature_points(kind, facets), kind.quadrature()[0], 0),
        (nodal_points(kind, facets), kind.nodes, corners_left_out(name)),
    ):
        np.testing.assert_array_equal(points.facet, np.repeat(np.arange(4), len(xi) - first))
        np.testing.assert_array_equal(points.place, np.tile(np.arange(first, len(xi)), 4))
        np.testing.assert_array_equal(points.xi, xi[points.place])
        np.testing.assert_allclose(points.shape, kind.shape(points.xi), atol=1e-15)


def corners_left_out(name: str) -> int:
    """How many nodes of a facet are no points of `node` contact: the integral of N_i is zero at corners of tri6."""
    return 3 if name == "tri6" else 0


def test_weights_of_nodes_are_known() -> None:
    """Simpson's rule on quadratic lines and quads; on quadratic triangles the nodes of the sides carry all."""
    known = {
        "line2": [1 / 2, 1 / 2],
        "line3": [1 / 6, 1 / 6, 2 / 3],
        "tri3": [1 / 6] * 3,
        "tri6": [1 / 6] * 3,
        "quad4": [1 / 4] * 4,
        "quad9": [1 / 36] * 4 + [1 / 9] * 4 + [4 / 9],
    }
    for name, weights in known.items():
        kind = facet_kind(name)
        flat = np.column_stack([kind.nodes, np.zeros(len(kind.nodes))])[None]
        np.testing.assert_allclose(nodal_points(kind, flat).weight, weights, atol=1e-15)


@each_kind
def test_unit_weights_are_shared_by_the_facets_of_a_node(name: str, rng: np.random.Generator) -> None:
    kind, first = facet_kind(name), corners_left_out(name)
    facets = warped_facets(kind, rng, 5)
    shared = rng.integers(1, 7, (5, len(kind.nodes))).astype(float)
    points = nodal_points(kind, facets, shared)
    np.testing.assert_allclose(by_facet(points, 5, len(kind.nodes))[:, first:] * shared[:, first:], 1.0, rtol=1e-15)
    # The area of the nodes is what it is.
    np.testing.assert_array_equal(points.area, nodal_points(kind, facets).weight)


# --- Derivatives ----------------------------------------------------------------------------------


class Batch(PairBatch):
    """A batch with a law, random weights and histories: its enthalpy as a function of all unknowns."""

    def __init__(self, name: str, rng: np.random.Generator, adhesion: bool, electric: bool) -> None:
        super().__init__(name, rng, 40, 0.1, electric)
        count = len(self.gap)
        penalty = rng.uniform(50.0, 100.0, count)
        bond = CohesiveLaw.bilinear(2.0, 0.1, penalty)
        equal = EqualPotential(rng.uniform(1.0, 2.0, count), np.full(count, 0.08), 0.0)
        self.law = NormalPenalty(penalty)
        if adhesion:
            self.law += ConductingBonds((bond, equal)) if electric else bond
        touched, opening = rng.uniform(size=count) < 0.7, rng.uniform(0.0, 0.09, count)
        self.history = np.column_stack([touched, touched * opening])[:, : self.law.history_size]
        self.weight = rng.uniform(0.5, 1.5, count)

    def respond(self, q: Array) -> Response:
        kinematics = [self.project(q).gap, *([self.jump(q)] if self.components > self.dim else [])]
        return self.law.respond(np.column_stack(kinematics), self.history)

    def energy(self, q: Array) -> float:
        return float(self.weight @ self.respond(q).enthalpy)

    def terms(self, q: Array, *, tangent: bool) -> tuple[Array, Array | None]:
        r = self.respond(q)
        pairs = FacetPairs(self.kind, self.project(q), self.slave_shape, self.components, self.potentials(q))
        return contact_vectors(pairs, PointForces(self.weight, r.gradient, r.gradient, r.hessian), tangent=tangent)


@each_kind
@pytest.mark.parametrize(("adhesion", "electric"), [(False, False), (True, False), (True, True)])
def test_vectors_and_matrices_are_derivatives_of_the_energy(
    name: str, adhesion: bool, electric: bool, rng: np.random.Generator
) -> None:
    batch = Batch(name, rng, adhesion, electric)
    q = batch.unknowns
    vectors, matrices = batch.terms(q, tangent=True)
    only_vectors, nothing = batch.terms(q, tangent=False)
    assert nothing is None
    np.testing.assert_allclose(only_vectors, vectors, atol=1e-13)
    for _ in range(3):
        d = rng.uniform(-1.0, 1.0, q.shape)
        work = slope(lambda h, d=d: batch.energy(q + h * d), 1e-5)
        assert work == pytest.approx(float((vectors * d).sum()), rel=1e-7, abs=1e-7)
        turn = np.einsum("mij,mj->mi", matrices, d.reshape(len(d), -1))
        expected = slope(lambda h, d=d: batch.terms(q + h * d, tangent=False)[0], 1e-5).reshape(turn.shape)
        assert np.abs(turn - expected).max() < 1e-7 * np.abs(expected).max()
    assert np.abs(matrices - np.swapaxes(matrices, 1, 2)).max() < 1e-12 * np.abs(matrices).max()


@each_kind
def test_forces_are_balanced(name: str, rng: np.random.Generator) -> None:
    """Each point's forces add up to zero, their moments too, and its charges."""
    batch = Batch(name, rng, True, True)
    q, d = batch.unknowns, batch.dim
    vectors, _ = batch.terms(q, tangent=False)
    force, position = vectors[..., :d], q[..., :d]
    scale = np.abs(vectors).max()
    assert np.abs(vectors.sum(axis=1)).max() < 1e-12 * scale
    moment = np.einsum("mnd,mne->mde", force, position)
    assert np.abs(moment - np.swapaxes(moment, 1, 2)).max() < 1e-12 * scale
    assert np.abs(force[:, : batch.nodes].sum(axis=1)).max() > 0.1


@each_kind
def test_mechanical_forces_act_along_one_line(name: str, rng: np.random.Generator) -> None:
    """Without electricity the slave is pushed along the master's normal, at the point, and it back at the closest."""
    batch = Batch(name, rng, True, False)
    vectors, _ = batch.terms(batch.unknowns, tangent=False)
    p, r = batch.project(batch.unknowns), batch.respond(batch.unknowns)
    push = (batch.weight * r.traction)[:, None] * p.normal
    np.testing.assert_allclose(
        vectors[:, : batch.nodes], batch.slave_shape[:, :, None] * push[:, None], rtol=1e-12, atol=1e-13
    )
    reaction = -batch.kind.shape(p.xi)[:, :, None] * push[:, None]
    np.testing.assert_allclose(vectors[:, batch.nodes :], reaction, rtol=1e-12, atol=1e-13)


# --- An interface form in UFL ---------------------------------------------------------------------

DEPTH, RANGE = 0.01, 0.02
BLOCKS = [(dim, cells, order) for dim in (2, 3) for cells in ("simplex", "tensor") for order in (1, 2)]


class Stack:
    """Two blocks with matching meshes that overlap by DEPTH, and one contact pass from the upper to the lower."""

    def __init__(self, comm: MPI.Comm, dim: int, cells: str, order: int) -> None:
        self.dim = dim
        plan = {"divisions": [[2, 1]] * 2} if dim == 2 else {"divisions": [[2, 2, 1]] * 2, "depth": 0.8}
        scene = Scene(
            geometry={"shape": "stacked_blocks", "height": [0.5, 0.4], "gap": -DEPTH, **plan},
            mesh={"order": order, "cells": cells, "size": 1.0},
            bodies={"lower": "pvdf", "upper": "pvdf"},
            boundaries=[{"on": "bottom", "displacement": [0.0] * dim, "potential": 0.0}],
            contact={
                "pairs": [["upper_contact", "lower_contact"]],
                "passes": 1,
                "normal_penalty": 1e4,
                "electric_penalty": 4e-4,
                "electric_range": RANGE,
            },
        )
        self.bodies = create(comm, scene.geometry, scene.sizes)
        self.model = Model(scene, self.bodies)
        self.contact = interfaces_of(self.model)
        only = self.contact.surface_pairs[0]
        self.upper, self.lower = np.unique(only.slave.nodes), np.unique(only.master.nodes)
        x = self.model.unknowns.coordinates[:, : dim - 1]
        distance, partner = cKDTree(x[self.lower]).query(x[self.upper])
        assert distance.max() < 1e-12
        self.partner = self.lower[partner]  # of each upper node

    def contact_terms(self, values: Array) -> tuple[Array, Array]:
        """Residual and tangent of the contact at nodal values (nodes, c), dense over (upper, partner) nodes."""
        state = self.model.new_vector()
        state.array[:] = values.ravel()
        self.contact.detect(state, 1.0)
        terms = self.contact.evaluate(state, tangent=True)
        assert len(self.contact.surface_pairs[0].master_facet) == len(self.contact.surface_pairs[0].points.weight)
        nodes, c = self.contact.nodes.number[terms.nodes], values.shape[1]
        count = len(values)
        residual, tangent = np.zeros((count, c)), np.zeros((count * c, count * c))
        np.add.at(residual, nodes, terms.vectors)
        places = (nodes[:, :, None] * c + np.arange(c)).reshape(len(nodes), -1)
        np.add.at(tangent, (places[:, :, None], places[:, None, :]), terms.matrices)
        order = np.stack([self.upper, self.partner], axis=1)
        rows = (order[:, :, None] * c + np.arange(c)).ravel()
        return residual.ravel()[rows], tangent[np.ix_(rows, rows)]

    def ufl_terms(self, values: Array) -> tuple[Array, Array]:
        """The same from a UFL form on the upper block's facets, the lower's values carried over node by node."""
        model, d = self.model, self.dim
        c = model.unknowns.block
        space = fenicsx.lagrange(model.mesh, self.bodies.order, 2 * c)
        count = len(values)
        here = np.zeros(count, np.int64)  # node of `space` at each node of the model
        here[fenicsx.dofmap(model.unknowns.space)] = fenicsx.dofmap(space)
        np.testing.assert_allclose(node_coordinates(space)[here], model.unknowns.coordinates, atol=1e-14)
        state = dolfinx.fem.Function(space)
        at = state.x.array.reshape(-1, 2 * c)
        at[here[self.upper], :c] = values[self.upper]
        at[here[self.upper], c:] = values[self.partner]
        facets = np.sort(self.bodies.facets["upper_contact"])
        tags = dolfinx.mesh.meshtags(model.mesh, d - 1, facets, np.ones(len(facets), np.int32))
        order = self.bodies.order
        degree = 2 * order if d == 3 and fenicsx.cell_name(model.mesh) == "tetrahedron" else 2 * order + 1
        degree = 2 * CURVED_LINE - 1 if d == 2 and order == 2 else degree  # the same points, so the same rule
        ds = ufl.Measure("ds", domain=model.mesh, subdomain_data=tags, metadata={"quadrature_degree": degree})(1)
        law = self.contact.surface_pairs[0].law
        constants = *(float(penalty[0]) for penalty in law.penalties), model.potential_scale
        residual, tangent = interface_forms(space, state, d, *constants, ds)
        rows = (here[self.upper][:, None] * 2 * c + np.arange(2 * c)).ravel().astype(PETSc.IntType)
        matrix = assemble_matrix(tangent)
        return assemble_vector(residual).array_r[rows], matrix.getValues(rows, rows)


def interface_forms(
    space: Any, state: Any, d: int, penalty: float, rho: float, scale: float, ds: Any
) -> tuple[Any, Any]:
    """First and second derivative of the interface's enthalpy where the lower surface is flat and the upper keeps to
    the vertical.

    About such a state the gap and the jump are written out to second order in the changes of all unknowns, by hand
    and not with the program's variations.
    """
    change = dolfinx.fem.Function(space)
    c = d + 1

    def part(w: Any, start: int) -> tuple[Any, list[Any], Any]:
        """Normal displacement, tangential displacements, potential."""
        return w[start + d - 1], [w[start + i] for i in range(d - 1)], w[start + d]

    axes = range(d - 1)
    state_gap = -DEPTH + part(state, 0)[0]
    phi_s, phi_m = part(state, 0)[2], part(state, c)[2]
    s_normal, s_tangent, s_phi = part(change, 0)
    m_normal, m_tangent, m_phi = part(change, c)
    r = s_normal - m_normal
    a = [s_tangent[i] - m_tangent[i] for i in axes]
    tilt = [m_normal.dx(i) for i in axes]
    gap = state_gap + r - sum(a[i] * tilt[i] + 0.5 * state_gap * tilt[i] ** 2 for i in axes)
    # Where the closest point goes: tangent(y) . (x_s - x_m(y)) = 0, to first and to second order.
    y1 = [a[i] + state_gap * tilt[i] for i in axes]
    y2 = [
        tilt[i] * r
        + sum(
            m_tangent[k].dx(i) * (a[k] - y1[k]) - m_tangent[i].dx(k) * y1[k] + state_gap * m_normal.dx(i).dx(k) * y1[k]
            for k in axes
        )
        for i in axes
    ]
    there = phi_m + m_phi + sum(phi_m.dx(i) * (y1[i] + y2[i]) + m_phi.dx(i) * y1[i] for i in axes)
    there += sum(0.5 * phi_m.dx(i).dx(k) * y1[i] * y1[k] for i in axes for k in axes)
    jump = scale * (phi_s + s_phi - there)
    z, half = gap / RANGE + 0.5, 0.5 * RANGE
    fading = 1 - z * z * (3 - 2 * z)
    s = ufl.conditional(ufl.lt(state_gap, -half), 1, ufl.conditional(ufl.lt(state_gap, half), fading, 0))
    pressure = ufl.conditional(ufl.lt(state_gap, 0), 0.5 * penalty * gap**2, 0)
    energy = (pressure - 0.5 * rho * s * jump**2) * ds
    first = ufl.derivative(energy, change, ufl.TestFunction(space))
    second = ufl.derivative(first, change, ufl.TrialFunction(space))
    nothing = {change: ufl.as_vector([0.0] * 2 * c)}
    expand = ufl.algorithms.expand_derivatives
    return ufl.replace(expand(first), nothing), ufl.replace(expand(second), nothing)


@pytest.mark.parametrize(("dim", "cells", "order"), BLOCKS)
def test_contact_is_an_interface_form(dim: int, cells: str, order: int, rng: np.random.Generator) -> None:
    """On matching meshes residual and tangent agree with UFL's, entry by entry, pressed, apart and in between."""
    stack = Stack(MPI.COMM_SELF, dim, cells, order)
    c = stack.model.unknowns.block
    upper = stack.upper
    for state in ("reference", "uneven"):
        values = np.zeros((len(stack.model.unknowns.coordinates), c))
        if state == "uneven":
            values[upper, dim - 1] = rng.uniform(-0.5, 2.0, len(upper)) * DEPTH
            values[:, dim] = rng.uniform(-0.03, 0.03, len(values))  # makes electric and mechanical terms of one size
        residual, tangent = stack.contact_terms(values)
        by_ufl, tangent_by_ufl = stack.ufl_terms(values)
        assert np.abs(residual).max() > 0.0
        np.testing.assert_allclose(residual, by_ufl, atol=1e-12 * np.abs(by_ufl).max())
        np.testing.assert_allclose(tangent, tangent_by_ufl, atol=1e-12 * np.abs(tangent_by_ufl).max())
