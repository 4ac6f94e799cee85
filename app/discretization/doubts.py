"""Doubts about a scene on its mesh: warnings in one sentence each, and errors where a joint cannot be meant."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from piezomat.discretization.plausibility import implausible
from piezomat.forms.constitutive import ConstitutiveLaw
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.meshes.gmsh_io.mesh_file import KEY, MeshFile
from piezomat.meshes.gmsh_io.model import GEOMETRY
from piezomat.meshes.joints import Joint
from piezomat.scene.errors import SceneError, shown
from piezomat.scene.scene import Scene

# Poisson's ratio above which linear elements lock. A half disc pressed on rubber is too stiff with order 1 by 5 % at
# 0.49, 25 % at 0.499, 61 % at 0.4999 (triangles); by 5, 53 and 430 % with quadrilaterals.
LOCKING = 0.45


def doubts(scene: Scene, bodies: BodyMesh, materials: list[ConstitutiveLaw]) -> list[str]:
    """What of a scene and its mesh may not be meant, one sentence each. Collective.

    SceneError: a joint that cannot be meant, an electrode where nothing has a permittivity.
    """
    _check_electrodes(scene, bodies, materials)
    found = [_joint(scene, bodies, joint) for joint in bodies.joints]
    found += implausible(scene, bodies, materials)
    return [text for text in [*found, _locking(scene, bodies, materials), _level(scene)] if text is not None]


def _check_electrodes(scene: Scene, bodies: BodyMesh, materials: list[ConstitutiveLaw]) -> None:
    """Raise SceneError for a potential or a charge on facets of bodies without permittivity alone."""
    mesh = bodies.mesh
    mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    links = mesh.topology.connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    electric = np.array([material.electric for material in materials])[bodies.cell_body]
    for index, row in enumerate(scene.boundaries):
        given = [name for name in ("potential", "charge_density") if getattr(row, name) is not None]
        if not given:
            continue
        facets = bodies.facets[row.on]
        some = any(electric[links.links(facet)].any() for facet in facets)
        if mesh.comm.allreduce(len(facets)) and not mesh.comm.allreduce(some, op=MPI.LOR):
            found = f"{shown(getattr(row, given[0]))} on {shown(row.on)}, where no body has a permittivity"
            allowed = "a facet group of a body whose material has one, or is a conductor"
            raise SceneError(f"boundaries[{index}].{given[0]}", found, allowed)


def _joint(scene: Scene, bodies: BodyMesh, joint: Joint) -> str | None:
    contact = scene.contact
    names = list(dict.fromkeys(shown(bodies.bodies[body]) for body in joint.bodies))
    one = len(names) == 1
    nodes = f"{joint.nodes} node{'s' if joint.nodes > 1 else ''}"
    where = f"at ({', '.join(f'{c:.4g}' for c in joint.place)})"
    found = f"body {names[0]}" if one else f"bodies {' and '.join(names)}"
    if joint.kind == "hinge":
        if not one and not joint.bonded and contact is not None:
            found = f"{found} that share {nodes} but no facet, {where}"
            allowed = "bodies that share whole facets, which bonds them, or no node, so that they may meet in contact"
            raise SceneError(_key(scene), found, allowed)
        what = "hangs together by nodes" if one else "share nodes"
        return f"{found} {what} around which no facet joins the cells: {nodes}, {where}; they act as hinges"
    if contact is not None and contact.self_contact:
        return None
    double = f"on each other, each with nodes of its own: {nodes}, {where}"
    if one and not joint.bonded and (contact is None or contact.pairs == "auto"):
        allowed = "parts that share the nodes of their joint, or are two bodies, or contact.self_contact = true"
        raise SceneError(_key(scene), f"{found} in separate parts that lie {double}", allowed)
    what = "has" if one else "are bonded elsewhere and have"
    return f"{found} {what} facets that lie {double}; they do not meet without contact.self_contact = true"


def _key(scene: Scene) -> str:
    return KEY if isinstance(scene.geometry, MeshFile) else GEOMETRY


def _locking(scene: Scene, bodies: BodyMesh, materials: list[ConstitutiveLaw]) -> str | None:
    """Bodies that linear elements make too stiff; in plane stress they change their thickness instead."""
    if bodies.order > 1 or (scene.dimension == 2 and scene.model.plane == "stress"):
        return None
    ratio = {name: m.poisson_ratio for name, m in zip(bodies.bodies, materials, strict=True)}
    near = [name for name in ratio if ratio[name] > LOCKING]
    if not near:
        return None
    most = max(near, key=ratio.__getitem__)
    others = f" and {len(near) - 1} more" if len(near) > 1 else ""
    what = f"body {shown(most)}{others} with Poisson's ratio {ratio[most]:.4g} is too stiff in linear elements"
    return f"{what}, which lock: take mesh.order = 2"


def _level(scene: Scene) -> str | None:
    """Electrodes where nothing has a potential."""
    if not scene.electrodes or scene.potentials:
        return None
    return "no electrode, boundary or plane has a potential: only differences of voltages have a meaning"
