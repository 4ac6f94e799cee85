"""Uniform states are exact for every element, distorted and curved too, at any poling direction."""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
import pytest
import ufl
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.enthalpy import Region, internal_form, regions, tangent_form
from piezomat.forms.loads import Load, boundary_loads
from piezomat.forms.material_library import BUILT_IN
from piezomat.forms.materials import Material
from tests.bulk import (
    DIMENSION,
    assemble_vector,
    boundary,
    facet_measure,
    newton_step,
    nodes,
    shaken,
    unit_mesh,
)

ELEMENTS = [(cell, order) for order in (1, 2) for cell in DIMENSION]
POLINGS = {2: ([0, 1, 0], [2, 1, 0.5]), 3: ([0, 0, 1], [1, 2, -1.5])}


class Block:
    """A distorted unit block of one material under pressure on its two faces across the last axis."""

    def __init__(self, comm: MPI.Comm, cell: str, order: int) -> None:
        self.dim = DIMENSION[cell]
        divisions = 3 if self.dim == 2 else 2
        self.mesh = unit_mesh(comm, cell, order, divisions, shaken(divisions, order))
        self.space = fenicsx.lagrange(self.mesh, order, self.dim + 1)
        self.w = dolfinx.fem.Function(self.space)
        self.law = self.law_of(BUILT_IN["pvdf"], "strain", 1.0)
        self.residual = internal_form(self.w, [self.law], "small")
        self.tangent = tangent_form(self.w, [self.law], "small")
        self.pressure = dolfinx.fem.Constant(self.mesh, 0.0)
        last = self.dim - 1
        ds = facet_measure(self.mesh, [(last, 0.0), (last, 1.0)])
        loads = [Load(tag, pressure=self.pressure) for tag in (0, 1)]
        self.loads = boundary_loads(ufl.TestFunction(self.space), self.w, ds, loads, "small", 1.0)
        self.x, self.owned = nodes(self.space)

    def law_of(self, material: Material, plane: Any, scale: float) -> Region:
        cells = self.mesh.topology.index_map(self.dim).size_local
        return regions(self.mesh, [material], np.zeros(cells, np.int32), plane, scale)[0]

    def fill(self, material: Material, plane: Any) -> tuple[Array, float]:
        """Give all cells a material; its law and the potential's scale."""
        matrix = material.constitutive_matrix(self.dim, plane)
        scale = float(np.sqrt(material.stiffness[2, 2] / material.permittivity[2, 2]))
        self.law.numbers.x.array[:] = self.law_of(material, plane, scale).numbers.x.array
        return matrix, scale

    def linear(self, gradient: Array) -> Array:
        """Nodal values (nodes, dim + 1) of the linear field with that gradient (dim + 1, dim)."""
        return self.x[:, : self.dim] @ gradient.T

    def solve(self, start: Array, fixed: NDArray[np.bool_], residual: Any) -> Array:
        self.w.x.array[:] = start.ravel()
        newton_step(self.w, residual, self.tangent, fixed)
        return self.w.x.array.reshape(-1, self.dim + 1)

    def at(self, *corner: float) -> NDArray[np.bool_]:
        return np.all(np.isclose(self.x[:, : self.dim], corner), axis=1)


def planes(dim: int) -> tuple[str, ...]:
    return ("strain", "stress") if dim == 2 else ("strain",)


@pytest.fixture(scope="module", params=ELEMENTS, ids=lambda element: f"{element[0]}-{element[1]}")
def block(request: pytest.FixtureRequest) -> Block:
    """A block of each kind of cells. Collective."""
    return Block(MPI.COMM_WORLD, *request.param)


@pytest.mark.mpi
def test_patch_with_its_whole_boundary_held(block: Block, rng: np.random.Generator) -> None:
    fixed = np.repeat(boundary(block.x, block.dim)[:, None], block.dim + 1, axis=1)
    for name, poling in (("pvdf", POLINGS[block.dim][0]), ("pzt5h", POLINGS[block.dim][1])):
        for plane in planes(block.dim):
            block.fill(BUILT_IN[name].rotated(poling), plane)
            exact = block.linear(rng.normal(size=(block.dim + 1, block.dim)))
            found = block.solve(np.where(fixed, exact, 0), fixed, block.residual)
            assert np.abs(found - exact).max() < 1e-10


