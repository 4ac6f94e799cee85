"""What a scene would model and solve, and why, in words: `piezomat plan`."""

from __future__ import annotations

from collections import Counter

import numpy as np
from mpi4py import MPI

from piezomat.contact.cohesive_zone import coarse_cohesive_zone
from piezomat.contact.interface_laws import FADE, gap_medium
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.forms.contact.laws.equal_potential import EqualPotential
from piezomat.scene.errors import named
from piezomat.scene.scene import Scene
from piezomat.scene.sections import Contact, Load, Solver
from piezomat.solver.linear import direct_limit_3d, is_direct

AXES = "xyz"


def plan_text(scene: Scene, model: Model, contact: Interfaces | None) -> str:
    """The plan as lines of `what: choice (why)`. Collective; the same text on all ranks."""
    lines = [
        ("scene", scene.title),
        *_recipe(scene),
        ("mesh", _mesh(model)),
        ("unknowns", _unknowns(model)),
        ("material law", _law(model)),
        *_axes(model),
        ("held", _held(model)),
        ("contact", _contact(scene.contact, model, contact)),
        *_electric(scene.contact, model, contact),
        ("adhesion", _adhesion(scene.contact)),
        *_rigid(scene),
        *_planes(scene),
        *_plates(model, contact),
        *_electrodes(model),
        ("load", _load(scene.load)),
        ("solution", _solution(model, contact)),
        ("linear solver", _linear_solver(scene.solver, model)),
        ("memory", f"about {_memory_mb(scene.solver, model):.0f} MB over all ranks"),
    ]
    doubts = [*model.warnings, coarse_cohesive_zone(model, contact)]
    lines += [("warning", text) for text in doubts if text is not None]
    width = max(len(name) for name, _ in lines)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in lines)


def _recipe(scene: Scene) -> list[tuple[str, str]]:
    outcome = scene.outcome
    return [] if outcome is None else [("recipe", str(outcome))]


def _mesh(model: Model) -> str:
    topology = model.mesh.topology
    cells = topology.index_map(model.dim).size_global
    name = fenicsx.cell_name(model.mesh)
    bodies = model.bodies.bodies
    parts = len(model.bodies.part_bodies)
    text = f"{cells} cells ({name}, order {model.bodies.order}), {len(bodies)} bodies: {named(bodies)}"
    return text if parts == len(bodies) else f"{text}; {parts} connected parts"


def _unknowns(model: Model) -> str:
    displacements = ", ".join(f"u_{axis}" for axis in AXES[: model.dim])
    if model.electric:
        without = [n for n, m in zip(model.bodies.bodies, model.materials, strict=True) if not m.electric]
        note = f"; no potential in {', '.join(without)} (no permittivity)" if without else ""
        return f"{model.unknowns.total}: {displacements} and the potential at each node{note}"
    return f"{model.unknowns.total}: {displacements} at each node; no potential, since no material has a permittivity"


def _law(model: Model) -> str:
    kinds = []
    if any(m.is_piezoelectric for m in model.materials):
        kinds.append("piezoelectric")
    elif model.electric:
        kinds.append("elastic and dielectric, not coupled")
    else:
        kinds.append("elastic")
    if model.dim == 2:
        kinds.append(f"plane {model.plane}")
    kinds.append(f"{model.kinematics} kinematics")
    return ", ".join(kinds)


def _axes(model: Model) -> list[tuple[str, str]]:
    """What materials whose axes follow the centre lines of bodies do."""
    scene, names = model.scene, [model.scene.material_name(model.bodies.bodies[body]) for body in model.axes]
    notes = []
    for name, count in Counter(names).items():
        poling = scene.poling(name)
        direction = f"as near to {poling} as is normal to it" if poling != "across" else "across it, at first upward"
        notes.append(
            f"{name}: axis 1 along the centre line, poling {direction} ({count} bod{'ies' if count > 1 else 'y'})"
        )
    return [("material axes", "; ".join(notes))] if notes else []


