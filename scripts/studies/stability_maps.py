"""The maps of scripts/stability: for each cell a scene, and the error of its answer against a reference.

References are closed forms (tests/verification/references.py), conservation laws and, for the force on half discs, a
calculation without contact elements (stability_reference.py). None is a finer run of piezomat.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import dolfinx
import numpy as np
import ufl

from piezomat.forms.evaluation import integral
from piezomat.scene import Scene
from piezomat.simulation import Run
from scripts.studies.stability_map import Map
from scripts.studies.stability_methods import METHODS, Method
from scripts.studies.stability_offset import OFFSET
from tests.scenes import Points
from tests.verification import references as ref

RADIUS, YOUNG, POISSON = 0.5, 2500.0, 0.3
MODULUS = ref.contact_modulus((YOUNG, POISSON), (YOUNG, POISSON))
RELATIVE = ref.relative_radius(RADIUS, RADIUS)


# --- Fibers pressed together: Hertz ---------------------------------------------------------------

# Force (uN/um) on elastic half discs at an approach (um), from stability_reference.py: its finest meshes of order 1 and
# 2 agree within 0.1 %. Half spaces to the depth of the flat faces would carry 7 % more. Pvdf carries 1 % more, too.
FORCES = {("small", 0.005): 2.937, ("small", 0.02): 15.10, ("finite", 0.005): 2.884, ("finite", 0.02): 14.34}


def fibers(method: Method, approach: float, facet: float, steps: int, **contact: Any) -> Scene:
    """Two half discs of pvdf, pressed by an approach (um) of their flat faces; facets of order 2 twice as large."""
    facet *= method.order
    return method.scene(
        geometry={"shape": "facing_halves", "radius": RADIUS},
        mesh={"size": max(0.12, facet), "contact_size": facet, "size_factors": {"upper": 0.9}},
        bodies={"lower": "pvdf", "upper": "pvdf"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -approach], "follows": "press"},
        ],
        contact=contact,
        load={"steps": [steps], "factors": {"press": [1.0]}},
    )


def hertz_error(run: Run, approach: float) -> float:
    """The larger of the errors of the load, at this approach, and of the half-width, from the load there is."""
    load, points = -run.history[-1]["force_y@top"], Points(run)
    if points.force <= 0.0:
        return math.inf
    width = 2.0 * math.sqrt(points.spread([0])) / ref.hertz_line(load, RELATIVE, MODULUS).size - 1.0
    kinematics = run.model.kinematics
    return max(abs(width), abs(load / FORCES[kinematics, approach] - 1.0))


PENALTY = Map(
    "penalty",
    "Two fibers pressed together: penalty against load step",
    "force without contact elements, half-width of Hertz",
    ("penalty, times stiffness / facet", [1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6]),
    ("load steps", [1, 4]),
    0.05,
    lambda m, x, y: fibers(m, 0.02, 0.012, y, normal_penalty_factor=x),
    lambda run, x, y: hertz_error(run, 0.02),
)
FACETS = Map(
    "facets",
    "Two fibers pressed together: facets a circle",
    "force without contact elements, half-width of Hertz",
    ("facets a circle", [24, 48, 96, 192, 384, 768]),
    ("approach / radius", [0.01, 0.04]),
    0.05,
    lambda m, x, y: fibers(m, y * RADIUS, 2.0 * math.pi * RADIUS / x, 2),
    lambda run, x, y: hertz_error(run, y * RADIUS),
    tuple(method.name for method in METHODS),
)


# --- Blocks: the patch test -----------------------------------------------------------------------

SHORTENING = 5e-4


def patch(method: Method, ratio: float, factor: float) -> Scene:
    """Two blocks with `ratio` times as many facets above as below, the coarser side with three."""
    fine = round(3 * max(ratio, 1.0 / ratio))
    below, above = (3, fine) if ratio >= 1.0 else (fine, 3)
    return method.scene(
        geometry={"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[below, 3], [above, 3]]},
        mesh={"cells": "tensor"},
        materials={"soft": {"young": YOUNG, "poisson": 0.0}},
        bodies={"lower": "soft", "upper": "soft"},
        boundaries=[
            {"on": "bottom", "displacement": ["free", 0]},
            {"on": "top", "displacement": ["free", -SHORTENING]},
            {"on": "left", "displacement": [0, "free"]},
        ],
        contact={"pairs": [["lower_contact", "upper_contact"]], "normal_penalty_factor": factor},
    )


def patch_error(run: Run) -> float:
    """Root mean square of the error of the normal stress in the blocks, over that of blocks and penalty in series."""
    passes = run.contact.surface_pairs
    penalty = sum(p.share * float(p.points.weight @ p.law.penalties[0]) for p in passes)  # of a width of 1 um
    exact = -SHORTENING / (1.0 + YOUNG / penalty)
    mean = dolfinx.fem.form((run.state[1].dx(1) - exact) ** 2 * ufl.dx)
    return math.sqrt(integral(mean)) / abs(exact)


RATIO = Map(
    "ratio",
    "Patch test: slave / master mesh ratio against penalty",
    "uniform stress of blocks and penalty in series",
    ("facets above / below", [1 / 8, 1 / 4, 1 / 2, 2 / 3, 1, 3 / 2, 2, 4, 8]),
    ("penalty, times stiffness / facet", [1.0, 1e1, 1e2, 1e3, 1e4]),
    0.05,
    patch,
    lambda run, x, y: patch_error(run),
)


# --- Adhesion: the pull-off of Baney and Hui -------------------------------------------------------

LENGTH = 0.04 * RADIUS  # unit of lengths of the theory
WORK = math.pi * MODULUS * (0.5 * LENGTH) ** 3 / RELATIVE**2
FORCE = (math.pi * MODULUS * WORK**2 * RELATIVE) ** (1.0 / 3.0)
ZONES = {0.5: 1.8, 1.0: 1.0, 2.0: 0.4}  # width of the process zone at pull-off over LENGTH, by strength


def adhesive(method: Method, facets: float, strength: float) -> Scene:
    """Two fibers pressed and pulled apart, the process zone being so many facets wide."""
    width = 2.4 * LENGTH
    load = math.pi * MODULUS * width**2 / (4.0 * RELATIVE)
    depth = 2.0 * math.log(2.0 * RADIUS / width) - POISSON / (1.0 - POISSON)
    approach = 2.0 * load * (1.0 - POISSON**2) / (math.pi * YOUNG) * depth
    facet = method.order * ZONES[strength] * LENGTH / facets
    area = facet if method.plus else 1.0  # a bond a node, without an area, gets what belongs to it
    return method.scene(
        geometry={"shape": "facing_halves", "radius": RADIUS},
        mesh={"size": max(0.12, facet), "contact_size": facet},
        materials={"fiber": {"young": YOUNG, "poisson": POISSON}},
        bodies={"lower": "fiber", "upper": "fiber"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -approach], "follows": "press"},
        ],
        contact={
            "normal_penalty_factor": 20.0,
            "adhesion": {
                "law": "cutoff",
                "strength": area * ref.maugis_strength(strength, WORK, RELATIVE, MODULUS),
                "energy": area * WORK,
            },
        },
        load={"steps": [3, 24], "factors": {"press": [1.0, -0.4]}},
    )


ADHESION = Map(
    "adhesion",
    "Two fibers pulled apart: facets in the process zone against strength",
    "the pull-off of Baney and Hui",
    ("facets in the process zone", [0.3, 0.6, 1.0, 2.0, 5.0, 10.0]),
    ("strength (Maugis' lambda)", [0.5, 1.0, 2.0]),
    0.05,
    adhesive,
    lambda run, x, y: abs(max(row["force_y@top"] for row in run.history) / FORCE / ref.maugis_pull_off(y) - 1.0),
    ("paper", "node", "point", "segment"),  # half a minute a cell
)


# --- Coupling: two layers ------------------------------------------------------------------------


def layers(method: Method, coupling: float, factor: float) -> Scene:
    """Two layers of pvdf with `coupling` times its piezoelectric constants, pressed, 1 V across them."""
    e = {"e31": 0.0307692, "e32": -0.0057692, "e33": -0.075}
    contact: dict[str, Any] = {"pairs": [["lower_contact", "upper_contact"]], "normal_penalty_factor": 1e3}
    contact["electric_penalty"] = factor * ref.PVDF.permittivity
    return method.scene(
        geometry={"shape": "stacked_blocks", "height": [1.0, 1.0], "divisions": [[2, 2], [2, 2]]},
        mesh={"cells": "tensor"},
        materials={"layer": {"like": "pvdf", "piezo": {k: coupling * v for k, v in e.items()}, "poling": [0, 1]}},
        bodies={"lower": "layer", "upper": "layer"},
        boundaries=[
            {"on": "bottom", "displacement": ["free", 0], "potential": 0},
            {"on": "top", "displacement": ["free", -1e-3], "potential": 1},
            *({"on": side, "displacement": [0, "free"]} for side in ("left", "right")),
        ],
        contact=contact,
    )


def layers_error(run: Run, coupling: float) -> float:
    """The larger of the errors of the force and of the charge, over what bonded layers have."""
    p = ref.PVDF
    layer = ref.Layer(1.0, float(p.stiffness[2, 2]), coupling * p.e33, p.permittivity)
    bonded = ref.layer_stack([layer, layer], -1e-3, 1.0)
    last = run.history[-1]
    force = abs(last["force_y@top"] / bonded.stress - 1.0)
    return max(force, abs(last["charge@top"] / -bonded.displacement - 1.0))


COUPLING = Map(
    "coupling",
    "Two layers pressed under 1 V: coupling against electric penalty",
    "closed form of bonded layers",
    ("piezoelectric constants, times PVDF's", [1, 5, 10, 30]),
    ("electric penalty, times permittivity / thickness", [0.1, 0.5, 1e1, 1e2, 1e4]),
    0.05,
    layers,
    lambda run, x, y: layers_error(run, x),
)


# --- Sliding, and bodies that only contact holds ----------------------------------------------------


def sliding(method: Method, way: float, facet: float) -> Scene:
    """A fiber pressed on a block by 0.01 um, then slid along it by `way` facets in steps of a third of a facet."""
    facet *= method.order
    return method.scene(
        geometry={"shape": "fiber_on_block", "radius": RADIUS},
        mesh={"size": 0.15, "contact_size": facet, "size_factors": {"fiber": 0.9}},
        bodies={"block": "pvdf", "fiber": "pvdf"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": ["free", -0.01], "follows": "press"},
            {"on": "top", "displacement": [way * facet, "free"], "follows": "slide"},
        ],
        load={"steps": [1, round(3 * way)], "factors": {"press": [1.0, 1.0], "slide": [0.0, 1.0]}},
    )


def sliding_error(run: Run) -> float:
    """Largest tangential force and largest change of the normal one, over the normal one before the slide."""
    normal = np.array([row["force_y@top"] for row in run.history])
    tangential = np.array([row["force_x@top"] for row in run.history])
    return float(max(np.abs(tangential).max(), np.abs(normal - normal[0]).max()) / abs(normal[0]))


SLIDE = Map(
    "slide",
    "A fiber slid along a block: distance against facet size",
    "no change of the normal force, no friction",
    ("distance, facets", [1, 2, 4, 8]),
    ("facet, um", [0.02, 0.01]),
    0.05,
    sliding,
    lambda run, x, y: sliding_error(run),
)


def around(method: Method, facets: float, stiffness: float, steps: int = 24) -> Scene:
    """A fiber pressed by 0.02 um on one below and slid around it by three of its facets.

    A lower fiber that is stiffer meets one of finer facets, as a coarse mesh may serve where little is strained.
    """
    facet, axes = 2.0 * math.pi * RADIUS / facets, 2.0 * RADIUS - 0.02
    angle = np.linspace(-1.5, 1.5, steps + 1) * facet / axes
    way = axes * np.stack([np.sin(angle), np.cos(angle)]) - [[0.0], [2.0 * RADIUS]]
    return method.scene(
        geometry={"shape": "facing_halves", "radius": RADIUS},
        mesh={
            "size": max(0.15, method.order * facet),
            "contact_size": method.order * facet,
            "size_factors": {"upper": 0.9 if stiffness == 1.0 else 0.2},
        },
        materials={"lower": {"young": stiffness * YOUNG, "poisson": POISSON}},
        bodies={"lower": "lower", "upper": "elastic"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [1.0, "free"], "follows": "x"},
            {"on": "top", "displacement": ["free", 1.0], "follows": "y"},
        ],
        load={"steps": [2] + [1] * steps, "factors": {"x": way[0].tolist(), "y": way[1].tolist()}},
    )


def ripple(run: Run) -> tuple[float, float]:
    """On the way around: root mean square of the normal force's change, beside a smooth one, and the largest
    tangential force, both over the normal force."""
    rows = run.history[1:]
    x, y = (np.array([row[f"factor:{name}"] for row in rows]) for name in "xy")
    angle = np.arctan2(x, y + 2.0 * RADIUS)
    force = np.array([[row["force_x@top"], row["force_y@top"]] for row in rows])
    normal = -force[:, 0] * np.sin(angle) - force[:, 1] * np.cos(angle)
    along = force[:, 0] * np.cos(angle) - force[:, 1] * np.sin(angle)
    smooth = np.polynomial.Polynomial.fit(angle, normal, 2)(angle)
    return float(np.sqrt(np.mean((normal / smooth - 1.0) ** 2))), float(np.abs(along / normal).max())


RIPPLE = Map(
    "ripple",
    "A fiber slid round another: ripple of the force",
    "a force that changes smoothly (root mean square of the rest)",
    ("facets a circle of the lower fiber", [24, 48, 96]),
    ("stiffness, lower / upper", [1.0, 100.0]),
    0.01,
    around,
    lambda run, x, y: ripple(run)[0],
    tuple(method.name for method in METHODS),
)

BLOCKS = {n: ["lower", "upper"] if n == 2 else [f"block_{i + 1}" for i in range(n)] for n in (2, 3, 4, 5)}


def pile(method: Method, count: int, gap: float) -> Scene:
    """So many blocks on each other, 1 MPa on the uppermost: nothing but contact holds all but the lowest."""
    return method.scene(
        geometry={
            "shape": "stacked_blocks",
            "height": [0.3] * count,
            "divisions": [[3 + i % 3, 2] for i in range(count)],
            "gap": gap,
        },
        mesh={"cells": "tensor"},
        bodies=dict.fromkeys(BLOCKS[count], "elastic"),
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, "free"], "traction": [0, -1.0]},
        ],
    )


def pile_error(run: Run, count: int) -> float:
    """Largest error of the force through a contact, which is the load of 1 uN/um."""
    last, names = run.history[-1], BLOCKS[count]
    forces = [-last[f"contact_force_y@{a}-{b}"] for a, b in itertools.pairwise(names)]
    return max(abs(force - 1.0) for force in forces)


PILE = Map(
    "pile",
    "Blocks that nothing but contact holds: how many, and how far apart at first",
    "the load in every contact",
    ("blocks", [2, 3, 4, 5]),
    ("gap, um", [0.0, 0.002, 0.01]),
    0.01,
    pile,
    lambda run, x, y: pile_error(run, x),
)

MAPS = {m.name: m for m in (PENALTY, RATIO, COUPLING, FACETS, SLIDE, RIPPLE, OFFSET, PILE, ADHESION)}
