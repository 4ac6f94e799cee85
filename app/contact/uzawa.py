"""A step of augmentation (Uzawa): the multipliers between two solutions, and the gaps and jumps that are left."""

from __future__ import annotations

import numpy as np

from piezomat.contact.interfaces import Interfaces
from piezomat.forms.arrays import Array
from piezomat.forms.contact.augmentation import electric_share
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
        means = np.stack([np.ones(len(rows)), p.projection.gap, share, share * jump], axis=1)
        new = p.multipliers.augmented(contact.corner_sums(p, p.points.weight[rows, None] * means))
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