@pytest.mark.mpi
def test_uniform_stress_of_finite_kinematics_is_in_equilibrium_inside(
    block: Block, comm: MPI.Comm, rng: np.random.Generator
) -> None:
    block.fill(BUILT_IN["pzt5h"].rotated(POLINGS[block.dim][1]), "strain")
    block.w.x.array[:] = block.linear(rng.uniform(-0.2, 0.2, (block.dim + 1, block.dim))).ravel()
    force = np.abs(assemble_vector(internal_form(block.w, [block.law], "finite")).array_r.reshape(-1, block.dim + 1))
    inside = force[~boundary(block.x, block.dim)[: block.owned]]
    largest = comm.allreduce(force.max(initial=0), MPI.MAX)
    assert comm.allreduce(inside.max(initial=0), MPI.MAX) < 1e-12 * largest


def expected(law: Array, dim: int, sides: str, circuit: str, scale: float) -> tuple[Array, Array]:
    """State s of the block under T = -1 along the last axis, and the gradient of (u, psi) as it is held."""
    strains = dim * (dim + 1) // 2
    free = list(range(strains)) if sides == "free" else {2: [1, 2], 3: [2, 3, 4]}[dim]
    free = free + (list(range(strains, strains + dim)) if circuit == "open" else [])
    load = np.zeros(strains + dim)
    load[dim - 1] = -1
    state = np.zeros(strains + dim)
    state[free] = np.linalg.solve(law[np.ix_(free, free)], load[free])
    shears = {2: {(0, 1): 2}, 3: {(1, 2): 3, (0, 2): 4, (0, 1): 5}}[dim]
    gradient = np.zeros((dim + 1, dim))
    gradient[range(dim), range(dim)] = state[:dim]
    for (i, j), entry in shears.items():
        # Held at three corners, u_i depends on x_j for j >= i only; held at its sides, only the last u moves.
        gradient[(i, j) if sides == "free" else (j, i)] = state[entry]
    gradient[dim] = -state[strains:] / scale
    return state, gradient


@pytest.mark.mpi
def test_pressed_block(block: Block) -> None:
    """Laterally free or fixed, short or open circuit: the reference's four states, and the same turned."""
    dim, last = block.dim, block.dim - 1
    block.pressure.value = 1.0
    outside = boundary(block.x, block.dim)
    corner = block.at(*[0.0] * dim)
    for poling in POLINGS[dim]:
        for plane in planes(dim):
            law, scale = block.fill(BUILT_IN["pvdf"].rotated(poling), plane)
            for sides in ("free", "fixed"):
                for circuit in ("short", "open"):
                    fixed = np.zeros((len(block.x), dim + 1), bool)
                    fixed[:, dim] = outside if circuit == "short" else corner
                    fixed[corner, :dim] = True
                    if sides == "fixed":
                        fixed[outside, :last] = True
                    else:
                        for axis in range(last):
                            fixed[block.at(*np.eye(dim)[axis]), axis + 1 : dim] = True
                    _, gradient = expected(law, dim, sides, circuit, scale)
                    exact = block.linear(gradient)
                    found = block.solve(np.zeros_like(exact), fixed, block.residual + block.loads)
                    assert np.abs(found - exact).max() < 1e-10 * np.abs(gradient).max(), (
                        poling,
                        sides,
                        circuit,
                    )


@pytest.mark.parametrize(
    ("sides", "circuit", "strain", "field"),
    [
        ("free", "short", [1.2e-4, 1.2e-4, -4e-4], 0.0),
        ("free", "open", [1.1336e-4, 1.1909e-4, -3.9004e-4], -0.3016871),
        ("fixed", "short", [0, 0, -2.971429e-4], 0.0),
        ("fixed", "open", [0, 0, -2.925409e-4], -0.2064990),
    ],
)
def test_expected_states_are_those_of_the_reference(
    sides: str, circuit: str, strain: list[float], field: float
) -> None:
    state, gradient = expected(BUILT_IN["pvdf"].constitutive_matrix(3), 3, sides, circuit, 4850.0)
    np.testing.assert_allclose(state[:3], strain, atol=0.5001e-8)
    np.testing.assert_allclose(state[6:], [0, 0, field], atol=0.5e-7)
    np.testing.assert_allclose(gradient[3] * 4850, [0, 0, -field], atol=0.5e-7)
