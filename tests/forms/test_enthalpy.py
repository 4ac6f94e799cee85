"""Bulk forms: each is the derivative of the enthalpy, its limits, its loads and their signs."""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
import pytest
import ufl
from mpi4py import MPI

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.enthalpy import enthalpy, internal_form, regions, tangent_form, volume_measure
from piezomat.forms.kinematics import strain_and_field
from piezomat.forms.loads import Load, boundary_loads, load_tangent
from piezomat.forms.material_library import BUILT_IN
from tests.bulk import (
    DIMENSION,
    assemble_matrix,
    assemble_vector,
    facet_measure,
    newton_step,
    nodes,
    owned,
    shaken,
    unit_mesh,
    wavy,
)
from tests.derivative import slope

pytestmark = pytest.mark.mpi

SCALE = 2000.0  # V, about sqrt(C33 / eps33) um of the ceramics


class Body:
    """A distorted unit square or cube of one or two materials."""

    def __init__(
        self,
        comm: MPI.Comm,
        cell: str,
        order: int,
        kinematics: Any,
        names: tuple[str, ...] = ("pzt5h", "batio3"),
        electric: bool = True,
    ) -> None:
        self.comm, self.kinematics = comm, kinematics
        self.dim = DIMENSION[cell]
        self.mesh = unit_mesh(comm, cell, order, 2, shaken(2, order))
        self.space = fenicsx.lagrange(self.mesh, order, self.dim + electric)
        self.w = dolfinx.fem.Function(self.space)
        materials = [BUILT_IN[name].rotated([1, 2, 0.5]) for name in names]
        cells = fenicsx.original_cells(self.mesh) % len(materials)
        self.scale = SCALE if electric else None
        self.law = regions(self.mesh, materials, cells.astype(np.int32), "strain", self.scale)
        self.residual = internal_form(self.w, self.law, kinematics)
        self.density = dolfinx.fem.form(enthalpy(self.w, self.law, kinematics))

    def set(self, values: Array) -> None:
        self.w.x.array[:] = values

    def energy(self, values: Array) -> float:
        self.set(values)
        return self.comm.allreduce(dolfinx.fem.assemble_scalar(self.density))

    def force(self, values: Array, form: Any = None) -> Array:
        """Owned entries of a residual (the internal one) at a state."""
        self.set(values)
        return assemble_vector(self.residual if form is None else form).array_r.copy()

    def dot(self, a: Array, b: Array) -> float:
        return self.comm.allreduce(float(a @ b))

    def norm(self, a: Array) -> float:
        return self.dot(a, a) ** 0.5

    def times(self, form: Any, values: Array, direction: Any) -> Array:
        """Owned entries of the matrix of `form` at a state times a direction."""
        self.set(values)
        matrix = assemble_matrix(form)
        x, y = matrix.createVecs()
        x.setArray(owned(direction))
        matrix.mult(x, y)
        return y.array_r.copy()


BODIES = [
    ("triangle", 1, False),
    ("triangle", 2, True),
    ("quadrilateral", 2, True),
    ("tetrahedron", 1, True),
    ("hexahedron", 1, True),
]


