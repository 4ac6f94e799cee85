"""Checks that need more than one section of a scene. Each raises SceneError with the full path of the key."""

from __future__ import annotations

from fnmatch import fnmatchcase

import numpy as np

from piezomat.forms.material_library import BUILT_IN
from piezomat.meshes.builders.frames import tangents
from piezomat.meshes.gmsh_io.mesh_file import MeshFile
from piezomat.meshes.names import is_formula
from piezomat.scene.data import SceneData, in_space, key_of
from piezomat.scene.errors import SceneError, named, shown, unknown_name
from piezomat.scene.sections import SIDES, Boundary, Plane

LEAST_SHARE = 1e-3  # of the force on a plane that is along its normal
LEAST_ACROSS = 0.1  # of a poling across a centre line, as a unit vector: 6 degrees
OVERLAP = 0.1  # most that bodies may overlap at the start, as a share of the size of the smallest one


def check(scene: SceneData) -> None:
    """Raise SceneError for the first thing in which the sections of a scene do not fit together."""
    for part in (names, bodies, mesh, gap, orientations, boundaries, planes, electrodes, circuits, contact, load):
        part(scene)


def names(scene: SceneData) -> None:
    """Names at which a row of pairs.csv has its second cell are no formulas of a spreadsheet."""
    found = [("bodies." + body, body) for body in scene.body_names]
    found += [(f"planes[{index}].name", plane.name) for index, plane in enumerate(scene.planes)]
    for key, name in found:
        if is_formula(name):
            raise SceneError(key, shown(name), "a name that no spreadsheet takes for a formula: none of = + - @ first")


def bodies(scene: SceneData) -> None:
    """Every body of the geometry has a material that exists, and every key is a body or fits one."""
    known = scene.body_names
    for body, material in scene.bodies.items():
        if body not in known and not ("*" in body and any(fnmatchcase(name, body) for name in known)):
            raise unknown_name(f"bodies.{body}", body, "a body of the geometry, or a pattern", known)
        if material not in scene.materials and material not in BUILT_IN:
            names = list(dict.fromkeys([*scene.materials, *BUILT_IN]))
            raise unknown_name(f"bodies.{body}", material, "a material of the scene or a built-in one", names)
    for body in known:
        if key_of(body, scene.bodies) is None:
            raise SceneError(f"bodies.{body}", "nothing", "a material of the scene or a built-in one for every body")


def mesh(scene: SceneData) -> None:
    """Built shapes have a size of elements unless their cells are counted; factors belong to bodies."""
    counted = isinstance(scene.geometry, MeshFile) or getattr(scene.geometry, "divisions", None) is not None
    if scene.mesh.size is None and not counted:
        raise SceneError("mesh.size", "nothing", "a number > 0: the size of elements far from contact, um")
    for body in scene.mesh.size_factors:
        if body not in scene.body_names:
            raise unknown_name(f"mesh.size_factors.{body}", body, "a body of the geometry", scene.body_names)
    if scene.dimension == 3 and scene.model.plane == "stress":
        raise SceneError("model.plane", '"stress"', 'nothing but "strain" in three dimensions')
    for body in scene.body_names if scene.model.plane == "stress" else ():
        if not scene.material(body).has_plane_stress:
            allowed = f'"strain": the law of the material of {body} has no plane stress'
            raise SceneError("model.plane", '"stress"', allowed)


def gap(scene: SceneData) -> None:
    """The bodies of a built shape do not overlap from the start by more than a tenth of the smallest one."""
    given = getattr(scene.geometry, "gap", 0.0)
    if given < 0 and -given > OVERLAP * scene.geometry.size():
        least = -OVERLAP * scene.geometry.size()
        allowed = f"a number >= {least:g}: bodies may overlap by a tenth of their size"
        raise SceneError("geometry.gap", given, allowed)


def orientations(scene: SceneData) -> None:
    """Axes of materials have as many components as the scene allows, a line to follow, and are not parallel."""
    for name, keys in scene.materials.items():
        for key in ("poling", "axis1"):
            direction = getattr(keys, key)
            if isinstance(direction, list) and len(direction) < scene.dimension:
                raise SceneError(f"materials.{name}.{key}", direction, "3 numbers: the scene is three-dimensional")
        if keys.follows_line:
            _check_lines(scene, name)
        elif keys.axis1 is not None:
            try:
                scene.oriented(name)
            except ValueError:
                allowed = f"a direction that is not parallel to poling = {scene.poling(name)}"
                raise SceneError(f"materials.{name}.axis1", keys.axis1, allowed) from None


