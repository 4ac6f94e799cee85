"""A law given by its density alone: its forms, energies and response are those of the same law written out."""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
import pytest
import ufl
from mpi4py import MPI

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.constitutive import ConstitutiveLaw, in_space, tensors
from piezomat.forms.enthalpy import internal_form, regions, stored_energies, tangent_form
from piezomat.forms.evaluation import integral
from piezomat.forms.material_library import BUILT_IN
from piezomat.forms.materials import Material
from piezomat.forms.response import CenterResponse
from tests.bulk import DIMENSION, assemble_matrix, assemble_vector, shaken, unit_mesh

pytestmark = pytest.mark.mpi

SCALE = 2000.0  # V
POLED = BUILT_IN["pzt5h"].rotated([1, 2, 0.5])


class ByDensity(ConstitutiveLaw):
    """The linear law of a material as a density in three dimensions."""

    def __init__(self, material: Material) -> None:
        self.material = material

    mean_stiffness = property(lambda self: self.material.mean_stiffness)
    mean_permittivity = property(lambda self: self.material.mean_permittivity)
    poisson_ratio = property(lambda self: self.material.poisson_ratio)

    def numbers(self, dim: int, plane: Any, potential_scale: float | None) -> Array:
        return self.material.numbers(3, "strain", potential_scale)

    def density(self, s: Any, numbers: Any) -> Any:
        return self.material.density(in_space(s), numbers)


class Other(ByDensity):
    """The same as a class of its own, of which another region is."""


def case(comm: MPI.Comm, cell: str, materials: list[Any], kinematics: Any) -> dict[str, Any]:
    """All that is computed from a random state of a mesh of these materials."""
    dim = DIMENSION[cell]
    mesh = unit_mesh(comm, cell, 1, 2, shaken(2, 1))
    space = fenicsx.lagrange(mesh, 1, dim + 1)
    w = dolfinx.fem.Function(space)
    x = space.tabulate_dof_coordinates()
    w.x.array[:] = 1e-2 * np.sin(x @ np.arange(1.0, 13.0).reshape(3, 4))[:, : dim + 1].ravel()
    cells = (fenicsx.original_cells(mesh) % len(materials)).astype(np.int32)
    given = regions(mesh, materials, cells, "strain", SCALE)
    elastic, electric = (integral(dolfinx.fem.form(e)) for e in stored_energies(w, given, kinematics))
    response, field = CenterResponse(w, given, materials, cells, kinematics, "strain", SCALE).evaluate()
    return {
        "regions": len(given),
        "force": assemble_vector(internal_form(w, given, kinematics)).array_r.copy(),
        "tangent": assemble_matrix(tangent_form(w, given, kinematics)).getValuesCSR()[2],
        "energies": [elastic, electric],
        "field": field,
        **response._asdict(),
    }


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_the_density_alone_gives_the_linear_law(cell: str, kinematics: str, comm: MPI.Comm) -> None:
    plain = [POLED, BUILT_IN["pvdf"]]
    wanted = case(comm, cell, plain, kinematics)
    for materials in ([ByDensity(m) for m in plain], [POLED, Other(plain[1])], [ByDensity(POLED), Other(plain[1])]):
        found = case(comm, cell, materials, kinematics)
        assert found.pop("regions") == len({type(m) for m in materials})
        for name, value in found.items():
            size = comm.allreduce(float(np.abs(wanted[name]).max(initial=0.0)), op=MPI.MAX)
            assert size > 0.0
            np.testing.assert_allclose(value, wanted[name], rtol=0.0, atol=1e-12 * size, err_msg=name)


def test_tensors_of_a_state() -> None:
    s = ufl.as_vector([ufl.as_ufl(float(i)) for i in range(1, 10)])
    strain, field = tensors(s)
    values = [[float(strain[i, j]) for j in range(3)] for i in range(3)]
    np.testing.assert_array_equal(values, [[1.0, 3.0, 2.5], [3.0, 2.0, 2.0], [2.5, 2.0, 3.0]])
    assert [float(field[i]) for i in range(3)] == [7.0, 8.0, 9.0]
    flat = in_space(ufl.as_vector([ufl.as_ufl(float(i)) for i in range(1, 6)]))
    assert [float(flat[i]) for i in range(9)] == [1.0, 2.0, 0.0, 0.0, 0.0, 3.0, 4.0, 5.0, 0.0]


def test_what_a_law_says_by_default() -> None:
    law = ByDensity(BUILT_IN["pvdf"])
    assert law.electric and not law.is_linear and not law.has_plane_stress and not law.is_piezoelectric
    assert law.rotated([1, 0, 0]) is law
    assert not ByDensity(BUILT_IN["elastic"]).electric
    assert POLED.is_linear and POLED.has_plane_stress and POLED.is_piezoelectric