@pytest.mark.parametrize(("cell", "order", "electric"), BODIES)
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_residual_and_tangent_are_derivatives(
    cell: str, order: int, electric: bool, kinematics: str, comm: MPI.Comm, rng: np.random.Generator
) -> None:
    names = ("pzt5h", "batio3") if electric else ("elastic",)
    body = Body(comm, cell, order, kinematics, names, electric)
    state = wavy(body.space, rng, 0.1).x.array.copy()
    direction = wavy(body.space, rng, 1.0)
    d = direction.x.array
    work = body.dot(body.force(state), owned(direction))
    assert slope(lambda h: body.energy(state + h * d), 0.02) == pytest.approx(work, rel=1e-9)
    turn = body.times(tangent_form(body.w, body.law, kinematics), state, direction)
    differences = slope(lambda h: body.force(state + h * d), 0.02)
    assert body.norm(turn - differences) < 1e-10 * body.norm(turn)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_tangent_is_symmetric(kinematics: str, comm: MPI.Comm, rng: np.random.Generator) -> None:
    body = Body(comm, "tetrahedron", 1, kinematics)
    body.set(wavy(body.space, rng, 0.1).x.array)
    matrix = assemble_matrix(tangent_form(body.w, body.law, kinematics))
    size = matrix.norm()
    matrix.axpy(-1.0, matrix.copy().transpose())
    assert matrix.norm() < 1e-13 * size


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_finite_kinematics_starts_as_small(cell: str, comm: MPI.Comm, rng: np.random.Generator) -> None:
    small, finite = Body(comm, cell, 1, "small"), Body(comm, cell, 1, "finite")
    state = wavy(small.space, rng, 1.0).x.array
    distance = []
    for amplitude in (1e-3, 1e-5):
        expected = small.force(amplitude * state)
        distance.append(small.norm(finite.force(amplitude * state) - expected) / small.norm(expected))
    assert distance[0] < 1e-2
    assert distance[1] == pytest.approx(distance[0] / 100, rel=0.02)


@pytest.mark.parametrize(("cell", "order"), [("quadrilateral", 2), ("tetrahedron", 1)])
def test_finite_kinematics_knows_no_rotation(cell: str, order: int, comm: MPI.Comm, rng: np.random.Generator) -> None:
    body = Body(comm, cell, order, "finite")
    dim = body.dim
    x = nodes(body.space)[0][:, :dim]
    rotation, _ = np.linalg.qr(rng.normal(size=(dim, dim)))
    if np.linalg.det(rotation) < 0:
        rotation[0] *= -1
    state = wavy(body.space, rng, 0.05).x.array.copy().reshape(-1, dim + 1)
    turned = state.copy()
    turned[:, :dim] = (x + state[:, :dim]) @ rotation.T - x + np.arange(dim)
    assert body.energy(turned.ravel()) == pytest.approx(body.energy(state.ravel()), rel=1e-11)
    forces = body.force(turned.ravel()).reshape(-1, dim + 1)
    expected = body.force(state.ravel()).reshape(-1, dim + 1)
    expected[:, :dim] = expected[:, :dim] @ rotation.T
    np.testing.assert_allclose(forces, expected, atol=1e-11 * np.abs(expected).max(initial=1))
    rigid = np.zeros_like(state)
    rigid[:, :dim] = x @ rotation.T - x
    assert body.norm(body.force(rigid.ravel())) < 1e-13 * body.norm(
        Body(comm, cell, order, "small").force(rigid.ravel())
    )


@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_strain_and_field_of_a_linear_state(
    kinematics: str, cell: str, comm: MPI.Comm, rng: np.random.Generator
) -> None:
    body = Body(comm, cell, 1, kinematics)
    dim = body.dim
    gradient = rng.normal(size=(dim + 1, dim))
    body.set((nodes(body.space)[0][:, :dim] @ gradient.T).ravel())
    s = strain_and_field(body.w, kinematics)
    cells = ufl.TestFunction(fenicsx.piecewise_constant(body.mesh, len(s)))
    integrals = assemble_vector(ufl.inner(s, cells) * volume_measure(body.w)).array_r
    found = comm.allreduce(integrals.reshape(-1, len(s)).sum(0))
    strain = gradient[:dim] + gradient[:dim].T
    if kinematics == "finite":
        strain = strain + gradient[:dim].T @ gradient[:dim]
    pairs = ((0, 0), (1, 1), (0, 1)) if dim == 2 else ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
    expected = [strain[i, j] * (0.5 if i == j else 1.0) for i, j in pairs]
    np.testing.assert_allclose(found, [*expected, *-gradient[dim]], atol=1e-12)


