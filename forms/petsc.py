"""PETSc, started without the option files `petscrc` and `.petscrc` of the working folder and the home.

Leftovers in them would change results unseen, and a folder from a stranger could make PETSc run and write things. The
variable PETSC_OPTIONS, which is the user's own, counts; the log of a run names it. Whoever has started PETSc before
keeps what they have. Packages that use PETSc import this first.
"""

import petsc4py

petsc4py.init(["piezomat", "-skip_petscrc"])