def _held(model: Model) -> str:
    bodies = model.bodies
    names = ["+".join(bodies.bodies[i] for i in members) for members in bodies.part_bodies]
    free = [name for name, floats in zip(names, model.unconstrained[:, 0], strict=True) if floats]
    charged = [name for name, floats in zip(names, model.unconstrained[:, 1], strict=True) if floats]
    notes = []
    if free:
        notes.append(f"by contact at most, with weak springs to where they were: {named(free)}")
    if charged:
        notes.append(f"without a potential given, with a weak link to the one they had: {named(charged)}")
    return "; ".join(notes) or "every part by its boundaries"


def _contact(keys: Contact | None, model: Model, contact: Interfaces | None) -> str:
    if contact is None:
        return "none, since the scene has no [contact]"
    if keys is None:
        return "with planes alone, since the scene has no [contact]"
    points = model.comm.allreduce(sum(len(p.points.weight) for p in contact.surface_pairs))
    where = {
        "node": "at the slave nodes",
        "point": "at quadrature points of the slave facets",
        "segment": "on slave facets cut along master edges",
    }[keys.method]
    passes = "both ways, half each" if keys.passes == 2 else "slave to master"
    laws = [law for p in contact.surface_pairs for law in p.law.summands()]
    both = "gap and equal potential" if any(isinstance(law, EqualPotential) for law in laws) else "gap"
    listed = list(contact.pairs.listed.values())
    what = f"{len(listed)} pairs ({named(listed)})" if listed else "any two bodies that come near each other"
    curved = ", facets curved with a continuous normal" if keys.smoothing else ""
    if keys.self_contact and not listed:
        what += ", and each with itself"
    return f"{what}, {where}, {passes}, {points} points, penalties for {both}{curved}"


def _electric(keys: Contact | None, model: Model, contact: Interfaces | None) -> list[tuple[str, str]]:
    medium = gap_medium(model) if contact is not None else None
    if medium is not None:
        what = "air" if keys is None or keys.medium == "air" else f"a medium of {medium.permittivity:g} pC/(V um)"
        reach = f"open gaps up to {medium.reach:.3g} um pass charges"
        text = f"{reach}, filled with {what}; a closed one counts as {1e3 * medium.closed_gap:.2g} nm of it"
        return [("gaps", text)]
    sets = contact.point_sets if contact is not None else []
    laws = [law for p in sets for possible in p.possible_laws for law in possible.summands()]
    fades = [law.fade for law in laws if isinstance(law, EqualPotential)]
    if not model.comm.allreduce(len(fades)):
        return []
    voltage = model.prescription.largest_voltage()
    if keys is not None and keys.electric_range is not None:
        text = f"switched off over a gap of {keys.electric_range:g} um, given by the scene"
    else:
        least = model.comm.allreduce(min(float(f.min(initial=np.inf)) for f in fades), op=MPI.MIN)
        why = f", or what keeps surfaces {voltage:g} V apart from pulling each other in" if voltage else ""
        text = f"switched off over a gap of {least:.2g} um or more: {FADE:g} facets{why}"
    return [("electric contact", f"{text}; half of it before surfaces touch")]


def _rigid(scene: Scene) -> list[tuple[str, str]]:
    rows = [row for row in scene.boundaries if row.rigid]
    notes = [f"{row.on} (force {row.force}{f' times {row.follows}' if row.follows else ''})" for row in rows]
    return [("move as one", ", ".join(notes))] if notes else []


def _planes(scene: Scene) -> list[tuple[str, str]]:
    notes = []
    owner = {name: row.name for row in scene.electrodes for name in scene.members(row).planes}
    for plane in scene.planes:
        kind = "insulator" if plane.potential is None else f"electrode at {plane.potential:g} V"
        if plane.name in owner:
            kind = f"of the electrode {owner[plane.name]}"
        if plane.potential_follows is not None:
            kind += f" times {plane.potential_follows}"
        moves = "at rest" if plane.motion is None else f"moves by {plane.motion}"
        if plane.is_pushed:
            moves = f"pushed by {scene.push(plane)[1]:.4g} uN{'/um' if scene.dimension == 2 else ''}"
        notes.append(f"{plane.name} ({kind}, {moves}{f' times {plane.follows}' if plane.follows else ''})")
    return [("planes", ", ".join(notes))] if notes else []


