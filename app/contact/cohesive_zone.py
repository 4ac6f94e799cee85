"""How many facets resolve the zone in which bonds soften: too few, and forces come in steps of a facet."""

from __future__ import annotations

import numpy as np

from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.meshes import parallel

# Facets that the zone should have. With 1.8 the pull-off of two crossed fibers was 7.5 % off, and took twice the Newton
# iterations.
LEAST = 3.0


def coarse_cohesive_zone(model: Model, contact: Interfaces | None) -> str | None:
    """A warning where bonds soften within fewer than three facets, or None. Collective.

    The zone is E* G / s^2 long, with the energy G and the strength s of the bonds and the contact modulus E* of the two
    softest bodies; the facets are the smallest ones.
    """
    keys = model.scene.contact.adhesion if model.scene.contact is not None else None
    if keys is None or contact is None:
        return None
    energy = keys.energy if keys.energy is not None else keys.strength * keys.range
    moduli = sorted(_plane_strain_modulus(law.mean_stiffness, law.poisson_ratio) for law in model.materials)
    first, second = (moduli * 2)[:2]
    length = energy / keys.strength**2 / (1.0 / first + 1.0 / second)
    mine = min((float(p.facet_size.min(initial=np.inf)) for p in contact.surface_pairs), default=np.inf)
    facet = float(parallel.least(model.comm, np.array([mine]))[0])
    if not facet < np.inf or length >= LEAST * facet:
        return None
    return (
        f"bonds soften within {length:.2g} um (E* energy / strength^2), which is {length / facet:.1f} facets: "
        f"take mesh.contact_size = {length / LEAST:.1g} or less, or a smaller strength"
    )


def _plane_strain_modulus(stiffness: float, ratio: float) -> float:
    """E / (1 - nu^2) of a material with this stiffness at uniaxial strain."""
    return stiffness * (1.0 - 2.0 * ratio) / (1.0 - ratio) ** 2
