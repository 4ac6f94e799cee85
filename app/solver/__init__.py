"""Load steps, Newton's method, linear solvers."""

import piezomat.forms.petsc  # noqa: F401 - before any module that imports PETSc
