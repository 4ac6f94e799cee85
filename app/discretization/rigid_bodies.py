"""Connected parts as rigid bodies: their extents, their rigid-body modes, and which modes no boundary constrains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.discretization.constraints import Constraints
from piezomat.discretization.unknowns import Unknowns
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.meshes import parallel
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.meshes.mesh_entities import cell_volumes

# Least eigenvalue of the fixed displacements' Gram matrix of rigid-body modes, relative to the largest, of a part that
# its boundaries constrain.
CONSTRAINED_TOLERANCE = 1e-8


@dataclass(frozen=True)
class Parts:
    """The connected parts of a mesh (cells that share nodes); the same on all ranks but for `node_part`.

    node_part (local nodes,): part of each node
    volume: of all parts, um3 (2D: um2)
    centre (parts, d), um: centre of gravity
    size (parts,), um: radius of gyration about the centre
    thickness (parts,), um: of a plate or block with the same least second moment of volume
    """

    node_part: Integers
    volume: float
    centre: Array
    size: Array
    thickness: Array

    def __len__(self) -> int:
        return len(self.size)

    def sums(self, unknowns: Unknowns, values: Array) -> Array:
        """Sums (parts, k) over all ranks of values (owned nodes, k). Collective."""
        return _sums(unknowns, self.node_part[: unknowns.owned], values, len(self))


def parts_of(bodies: BodyMesh, unknowns: Unknowns) -> Parts:
    """The connected parts of a mesh with their extents in the undeformed state. Collective."""
    d, count, cell_part = unknowns.dim, len(bodies.part_bodies), bodies.cell_part
    nodes = fenicsx.dofmap(unknowns.space)
    node_part = np.zeros(unknowns.local, np.int64)
    node_part[nodes] = cell_part[: len(nodes), None]
    cells = unknowns.coordinates[nodes[: len(cell_part)]]
    volume = cell_volumes(bodies.mesh)[:, None]
    total = _sums(unknowns, cell_part, volume, count)
    centre = _sums(unknowns, cell_part, volume * cells.mean(axis=1), count) / total
    # Moments of nodes rather than of cells' centres, so that a part of one cell has an extent too.
    arm = cells - centre[cell_part][:, None]
    second = volume * np.einsum("cni,cnj->cij", arm, arm).reshape(len(cell_part), d**2) / cells.shape[1]
    moments = (_sums(unknowns, cell_part, second, count) / total).reshape(-1, d, d)
    principal = np.linalg.eigvalsh(moments)
    return Parts(node_part, float(total.sum()), centre, np.sqrt(principal.sum(axis=1)), np.sqrt(12.0 * principal[:, 0]))


def unconstrained(parts: Parts, unknowns: Unknowns, constraints: Constraints, dielectric_node: Booleans) -> Booleans:
    """Whether nothing constrains the rigid-body modes, and the mean potential, of each part (parts, 2). Collective.

    Boundaries do, and electrodes at a potential; an open electrode constrains the parts that it joins to one that is
    constrained. A part without a permittivity has no potential to constrain.
    """
    d, owned = unknowns.dim, unknowns.owned
    part = parts.node_part[:owned]
    local = (unknowns.coordinates[:owned] - parts.centre[part]) / parts.size[part, None]
    fixed = rigid_modes(local) * constraints.is_fixed[:, :d, None]
    count = fixed.shape[2]
    gram = parts.sums(unknowns, np.einsum("ndr,nds->nrs", fixed, fixed).reshape(owned, count**2))
    eigenvalues = np.linalg.eigvalsh(gram.reshape(len(parts), count, count))
    found: Booleans = np.zeros((len(parts), 2), bool)
    found[:, 0] = eigenvalues[:, 0] < CONSTRAINED_TOLERANCE * np.maximum(eigenvalues[:, -1], 1e-300)
    if unknowns.electric:
        inside = dielectric_node[:owned]
        given = constraints.is_fixed[:, d] & inside
        sums = parts.sums(unknowns, np.column_stack([inside, given]).astype(float))
        constrained = _joined_by_electrodes(parts, unknowns, constraints, sums[:, 1] > 0)
        found[:, 1] = (sums[:, 0] > 0) & ~constrained
    return found


def _joined_by_electrodes(
    parts: Parts, unknowns: Unknowns, constraints: Constraints, constrained: Booleans
) -> Booleans:
    """The parts whose mean potential is constrained, given those (parts,) that boundaries constrain. Collective."""
    electrodes = constraints.equipotentials
    if not electrodes:
        return constrained
    on = np.zeros((unknowns.owned, len(electrodes)))
    for electrode in electrodes:
        on[electrode.nodes, electrode.reference] = 1.0
    touches = parts.sums(unknowns, on) > 0.0
    given = np.array([e.electrode.potential is not None for e in electrodes])
    for _ in range(len(electrodes) + 1):  # a chain of electrodes has as many links
        constrained = constrained | touches[:, given].any(axis=1)
        given = given | touches[constrained].any(axis=0)
    return constrained


def rigid_modes(x: Array) -> Array:
    """Rigid-body modes (n, d, 3 or 6) at points x (n, d): translations, then rotations about the origin."""
    n, d = x.shape
    modes = np.zeros((n, d, 3 if d == 2 else 6))
    for i in range(d):
        modes[:, i, i] = 1.0
    if d == 2:
        modes[:, 0, 2], modes[:, 1, 2] = -x[:, 1], x[:, 0]
    else:
        for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
            modes[:, i, 3 + k], modes[:, j, 3 + k] = -x[:, j], x[:, i]
    return modes


def _sums(unknowns: Unknowns, part: Integers, values: Array, count: int) -> Array:
    return parallel.total(unknowns.comm, np.stack([np.bincount(part, v, count) for v in values.T], axis=1))