def _plates(model: Model, contact: Interfaces | None) -> list[tuple[str, str]]:
    """What planes are with each other before anything moves, beside the bodies."""
    unit, area = ("pC/(V um)", "um") if model.dim == 2 else ("pC/V", "um2")
    notes = [
        f"{p.first.plane.name} and {p.second.plane.name} ({p.capacitance:.3g} {unit}, {p.area:.4g} {area} that no body "
        "covers)"
        for p in (contact.plates if contact is not None else ())
    ]
    return [("plate capacitor", ", ".join(notes))] if notes else []


def _electrodes(model: Model) -> list[tuple[str, str]]:
    notes = []
    for e in model.constraints.electrodes:
        row, nodes = e.electrode, model.comm.allreduce(len(e.nodes))
        state = "open"
        if row.potential is not None or row.charge is not None:
            state = f"at {row.potential:g} V" if row.potential is not None else f"with {row.charge:g} pC"
            state += f" times {row.follows}" if row.follows is not None else ""
        notes.append(f"{row.name} ({state}, on {named(row.on)}: {nodes} nodes at one potential)")
    lines = [("electrodes", ", ".join(notes))] if notes else []
    notes = []
    for e in model.constraints.conductors:
        row = e.electrode
        state = "open, no net charge"
        if row.potential is not None:
            state = f"at {row.potential:g} V{f' times {row.follows}' if row.follows is not None else ''}"
        notes.append(f"{named(row.on)} ({state})")
    return lines + ([("conductors", ", ".join(notes))] if notes else [])


def _adhesion(contact: Contact | None) -> str:
    keys = contact.adhesion if contact is not None else None
    if keys is None:
        return "none, so no history is kept"
    start = "once pressed together" if keys.starts == "touch" else "within its range from the start"
    return f"{keys.law} law, strength {keys.strength:g} MPa, {start}"


def _load(load: Load) -> str:
    stages = f"{sum(load.steps)} steps in {len(load.steps)} stages" if len(load.steps) > 1 else f"{load.steps[0]} steps"
    return f"{stages}, factors: {', '.join(load.factors) or 'none'}"


def _solution(model: Model, contact: Interfaces | None) -> str:
    reasons = [
        reason
        for reason, holds in (
            ("contact", contact is not None),
            ("finite kinematics", model.kinematics == "finite"),
        )
        if holds
    ]
    if not reasons:
        return "one linear solve a step, since nothing is nonlinear"
    text = f"Newton's method ({' and '.join(reasons)})"
    if model.kinematics == "small":
        text += "; the bulk's matrix is assembled once"
    return text


def _linear_solver(keys: Solver, model: Model) -> str:
    direct = is_direct(model, keys)
    name = "direct (MUMPS)" if direct else f"FGMRES{_multigrid(model)}"
    if keys.kind != "auto":
        return f"{name}, chosen by the scene"
    if model.dim == 2:
        return f"{name}, since the model is two-dimensional"
    relation = "at most" if direct else "more than"
    return f"{name}, since the model has {relation} {direct_limit_3d(model)} unknowns in three dimensions"


def _multigrid(model: Model) -> str:
    split = ", displacement and potential split, "
    if model.has_unconstrained_bodies:
        boxes = "two-level multigrid over boxes of each body"
        return f"{split}{boxes} and algebraic multigrid" if model.electric else f" with {boxes}"
    return f"{split}algebraic multigrid on each" if model.electric else " with algebraic multigrid (rigid-body modes)"


def _memory_mb(keys: Solver, model: Model) -> float:
    """Estimated memory: a base for each rank, four copies of the matrix, and factors with George and Liu's fill."""
    n = model.unknowns.total
    neighbours = {2: (7, 20), 3: (15, 60)}[model.dim][model.bodies.order - 1]
    matrix = 4 * 12 * n * neighbours * model.unknowns.block
    factors = 0.0
    if is_direct(model, keys):
        factors = 8 * (6.0 * n * model.unknowns.block * max(n, 2) ** 0.15 if model.dim == 2 else 16.0 * n ** (4 / 3))
    return 170 * model.comm.size + (matrix + factors) / 1e6
