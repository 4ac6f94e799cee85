"""The discrete model: unknowns, prescribed values, loads."""

import piezomat.forms.petsc  # noqa: F401 - before any module that imports PETSc