def _check_lines(scene: SceneData, name: str) -> None:
    """The bodies of a material whose axes follow centre lines have some, nowhere parallel to a given poling."""
    keys, poling = scene.materials[name], scene.poling(name)
    key = "poling" if keys.poling == "across" else "axis1"
    found = shown(getattr(keys, key))
    what = "a vector" if key == "poling" else "a vector, or nothing"
    if scene.dimension == 2:
        raise SceneError(f"materials.{name}.{key}", found, f"{what}: in two dimensions bodies have no centre line")
    for body in scene.body_names:
        if scene.material_name(body) != name:
            continue
        if body not in scene.centre_lines:
            allowed = f"{what}: body {body} has no centre line, which fibers of a built shape alone have"
            raise SceneError(f"materials.{name}.{key}", found, allowed)
        if poling != "across":
            line = tangents(scene.centre_lines[body])
            across = np.linalg.norm(np.cross(line, in_space(poling)), axis=1) / np.linalg.norm(poling)
            if across.min() < LEAST_ACROSS:
                x, y, z = line[across.argmin()]
                allowed = (
                    f'"across", or a vector nowhere parallel to the centre line where axis1 is "along": '
                    f"that of {body} runs along ({x:.3g}, {y:.3g}, {z:.3g}) somewhere"
                )
                raise SceneError(f"materials.{name}.poling", poling, allowed)


def boundaries(scene: SceneData) -> None:
    """Rows are on facet groups, with a component a dimension and a factor that exists; no two give the same thing."""
    given: dict[tuple[str, str], int] = {}
    for index, row in enumerate(scene.boundaries):
        key = f"boundaries[{index}]"
        if row.on not in scene.facet_groups:
            raise unknown_name(f"{key}.on", row.on, "a facet group of the geometry", scene.facet_groups)
        for name in ("displacement", "traction", "force"):
            vector = getattr(row, name)
            if vector is not None and len(vector) != scene.dimension:
                found = ["free" if value is None else value for value in vector]
                raise SceneError(f"{key}.{name}", found, f"{scene.dimension} components, one a dimension")
        for name in ("potential", "charge_density"):
            if getattr(row, name) is not None and not scene.electric:
                allowed = "nothing, unless the material of a body has a permittivity"
                raise SceneError(f"{key}.{name}", getattr(row, name), allowed)
        for what in _prescribed(row):
            if (row.on, what) in given:
                first = given[row.on, what]
                allowed = f'what boundaries[{first}] does not give on "{row.on}" already'
                raise SceneError(f"{key}.{what.partition(' ')[0]}", f"the {what} again", allowed)
            given[row.on, what] = index
        _check_factor(scene, f"{key}.follows", row.follows)


def planes(scene: SceneData) -> None:
    """Planes have names of their own, a component a dimension and factors that exist; something holds the bodies."""
    if not scene.boundaries and not scene.planes:
        raise SceneError("boundaries", "nothing", "at least one of [[boundaries]] or [[planes]]")
    names: dict[str, int] = {}
    for index, plane in enumerate(scene.planes):
        key = f"planes[{index}]"
        _check_own_name("planes", index, plane.name, names)
        if plane.name in scene.facet_groups or plane.name in scene.body_names:
            raise SceneError(f"{key}.name", shown(plane.name), "a name that no facet group and no body has")
        if isinstance(plane.point, str) and plane.point not in SIDES[scene.dimension]:
            allowed = f"{named(list(SIDES[scene.dimension]))} in two dimensions, or a point"
            raise SceneError(f"{key}.point", shown(plane.point), allowed)
        for name in ("point", "normal", "motion", "force"):
            vector = getattr(plane, name)
            if isinstance(vector, list) and len(vector) != scene.dimension:
                raise SceneError(f"{key}.{name}", vector, f"{scene.dimension} components, one a dimension")
        if plane.potential is not None and not scene.electric:
            allowed = "nothing, unless the material of a body has a permittivity"
            raise SceneError(f"{key}.potential", plane.potential, allowed)
        for name in ("follows", "potential_follows"):
            _check_factor(scene, f"{key}.{name}", getattr(plane, name))
        if plane.area is not None and plane.pressure is None and not _is_electrode(scene, plane):
            raise SceneError(f"{key}.area", plane.area, "nothing without pressure, unless the plane is an electrode")
        if plane.is_pushed:
            _check_push(scene, key, plane)


def _is_electrode(scene: SceneData, plane: Plane) -> bool:
    return plane.potential is not None or any(plane.name in scene.members(row).planes for row in scene.electrodes)


def _check_push(scene: SceneData, key: str, plane: Plane) -> None:
    """A plane by force presses on the bodies at every load level: nothing would hold one that is pulled away."""
    if plane.pressure is not None and scene.area_of(plane) is None:
        allowed = (
            "the area that the pressure acts on, um2 (2D: um): only built shapes in a box know that of top and bottom"
        )
        raise SceneError(f"{key}.area", "nothing", allowed)
    normal = plane.inward(scene.dimension)
    if plane.force is not None and np.array(plane.force) @ normal <= LEAST_SHARE * np.linalg.norm(plane.force):
        allowed = f"a force towards the bodies, along its normal {[float(f'{c:.4g}') for c in normal]}"
        raise SceneError(f"{key}.force", plane.force, allowed)
    values = scene.load.factors[plane.follows] if plane.follows is not None else []
    if min(values, default=0.0) < 0.0:
        allowed = f"no negative values: {shown(plane.name)} would be pulled off the bodies, to which it does not adhere"
        raise SceneError(f"load.factors.{plane.follows}", values, allowed)


