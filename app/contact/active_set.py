"""Active-set predictor: the contact law evaluated at the gaps and jumps that a Newton step predicts.

Contact laws have sharp bends, gaps have not: a Newton step along the law's tangent closes points that should have
opened, and the next step corrects a few of them. Here the gaps and jumps alone are linearized. The law responds at the
predicted ones, and the step is solved for again with this response until both agree: Newton's method within a step, on
the nodes that may touch (a semismooth one; with a penalty that of the primal-dual active set, Hintermueller, Ito and
Kunisch, SIAM J. Optim. 13 (2003) 865-888).
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from piezomat.contact.interfaces import Interfaces
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel


def predict(contact: Interfaces, change: PETSc.Vec) -> Array:
    """Let contact respond from now on as after this change of the state of its last evaluation. Collective.

    Norms (2,) of the forces and charges that the last response, linearized, misses; not numbers where facets have
    collapsed, infinite where a change is wild.
    """
    nodal, sums = contact.nodes.gather(change), np.zeros(2)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for p in contact.point_sets:
                sums += p.predict(contact.state, nodal)
    except np.linalg.LinAlgError:
        sums[:] = np.nan
    return np.sqrt(parallel.total(contact.comm, sums))


def end_prediction(contact: Interfaces) -> None:
    """Let contact respond at the states that are evaluated again."""
    for p in contact.point_sets:
        p.end_prediction()
