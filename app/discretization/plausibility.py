"""Doubts about numbers: sizes and constants that look like those of other units, a poling that has no effect."""

from __future__ import annotations

import numpy as np

from piezomat.forms.constitutive import ConstitutiveLaw
from piezomat.forms.materials import VACUUM_PERMITTIVITY
from piezomat.meshes import parallel
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.scene.errors import named, shown
from piezomat.scene.scene import Scene

EXTENT = (1e-3, 1e5)  # um, of the model: a nanometre to ten centimetres
STIFFEST = 1e7  # MPa, ten times diamond
OUT_OF_PLANE = 0.1  # part of a poling, as a unit vector, that is out of the plane


def implausible(scene: Scene, bodies: BodyMesh, materials: list[ConstitutiveLaw]) -> list[str]:
    """What looks like a number in other units than um, MPa and pC/(V um), or has no effect. Collective."""
    used: dict[str, ConstitutiveLaw] = {}
    for body, law in zip(bodies.bodies, materials, strict=True):
        used.setdefault(scene.material_name(body), law)
    found = [_extent(bodies), _stiffness(used), _permittivity(used), _poling(scene, used)]
    return [text for text in found if text is not None]


def _extent(bodies: BodyMesh) -> str | None:
    x = np.asarray(bodies.mesh.geometry.x)
    low, high = x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)
    extent = float((parallel.largest(bodies.comm, high) - parallel.least(bodies.comm, low)).max())
    if EXTENT[0] <= extent <= EXTENT[1] * (1 + 1e-9):
        return None
    return f"the bodies together measure {extent:.3g} um: lengths are in um"


def _stiffness(used: dict[str, ConstitutiveLaw]) -> str | None:
    stiff = [name for name, law in used.items() if law.mean_stiffness > STIFFEST]
    if not stiff:
        return None
    most = max(stiff, key=lambda name: used[name].mean_stiffness)
    return (
        f"the stiffness of {_materials(stiff)} is up to {used[most].mean_stiffness:.3g} MPa, that of diamond 1e6: "
        "stiffnesses are in MPa (1 GPa = 1000 MPa)"
    )


def _permittivity(used: dict[str, ConstitutiveLaw]) -> str | None:
    least = 0.99 * VACUUM_PERMITTIVITY
    low = [name for name, law in used.items() if law.electric and law.mean_permittivity < least]
    if not low:
        return None
    lowest = min(low, key=lambda name: used[name].mean_permittivity)
    return (
        f"the permittivity of {_materials(low)} is {used[lowest].mean_permittivity:.3g} pC/(V um), below that of "
        f"vacuum, {VACUUM_PERMITTIVITY:.3g}: permittivities are in pC/(V um) (1 F/m = 1e6 pC/(V um))"
    )


def _poling(scene: Scene, used: dict[str, ConstitutiveLaw]) -> str | None:
    if scene.dimension == 3:
        return None
    across = []
    for name, law in used.items():
        direction = np.array([*(scene.poling(name) or ()), 0.0, 0.0, 0.0][:3])
        if law.is_piezoelectric and abs(direction[2]) > OUT_OF_PLANE * np.linalg.norm(direction):
            across.append(name)
    if not across:
        return None
    return f"the poling of {_materials(across)} points out of the plane, where no field is modelled"


def _materials(names: list[str]) -> str:
    return f"material{'s' if len(names) > 1 else ''} {named([shown(name) for name in names])}"
