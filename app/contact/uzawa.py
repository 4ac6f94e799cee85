"""A step of augmentation (Uzawa): the multipliers between two solutions, and the gaps and jumps that are left."""

from __future__ import annotations

import numpy as np

from piezomat.contact.contact_points import ContactPoints
from piezomat.contact.interfaces import Interfaces
from piezomat.forms.arrays import Array
from piezomat.forms.contact.augmentation import electric_share
from piezomat.forms.contact.facets import corner_kind
from piezomat.meshes import parallel


def augment(contact: Interfaces, tolerance: float, potential_range: float) -> Array | None:
    """None if gaps and jumps of the last evaluation are within a tolerance; else a step of Uzawa's is taken.

    The largest changes (2,) of the multipliers' shifts are then returned, of the gap in facet sizes and of the jump in
    the range of the potential (V), as is the tolerance. Collective. Source: forms/contact/augmentation.py.
    """
    after, worst = [], np.zeros(2)
    for p in contact.point_sets:
        rows = p.projected_points
        share, jump = electric_share(p.law[rows], p.response), np.zeros(len(rows)) if p.jump is None else p.jump
        means = np.stack([np.ones(len(rows)), p.q[:, 0], share, share * jump], axis=1)
        new = p.multipliers.augmented(_corner_sums(contact, p, p.points.weight[rows, None] * means))
        size = np.ones(len(p.slave))  # of a facet without points, whose multipliers stay zero
        size[p.points.facet] = p.facet_size
        gap = np.abs(new.gap - p.multipliers.gap) / size[:, None]
        jump = np.abs(new.jump - p.multipliers.jump) / potential_range
        worst = np.maximum(worst, [gap.max(initial=0.0), jump.max(initial=0.0)])
        after.append(new)
    left = parallel.largest(contact.comm, worst)
    if (left <= tolerance).all():
        return None
    for p, new in zip(contact.point_sets, after, strict=True):
        p.set_multipliers(new)
    return left


def _corner_sums(contact: Interfaces, p: ContactPoints, values: Array) -> Array:
    """Sums (f, k, c) at the corners of slave facets, over all facets of all ranks: corner functions times values.

    values (r, c): of the projected points of `p`.
    """
    rows = p.projected_points
    shape = corner_kind(p.slave.kind).shape(p.points.xi[rows])
    corners = p.slave_nodes[:, : shape.shape[1]]
    sums = np.zeros((*corners.shape, values.shape[1]))
    for column in range(values.shape[1]):
        total = contact.new_vector()
        each = np.zeros((*shape.shape, contact.block_size))
        each[..., 0] = shape * values[:, column, None]
        contact.nodes.add(corners[p.points.facet[rows]], each, total)
        sums[..., column] = contact.nodes.gather(total)[corners, 0]
        total.destroy()
    return sums
