"""A sum of laws is a law: energies, gradients and Hessians add up, and each law has its own history."""

from __future__ import annotations

import numpy as np

from piezomat.forms.contact.laws.cohesive import CohesiveLaw
from piezomat.forms.contact.laws.penalty import NormalPenalty
from piezomat.forms.contact.laws.viscous import ViscousBonds
from tests.forms.test_contact_laws import ENERGY, FINAL, PENALTY, STRENGTH


def test_a_sum_of_laws_is_a_law(rng: np.random.Generator) -> None:
    """Energies, gradients and Hessians add up; each law has its own columns of the history."""
    n = 200
    penalty = np.full(n, PENALTY)
    bonds = CohesiveLaw.bilinear(STRENGTH, ENERGY, penalty), CohesiveLaw.cutoff(2.0 * STRENGTH, ENERGY, penalty, True)
    laws = NormalPenalty(penalty), *bonds, ViscousBonds(rng.uniform(size=n), rng.uniform(size=n))
    law = laws[0] + (laws[1] + laws[2]) + laws[3]
    assert list(law.summands()) == list(laws) and law.history_size == 4 and law.softens and not law.has_charges
    gaps, q = rng.uniform(-0.01, 2.0 * FINAL, (3, n, 1)), rng.uniform(-0.01, FINAL, (n, 1))
    history, own = law.virgin(n), [part.virgin(n) for part in laws]
    for gap in gaps:
        history = law.committed(gap, history)
        own = [part.committed(gap, before) for part, before in zip(laws, own, strict=True)]
    np.testing.assert_array_equal(history, np.hstack(own))
    whole = law.respond(q, history)
    parts = [part.respond(q, each) for part, each in zip(laws, own, strict=True)]
    np.testing.assert_allclose(whole.gradient, sum(part.gradient for part in parts), rtol=1e-14)
    np.testing.assert_allclose(whole.hessian, sum(part.hessian for part in parts), rtol=1e-14)
    np.testing.assert_allclose(whole.enthalpy, sum(part.enthalpy for part in parts), rtol=1e-13)
    each = [part.bonded(before) for part, before in zip(laws, own, strict=True)]
    np.testing.assert_array_equal(law.bonded(history), each[1] | each[2])
    assert law.bonded(history).any() and not law.bonded(law.on_loss_of_contact(history)).any()
