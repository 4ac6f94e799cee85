"""The methods of contact that scripts/stability compares: a panel of each picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from piezomat.scene import Scene
from tests.verification import references as ref

STIFFNESS = float(ref.PVDF.stiffness[2, 2])  # nearly the stiffness that contact.normal_penalty_factor multiplies
QUIET = {"fields": "none", "picture": False}


@dataclass(frozen=True)
class Method:
    """A method: contact keys, order and kinematics; `plus` flips the sign of the electric term, as printed."""

    name: str
    contact: dict[str, Any]
    order: int = 1
    kinematics: str = "small"
    plus: bool = False

    def scene(self, **sections: Any) -> Scene:
        """A scene with this method; `contact` and `mesh` are added to its own."""
        contact, mesh = {**self.contact, **sections.pop("contact", {})}, sections.pop("mesh", {})
        if contact.get("nodal_weight") == "unit" and "normal_penalty_factor" in contact:
            # One spring per node has no area: with the factor times the stiffness it equals the others on a facet.
            contact["normal_penalty"] = contact.pop("normal_penalty_factor") * STIFFNESS
        return Scene(
            **{
                "mesh": {"order": self.order, **mesh},
                "model": {"kinematics": self.kinematics},
                "contact": contact,
                "output": QUIET,
                "solver": {"max_cutbacks": 4},
                **sections,
            }
        )


METHODS = [
    Method("paper", {"method": "node", "passes": 1, "nodal_weight": "unit"}, plus=True),
    Method("node", {"method": "node", "passes": 1}),
    Method("point", {"method": "point"}),
    Method("segment", {"method": "segment"}),
    Method("point, order 2", {"method": "point"}, order=2),
    Method("segment, order 2", {"method": "segment"}, order=2),
    Method("point, smoothed", {"method": "point", "smoothing": True}),
    Method("segment, smoothed", {"method": "segment", "smoothing": True}),
    Method("point, finite", {"method": "point"}, kinematics="finite"),
    Method("segment, finite", {"method": "segment"}, kinematics="finite"),
]
