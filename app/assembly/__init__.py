"""Residual and tangent of everything."""

import piezomat.forms.petsc  # noqa: F401 - before any module that imports PETSc
