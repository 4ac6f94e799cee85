"""Strain and stress of the box of a mat: fibers of a recipe between a floor and a lid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.discretization.model import Model
from piezomat.meshes import parallel

SQUARE = 0.999  # least cosine of a plane's normal and the upright axis


@dataclass(frozen=True)
class Box:
    """Two rigid planes across the upright axis (z, in 2D y), and the fibers' extent across it.

    thickness: distance of the planes at the start, um. area: of the box seen from above, um2 (2D: width, um).
    """

    floor: RigidPlane
    lid: RigidPlane
    thickness: float
    area: float


@dataclass(frozen=True)
class BoxState:
    """Relative change of the thickness, and force of the lid over the area, MPa: both negative under compression."""

    strain: float
    stress: float


def box_of(model: Model, contact: Interfaces | None) -> Box | None:
    """The box of a recipe's fibers between one plane from below and one from above; None of another scene."""
    outcome: Any = model.scene.outcome
    if outcome is None or contact is None:
        return None
    upright = model.dim - 1
    floors = [plane for plane in contact.planes if plane.normal[upright] > SQUARE]
    lids = [plane for plane in contact.planes if plane.normal[upright] < -SQUARE]
    if len(floors) != 1 or len(lids) != 1:
        return None
    thickness = float(lids[0].start[upright] - floors[0].start[upright])
    return Box(floors[0], lids[0], thickness, outcome.area) if thickness > 0.0 else None


def box_state(model: Model, box: Box) -> BoxState:
    """Strain and stress of the box at the last evaluation. Collective."""
    upright = model.dim - 1
    force = parallel.total(model.comm, box.lid.force)
    approach = box.lid.offset[upright] - box.floor.offset[upright]
    return BoxState(float(approach) / box.thickness, float(force[upright]) / box.area)
