"""Evaluation of forms: integrals over the mesh, expressions at the centres of cells."""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
from mpi4py import MPI

from piezomat.forms import fenicsx


def integral(form: Any) -> float:
    """Value of a compiled functional, summed over the ranks. Collective."""
    return form.mesh.comm.allreduce(dolfinx.fem.assemble_scalar(form), op=MPI.SUM)


def center_expression(value: Any, mesh: Any) -> Any:
    """UFL vector compiled for `fenicsx.at_centers`, the evaluation at the centre of every cell. Collective."""
    dim = mesh.topology.dim
    simplex = fenicsx.cell_name(mesh) in ("triangle", "tetrahedron")
    center = np.full((1, dim), 1.0 / (dim + 1) if simplex else 0.5)
    return dolfinx.fem.Expression(value, center)