def test_law_field_holds_the_scaled_upper_triangle_of_each_cell(comm: MPI.Comm) -> None:
    for cell, size in (("quadrilateral", 5), ("tetrahedron", 9)):
        mesh = unit_mesh(comm, cell, 1, 3)
        dim = DIMENSION[cell]
        materials = [BUILT_IN[name].rotated([1, 2, 3]) for name in ("pzt4", "elastic", "pvdf")]
        laws = [material.constitutive_matrix(dim) for material in materials]
        cells = (fenicsx.original_cells(mesh) % 3).astype(np.int32)
        ones = np.ones(size)
        ones[-dim:] = 7.0
        for scale, kept in ((7.0, size), (None, size - dim)):
            law = regions(mesh, materials, cells, "strain", scale)[0].numbers
            assert law.function_space.dofmap.index_map_bs == kept * (kept + 1) // 2
            entries = law.x.array.reshape(-1, kept * (kept + 1) // 2)[fenicsx.dofmap(law.function_space)[:, 0]]
            weights = (ones if scale else ones * 0 + 1)[:kept]
            for cell_entries, number in zip(entries, cells, strict=True):
                matrix = laws[number][:kept, :kept] * np.outer(weights, weights)
                np.testing.assert_allclose(cell_entries, matrix[np.triu_indices(kept)], rtol=1e-14)


def test_what_does_not_fit_is_refused(comm: MPI.Comm) -> None:
    body = Body(comm, "triangle", 1, "small")
    cells = np.zeros(len(body.law[0].numbers.x.array) // 15, np.int32)
    elastic = regions(body.mesh, [BUILT_IN["elastic"]], cells, "strain", None)
    with pytest.raises(ValueError, match="a matrix of 6 entries does not fit a state of 5 components"):
        enthalpy(body.w, elastic, "small")
    with pytest.raises(ValueError, match='kinematics must be "small" or "finite", not "large"'):
        internal_form(body.w, body.law, "large")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the unknown must have 2 or 3 components"):
        strain_and_field(dolfinx.fem.Function(fenicsx.lagrange(body.mesh, 1, 4)), "small")
    w = dolfinx.fem.Function(fenicsx.lagrange(body.mesh, 1, 2))
    charge = Load(0, charge_density=dolfinx.fem.Constant(body.mesh, 1.0))
    with pytest.raises(ValueError, match="needs a potential"):
        boundary_loads(ufl.TestFunction(w.function_space), w, ufl.ds, [charge], "small", None)


@pytest.mark.parametrize(
    ("cell", "order", "degree"),
    [
        ("triangle", 1, 0),
        ("triangle", 2, 2),
        ("tetrahedron", 1, 0),
        ("tetrahedron", 2, 3),
        ("hexahedron", 1, 2),
    ],
)
def test_quadrature_is_no_finer_than_it_must_be(cell: str, order: int, degree: int, comm: MPI.Comm) -> None:
    mesh = unit_mesh(comm, cell, order, 2)
    w = dolfinx.fem.Function(fenicsx.lagrange(mesh, order, 1))
    assert volume_measure(w).metadata()["quadrature_degree"] == degree


class Pressed(Body):
    """A dielectric under pressure all round (tags 0, 1: bottom and top), traction and charge on top."""

    def __init__(self, comm: MPI.Comm, cell: str, order: int, kinematics: Any) -> None:
        super().__init__(comm, cell, order, kinematics, ("dielectric",))
        dim, mesh = self.dim, self.mesh
        places = [(axis, end) for axis in reversed(range(dim)) for end in (0.0, 1.0)]
        self.ds = facet_measure(mesh, places)
        self.pressure = dolfinx.fem.Constant(mesh, 0.0)
        self.traction = dolfinx.fem.Constant(mesh, np.zeros(dim))
        self.charge = dolfinx.fem.Constant(mesh, 0.0)
        loads = [Load(tag, pressure=self.pressure) for tag in range(len(places))]
        loads[1] = Load(1, self.traction, self.pressure, self.charge)
        self.v = ufl.TestFunction(self.space)
        self.loads = boundary_loads(self.v, self.w, self.ds, loads, kinematics, SCALE)

    def total(self, forces: Array) -> Array:
        """Sum of each component over all nodes."""
        return self.comm.allreduce(forces.reshape(-1, self.dim + 1).sum(axis=0))


@pytest.mark.parametrize(
    ("cell", "order"), [("triangle", 2), ("quadrilateral", 1), ("tetrahedron", 2), ("hexahedron", 1)]
)
def test_pressure_follows_the_surface(cell: str, order: int, comm: MPI.Comm, rng: np.random.Generator) -> None:
    """The work of a pressure all round is p times the loss of current volume."""
    body = Pressed(comm, cell, order, "finite")
    body.pressure.value = 3.0
    state = wavy(body.space, rng, 0.1).x.array.copy()
    direction = wavy(body.space, rng, 1.0)
    gradient = ufl.grad(body.w)
    deformed = ufl.Identity(body.dim) + ufl.as_matrix(
        [[gradient[i, j] for j in range(body.dim)] for i in range(body.dim)]
    )
    volume = dolfinx.fem.form(ufl.det(deformed) * ufl.dx(degree=3 * order))

    def size(h: float) -> float:
        body.set(state + h * direction.x.array)
        return comm.allreduce(dolfinx.fem.assemble_scalar(volume))

    work = body.dot(body.force(state, body.loads), owned(direction))
    assert work == pytest.approx(3.0 * slope(size, 0.02), rel=1e-9)
    tangent = load_tangent(body.loads, body.w)
    turn = body.times(tangent, state, direction)
    differences = slope(lambda h: body.force(state + h * direction.x.array, body.loads), 0.02)
    assert body.norm(turn - differences) < 1e-10 * body.norm(turn)


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_dead_loads_have_their_resultants(cell: str, comm: MPI.Comm, rng: np.random.Generator) -> None:
    body = Pressed(comm, cell, 1, "small")
    dim = body.dim
    assert load_tangent(body.loads, body.w) is None
    assert boundary_loads(body.v, body.w, body.ds, [Load(1)], "small", SCALE).empty()
    state = wavy(body.space, rng, 0.1).x.array.copy()
    body.pressure.value = 2.0
    np.testing.assert_allclose(body.total(body.force(state, body.loads)), 0, atol=1e-13)
    body.pressure.value = 0.0
    body.traction.value = np.arange(1.0, dim + 1)
    body.charge.value = 0.25
    np.testing.assert_allclose(
        body.total(body.force(state, body.loads)), [*-np.arange(1.0, dim + 1), 0.25 * SCALE], rtol=1e-13
    )
    top = boundary_loads(body.v, body.w, body.ds, [Load(1, pressure=body.pressure)], "small", SCALE)
    body.pressure.value = 2.0  # pushes down: the force -2 along the last axis, as a residual +2
    np.testing.assert_allclose(body.total(body.force(state, top)), [0] * (dim - 1) + [2.0, 0], atol=1e-13)


def test_charge_on_a_capacitor(comm: MPI.Comm) -> None:
    """Free charge q on the top plate, bottom earthed: phi = q h / eps on top and -q on the bottom."""
    body = Pressed(comm, "quadrilateral", 2, "small")
    body.charge.value = 2e-5
    x, count = nodes(body.space)
    fixed = np.ones((len(x), 3), bool)
    fixed[:, 2] = np.isclose(x[:, 1], 0)
    newton_step(body.w, body.residual + body.loads, tangent_form(body.w, body.law, "small"), fixed)
    eps = BUILT_IN["dielectric"].permittivity[1, 1]
    np.testing.assert_allclose(body.w.x.array.reshape(-1, 3)[:, 2] * SCALE, 2e-5 / eps * x[:, 1], atol=1e-12)
    internal = assemble_vector(body.residual).array_r.reshape(-1, 3)[:, 2]
    bottom = comm.allreduce(internal[np.isclose(x[:count, 1], 0)].sum())
    assert -bottom / SCALE == pytest.approx(-2e-5, rel=1e-10)


def test_one_compiled_form_serves_all_materials_and_loads(comm: MPI.Comm) -> None:
    bodies = [Body(comm, "triangle", 1, "small", (name,)) for name in ("pvdf", "pzt4")]
    assert bodies[0].residual.signature() == bodies[1].residual.signature()
    presses = [Pressed(comm, "triangle", 1, "finite") for _ in bodies]
    presses[0].pressure.value = 5.0
    assert presses[0].loads.signature() == presses[1].loads.signature()
