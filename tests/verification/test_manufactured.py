"""Manufactured solutions of the coupled problem: orders p + 1 (L2) and p (H1) for displacement and potential.

Exact: w_k = a_k sin(q_k . x + c_k) for each component k, psi included, on the unit square or cube with its
nodes smoothly moved, of a strongly coupled, obliquely poled ceramic. The load that belongs to it is -div P,
P_ij = A_ijkl dw_k/dx_l, in closed form because every second derivative of a sine is that sine.
"""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
import pytest
import ufl
from mpi4py import MPI

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.enthalpy import internal_form, regions, tangent_form
from piezomat.forms.material_library import BUILT_IN
from tests.bulk import DIMENSION, boundary, integral, newton_step, nodes, unit_mesh

pytestmark = pytest.mark.mpi

WAVES = np.array([[1.3, -0.7, 0.9], [-0.8, 1.1, 1.2], [1.0, 0.6, -1.4], [0.9, 1.2, 0.8]])
PHASES = np.array([0.3, 1.1, -0.4, 0.7])
AMPLITUDES = np.array([1.0, -0.8, 0.9, 1.2])


def moduli(law: Array, dim: int) -> Array:
    """A (dim + 1, dim, dim + 1, dim) such that the density is 1/2 A_ijkl w_i,j w_k,l."""
    pairs = ((0, 0), (1, 1), (0, 1)) if dim == 2 else ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
    state = np.zeros((len(law), dim + 1, dim))  # s = state : grad w
    for row, (i, j) in enumerate(pairs):
        state[row, i, j] = state[row, j, i] = 1
    for j in range(dim):
        state[len(pairs) + j, dim, j] = -1
    return np.einsum("rij,rs,skl->ijkl", state, law, state)


def smooth(x: Array) -> Array:
    """Bends the grid lines, the boundary stays where it is."""
    bump = 0.05 * np.prod(np.sin(np.pi * x), axis=1)
    return x + bump[:, None] * np.array([1.0, -0.7, 0.8])[: x.shape[1]]


def errors(comm: MPI.Comm, cell: str, order: int, divisions: int, plane: Any) -> Array:
    """L2 and H1 errors of u and of psi: [[L2 u, H1 u], [L2 psi, H1 psi]]."""
    dim = DIMENSION[cell]
    mesh = unit_mesh(comm, cell, order, divisions, smooth)
    space = fenicsx.lagrange(mesh, order, dim + 1)
    w, v = dolfinx.fem.Function(space), ufl.TestFunction(space)
    material = BUILT_IN["pzt5h"].rotated([1, 2, 0] if dim == 2 else [1, 2, -1.5])
    scale = float(np.sqrt(material.stiffness[2, 2] / material.permittivity[2, 2]))
    cells = np.zeros(mesh.topology.index_map(dim).size_local, np.int32)
    law = regions(mesh, [material], cells, plane, scale)

    scaled = material.constitutive_matrix(dim, plane)
    scaled[-dim:] *= scale
    scaled[:, -dim:] *= scale
    chosen = [*range(dim), 3]
    waves, phases, amplitudes = WAVES[chosen, :dim], PHASES[chosen], AMPLITUDES[chosen]
    source = np.einsum("ijkl,kj,kl,k->ik", moduli(scaled, dim), waves, waves, amplitudes)
    waves, phases = waves.tolist(), phases.tolist()  # UFL takes Python's numbers only

    def exact(x: Any, sine: Any) -> list[Any]:
        return [sine(sum(q[j] * x[j] for j in range(dim)) + c) for q, c in zip(waves, phases, strict=True)]

    points, _ = nodes(space)
    held = np.repeat(boundary(points, dim)[:, None], dim + 1, axis=1)
    values = amplitudes * np.column_stack(exact(points.T, np.sin))
    w.x.array[:] = np.where(held, values, 0).ravel()

    x = ufl.SpatialCoordinate(mesh)
    sines = exact(x, ufl.sin)
    load = sum(float(source[i, k]) * sines[k] * v[i] for i in range(dim + 1) for k in range(dim + 1))
    residual = internal_form(w, law, "small") - load * ufl.dx(degree=2 * order + 2)
    newton_step(w, residual, tangent_form(w, law, "small"), held)

    difference = w - ufl.as_vector([float(a) * s for a, s in zip(amplitudes, sines, strict=True)])
    dx = ufl.dx(degree=2 * order + 3)
    found = []
    for part in (range(dim), [dim]):
        square = sum(difference[i] ** 2 for i in part)
        slope = sum(ufl.grad(difference)[i, j] ** 2 for i in part for j in range(dim))
        found.append([np.sqrt(integral(square * dx, comm)), np.sqrt(integral((square + slope) * dx, comm))])
    return np.array(found)


@pytest.mark.parametrize(
    ("cell", "order", "divisions", "plane"),
    [
        ("triangle", 1, (8, 16), "strain"),
        ("triangle", 2, (6, 12), "stress"),
        ("quadrilateral", 1, (8, 16), "stress"),
        ("quadrilateral", 2, (6, 12), "strain"),
        ("tetrahedron", 1, (6, 12), "strain"),
        ("tetrahedron", 2, (3, 6), "strain"),
        ("hexahedron", 1, (6, 12), "strain"),
        ("hexahedron", 2, (3, 6), "strain"),
    ],
)
def test_errors_fall_at_the_best_order(
    cell: str, order: int, divisions: tuple[int, int], plane: str, comm: MPI.Comm
) -> None:
    coarse, fine = (errors(comm, cell, order, n, plane) for n in divisions)
    rates = np.log2(coarse / fine)
    assert np.all(np.abs(rates - [order + 1, order]) < 0.1), rates