def electrodes(scene: SceneData) -> None:
    """Electrodes have names of their own, stand on what exists and has a potential, and follow factors that exist."""
    names: dict[str, int] = {}
    owners: dict[str, int] = {}
    for index, electrode in enumerate(scene.electrodes):
        key = f"electrodes[{index}]"
        if not scene.electric:
            allowed = "none, unless the material of a body has a permittivity"
            raise SceneError(key, f"the electrode {shown(electrode.name)}", allowed)
        _check_own_name("electrodes", index, electrode.name, names)
        planes = {plane.name: plane for plane in scene.planes}
        known = [*scene.facet_groups, *scene.body_names, *planes]
        for place, name in enumerate(electrode.on):
            if not any(key_of(member, [name]) for member in known):
                raise unknown_name(f"{key}.on[{place}]", name, "a facet group, a body or a plane, or a pattern", known)
        for member in [m for members in scene.members(electrode) for m in members]:
            if member in owners:
                allowed = f"what is not of electrodes[{owners[member]}], {shown(scene.electrodes[owners[member]].name)}"
                raise SceneError(f"{key}.on", shown(member), allowed)
            owners[member] = index
            if member in planes and planes[member].potential is not None:
                allowed = "a plane without potential of its own, or potential in [[electrodes]] alone"
                raise SceneError(f"{key}.on", f"{shown(member)}, a plane with a potential", allowed)
        _check_factor(scene, f"{key}.follows", electrode.follows)
        if electrode.charge is not None and not scene.potentials:
            found = f"{electrode.charge:g} where nothing has a potential"
            allowed = "a charge beside a potential, such as potential = 0 of another electrode"
            raise SceneError(f"{key}.charge", found, allowed)


def circuits(scene: SceneData) -> None:
    """Circuits connect two different electrodes of the scene."""
    known = [electrode.name for electrode in scene.electrodes]
    for index, circuit in enumerate(scene.circuits):
        for side, name in enumerate(circuit.between):
            if name not in known:
                raise unknown_name(f"circuits[{index}].between[{side}]", name, "a name of [[electrodes]]", known)
        if circuit.between[0] == circuit.between[1]:
            raise SceneError(f"circuits[{index}].between", circuit.between, "two different electrodes")


def _check_factor(scene: SceneData, key: str, factor: str | None) -> None:
    if factor is not None and factor not in scene.load.factors:
        raise unknown_name(key, factor, "a factor of load.factors", list(scene.load.factors))


def _check_own_name(section: str, index: int, name: str, names: dict[str, int]) -> None:
    """Raise SceneError for a name that an earlier row of the section has; `names` holds their rows, and then this."""
    if name in names:
        allowed = f"a name of its own: it is that of {section}[{names[name]}]"
        raise SceneError(f"{section}[{index}].name", shown(name), allowed)
    names[name] = index


def _prescribed(row: Boundary) -> list[str]:
    """What a row fixes, in words that start with the key."""
    components = [f"displacement {'xyz'[i]}" for i, value in enumerate(row.displacement or []) if value is not None]
    return components + (["potential"] if row.potential is not None else [])


def contact(scene: SceneData) -> None:
    """Pairs name two different bodies or groups of facets, each pair once; what can be smoothed is smoothed alone."""
    if scene.contact is None:
        return
    if scene.contact.smoothing and scene.mesh.order == 2:
        raise SceneError("contact.smoothing", "true", "false with mesh.order = 2, whose facets are curved")
    if scene.contact.smoothing and scene.dimension == 3 and scene.model.kinematics == "finite":
        allowed = 'false, or model.kinematics = "small": in three dimensions curved facets do not turn with the bodies'
        raise SceneError("contact.smoothing", "true", allowed)
    pairs = scene.contact.pairs
    if pairs == "auto":
        if len(scene.body_names) < 2 and not scene.planes and not scene.contact.self_contact:
            allowed = 'two bodies, or [["slave", "master"], ...], or self_contact = true'
            raise SceneError("contact.pairs", '"auto" with one body', allowed)
        return
    known = list(dict.fromkeys([*scene.body_names, *scene.facet_groups]))
    seen: dict[frozenset[str], int] = {}
    for index, pair in enumerate(pairs):
        key = f"contact.pairs[{index}]"
        for side, name in enumerate(pair):
            if name not in known:
                raise unknown_name(f"{key}[{side}]", name, "a body or facet group of the geometry", known)
        if pair[0] == pair[1]:
            raise SceneError(key, pair, "two different bodies or facet groups")
        if frozenset(pair) in seen:
            raise SceneError(key, pair, f"each pair once: it is contact.pairs[{seen[frozenset(pair)]}] already")
        seen[frozenset(pair)] = index


def load(scene: SceneData) -> None:
    """Every load factor is followed."""
    followed = {row.follows for row in scene.boundaries}
    followed |= {row.follows for row in scene.electrodes}
    followed |= {factor for plane in scene.planes for factor in (plane.follows, plane.potential_follows)}
    for name in scene.load.factors:
        if name not in followed:
            names = named(sorted(filter(None, followed)))
            allowed = f"only factors that a boundary, plane or electrode follows ({names})"
            raise SceneError(f"load.factors.{name}", "a factor that nothing follows", allowed)
