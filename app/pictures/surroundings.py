"""What surrounds the bodies in a picture: rigid planes, electrodes and ground, the direction of poling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.material_library import BUILT_IN
from piezomat.pictures.data import Bodies, RunData
from piezomat.scene.data import key_of
from piezomat.scene.sections import SIDES

GROUND, ELECTRODE, INSULATOR = "ground (0 V)", "electrode", "rigid plane"
COLOURS = {GROUND: "#000000", ELECTRODE: "#E69F00", INSULATOR: "#8c8c8c"}


@dataclass(frozen=True)
class PlaneMark:
    """A rigid plane at the step shown: a point of it (3,), its unit normal to the bodies (3,), what it is."""

    name: str
    point: Array
    normal: Array
    kind: str


def planes_of(run: RunData, bodies: Bodies, magnified: float) -> list[PlaneMark]:
    """The rigid planes of a run, moved by `magnified` times their travel."""
    dimension = 2 if bodies.flat else 3
    low, high = bodies.points.min(axis=0), bodies.points.max(axis=0)
    owner = {name: row for row in run.scene.get("electrodes", []) for name in row["on"]}
    marks = []
    for plane in run.scene.get("planes", []):
        normal, point = np.zeros(3), (low + high) / 2
        if isinstance(plane["point"], str):
            axis, end = SIDES[dimension][plane["point"]]
            point[axis] = (low, high)[end][axis]
            normal[axis] = 1.0 if end == 0 else -1.0
        else:
            point[:dimension] = plane["point"]
        if plane.get("normal") is not None:
            normal[:] = 0.0
            normal[:dimension] = plane["normal"]
        normal /= np.linalg.norm(normal)
        travel = float(run.row.get(f"travel@{plane['name']}", 0.0))
        state = plane.get("potential", owner[plane["name"]].get("potential", 1.0) if plane["name"] in owner else None)
        kind = INSULATOR if state is None else GROUND if state == 0 else ELECTRODE
        marks.append(PlaneMark(plane["name"], point + magnified * travel * normal, normal, kind))
    return marks


def electrodes_of(run: RunData) -> dict[str, str]:
    """What the marked places of a run are, by name: ground or electrode; insulating ones are left out."""
    kinds = {}
    for row in run.scene.get("boundaries", []):
        if row.get("potential") is not None:
            kinds[row["on"]] = GROUND if row["potential"] == 0 else ELECTRODE
    for row in run.scene.get("electrodes", []):
        kinds[row["name"]] = GROUND if row.get("potential") == 0 else ELECTRODE
    return kinds


def poling_of(run: RunData, dimension: int) -> Array | None:
    """The one direction (3,) in which all piezoelectric bodies are poled; None where there is none or more than one."""
    directions = []
    materials: Mapping[str, Any] = run.scene.get("materials", {})
    bodies: Mapping[str, str] = run.scene.get("bodies", {})
    for body in run.names[0]:
        key = key_of(body, bodies)
        if key is None:
            return None
        keys = materials.get(bodies[key])
        built_in = BUILT_IN.get(bodies[key] if keys is None else keys.get("like") or "")
        if not (keys or {}).get("piezo") and not (built_in is not None and built_in.is_piezoelectric):
            continue
        poling = (keys or {}).get("poling") or np.eye(3)[dimension - 1]
        if isinstance(poling, str) or (keys or {}).get("axis1") == "along":  # it follows the fibers
            return None
        vector = np.array([*poling, 0.0][:3], float)
        directions.append(vector / np.linalg.norm(vector))
    if not directions or any(np.abs(d - directions[0]).max() > 1e-6 for d in directions):
        return None
    return directions[0]
