"""Contact of bodies with each other and with rigid planes: search, laws from the scene, evaluation, history."""

import piezomat.forms.petsc  # noqa: F401 - before any module that imports PETSc
