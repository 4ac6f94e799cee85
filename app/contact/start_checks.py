"""What contact must not find in the undeformed bodies: deep overlaps, and electrodes that short a circuit."""

from __future__ import annotations

from petsc4py import PETSc

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.short_circuit import check_short_circuit
from piezomat.contact.start_overlap import start_overlap
from piezomat.discretization.model import Model
from piezomat.scene.checks import OVERLAP
from piezomat.scene.errors import SceneError


def check_start(model: Model, contact: Interfaces | None, state: PETSc.Vec) -> None:
    """Raise SceneError where bodies overlap by more than a tenth of their size, or electrodes short a circuit.

    Collective. state: of the undeformed bodies.
    """
    if contact is None:
        return
    size = float(model.parts.thickness.min())
    contact.detect(state, size)
    overlap = start_overlap(model, contact)
    if overlap > OVERLAP * size:
        raise SceneError(
            "geometry",
            f"bodies that overlap by {overlap:.3g} um at the start",
            f"an overlap of at most a tenth of their size ({OVERLAP * size:.3g} um)",
        )
    check_short_circuit(model, contact, dict.fromkeys(model.scene.load.factors, 0.0))
