"""The cases and the switches of the ablation study: what is solved, and what of the solver is off or changed."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from typing import Any

from piezomat.scene import Scene
from scripts.studies.stability_maps import around
from scripts.studies.stability_methods import METHODS
from scripts.studies.two_fibers import scene_of_shape
from tests.scenes import facing_halves

QUIET = ["output.fields=none", "output.picture=false"]


def _halves(penalty: float, fine: float = 0.016, **keys: Any) -> Scene:
    """Two half discs, pressed."""
    contact = {"passes": 1, "normal_penalty": penalty, **keys.pop("contact", {})}
    return scene_of_shape("facing_halves", fine, 4.75 * fine, contact, **keys)


def _loaded() -> Scene:
    """Half discs pressed by a traction, electrodes 20 V apart, strong coupling."""
    return Scene(
        geometry={"shape": "facing_halves"},
        mesh={"contact_size": 0.016, "size": 0.076},
        bodies={"lower": "pzt5h", "upper": "pzt5h"},
        contact={},
        load={"steps": [3], "factors": {"press": [1.0]}},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, "free"], "traction": [0, -400.0], "potential": 20, "follows": "press"},
        ],
    )


def _shipped(name: str, *overrides: str) -> Scene:
    """A shipped scene without output."""
    return Scene.load(name, [*overrides, *QUIET])


def _slid(method: str, stiffness: float) -> Scene:
    """A fiber slid round one of few facets, so many times as stiff."""
    return around(next(m for m in METHODS if m.name == method), 24, stiffness, steps=8)


_ARRAY = ["geometry.columns=2", "geometry.rows=2", "mesh.contact_size=0.08", "mesh.size=0.25"]


def _array(voltage: float | None = None) -> Scene:
    """Four fibers of an array, a voltage between floor and lid."""
    scene = _shipped("fiber_array", *_ARRAY, "load.steps=[2]").model_dump(exclude_unset=True)
    if voltage is not None:
        scene["electrodes"] = [e for e in scene["electrodes"] if e["name"] != "lid"]
        next(plane for plane in scene["planes"] if plane["name"] == "lid")["potential"] = voltage
    return Scene(**scene)


def _multigrid() -> Scene:
    """Crossed fibers, solved with multigrid."""
    scene = scene_of_shape("crossed_fibers", 0.06, 0.24, {"normal_penalty": 1e5}, steps=2)
    return Scene(**scene.model_dump(exclude_unset=True) | {"solver": {"kind": "iterative"}})


def _pushed() -> Scene:
    """Four fibers of an array under a lid that a force pushes."""
    scene = _shipped("fiber_array", *_ARRAY, "load.steps=[3]").model_dump(exclude_unset=True)
    lid = next(plane for plane in scene["planes"] if plane["name"] == "lid")
    lid.pop("motion")
    lid["force"] = [0.0, -40.0]
    return Scene(**scene)


# Name -> a function that makes the scene. Each takes a few seconds.
CASES = {
    "discs 1e5": lambda: _halves(1e5),
    "discs 1e8": lambda: _halves(1e8),
    "discs, one step 1e8": lambda: _halves(1e8, steps=1),
    "coarse discs 1e7": lambda: facing_halves(1e7, passes=1),
    "discs, node": lambda: _halves(1e5, contact={"method": "node"}),
    "discs, segment": lambda: _halves(1e6, contact={"method": "segment", "passes": 2}),
    "discs, load, 20 V": _loaded,
    "slid round": lambda: _slid("point", 100.0),
    "slid round, node": lambda: _slid("node", 1.0),
    "bonds snap": lambda: _shipped(
        "fibers_2d", "mesh.contact_size=0.02", "load.steps=[2, 4]", "contact.adhesion.strength=120"
    ),
    "crossed fibers": lambda: scene_of_shape("crossed_fibers", 0.08, 0.3, {"normal_penalty": 1e5}, steps=2),
    "crossed, multigrid": _multigrid,
    "array": _array,
    "array, 100 V": lambda: _array(100.0),
    "array, by force": _pushed,
    "mat": lambda: _shipped(
        "random_mat", "mesh.contact_size=0.5", "mesh.size=1.0", "geometry.count=4", "load.steps=[1]"
    ),
}


@dataclass(frozen=True)
class Switch:
    """A change of one module's constants: `module` below `piezomat`, their values, and the cases that it may touch.

    purpose: what the solver has it for.
    """

    name: str
    module: str
    values: dict[str, Any]
    purpose: str = ""
    cases: tuple[str, ...] = tuple(CASES)

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Change the constants, also where other modules have imported them; AttributeError for an unknown name."""
        module, changed = importlib.import_module(f"piezomat.{self.module}"), []
        for name, value in self.values.items():
            before = getattr(module, name)
            for other in [m for m in sys.modules.values() if getattr(m, "__name__", "").startswith("piezomat.")]:
                if vars(other).get(name) is before:
                    setattr(other, name, value)
                    changed.append((other, name, before))
        try:
            yield
        finally:
            for other, name, before in changed:
                setattr(other, name, before)


ALL_BUT_MATS = tuple(name for name in CASES if name != "mat")
ADHESIVE = ("bonds snap",)
MULTIGRID = ("crossed, multigrid",)
PUSHED = ("array", "array, by force")
FEW = ("discs 1e8", "array")
SPRINGS = "solver.stabilization_continuation"


# Module; its constants that are taken away or turned round; name and purpose of the switch; cases that it may touch.
OFF = [
    ("solver.line_search", {"CONVERGING": inf}, "no line search", "steps do not overshoot where points close"),
    (
        "solver.active_set_prediction",
        {"CANDIDATE_LIMIT": 0},
        "no active-set prediction",
        "fewer evaluations of contact where solves are cheap",
        ALL_BUT_MATS,
    ),
    ("solver.linear", {"CONDENSED_LIMIT": 0}, "no condensation", "one factorization of the bulk a run", ALL_BUT_MATS),
    (
        "solver.newton",
        {"NEAR_EQUILIBRIUM": inf},
        "contact complete always",
        "far from equilibrium the tangent stays definite",
    ),
    (
        "solver.newton",
        {"NEAR_EQUILIBRIUM": 0.0},
        "contact complete at the end alone",
        "near equilibrium Newton's method converges fast",
    ),
    (
        "solver.newton",
        {"MAX_RENEWALS": 0, "MAX_RENEWALS_IN_ALL": 0},
        "what surfaces face not renewed",
        "charges do not depend on the size of the step",
        ALL_BUT_MATS,
    ),
    ("solver.load_steps", {"SNAP_CUTBACKS": 99}, "no snap-through", "bonds that break at once", ADHESIVE),
    ("solver.multigrid", {"AGED": inf}, "preconditioner kept for ever", "made anew as contact changes", MULTIGRID),
    ("solver.multigrid", {"AGED": 0.0}, "preconditioner made anew", "kept while it serves", MULTIGRID),
]

# Constants that are scaled by each of these factors: the answer may not depend on them, the effort may.
FACTORS = (0.25, 4.0)
# Module; cases that its constants may touch; the constants, and what each is for.
SCALED: list[tuple[str, tuple[str, ...], dict[str, str]]] = [
    (
        "contact.closest_points",
        FEW,
        {
            "PROJECTION_TOLERANCE": "points keep their facet at its edge",
            "LARGEST_OVERSHOOT": "and outside a convex one",
        },
    ),
    ("contact.contact_points", FEW, {"NEAR": "room in the tangent for points that may soon touch"}),
    (
        "contact.gap_exchange",
        FEW,
        {"CLOSE": "more points where gaps are narrow", "AHEAD": "room in the tangent for facets that come near"},
    ),
    (
        "contact.interface_laws",
        FEW,
        {"FADE": "gap over which equal potentials end", "NEAR": "narrow gaps are those of contact points"},
    ),
    (
        "contact.search",
        FEW,
        {"DRIFT": "motion after which points are searched for", "MARGIN": "how long closest points are kept"},
    ),
    (
        "contact.setup",
        FEW,
        {"NEAR": "facets that are spread over the ranks", "NARROW": "width of blending where it cycles"},
    ),
    ("contact.shared_points", FEW, {"REACH": "facets that may share a point at their edge"}),
    ("contact.segmented_pair", ("discs, segment",), {"CUT_DRIFT": "motion after which segments are cut anew"}),
    (
        "solver.active_set_prediction",
        FEW,
        {"PREDICTION_TOLERANCE": "end of a prediction", "POOR_STEP": "no prediction where it does not help"},
    ),
    (
        "solver.coarse_space",
        MULTIGRID,
        {
            "AGGREGATE_NODES": "size of the boxes",
            "RELAXATION": "smoothing of the coarse functions",
            "SAFETY": "bound of the largest eigenvalue",
        },
    ),
    ("solver.condensation", FEW, {"CANDIDATE_DISTANCE": "nodes that the bulk is condensed to at first"}),
    ("solver.convergence", FEW, {"FIELD_FLOOR": "a field that nothing drives is not solved to rounding"}),
    ("solver.first_contact", ("array, by force",), {"FIRST": "first depth of a plane by force"}),
    (
        "solver.line_search",
        FEW,
        {
            "SLOPE_REDUCTION": "end of a search",
            "CONVERGING": "no search where the residual falls",
            "UPHILL_GROWTH": "bound of steps that lead uphill",
            "JUMP": "end of a search at a kink",
        },
    ),
    (
        "solver.multigrid",
        MULTIGRID,
        {"START_TOLERANCE": "Krylov tolerance of the start value", "LOOSE_TOLERANCE": "the same with loose bodies"},
    ),
    (
        "solver.newton",
        FEW,
        {
            "NEAR_EQUILIBRIUM": "from where on contact is evaluated completely",
            "RENEWAL": "what surfaces face is found anew where it changes little",
        },
    ),
    (
        "solver.snap_through",
        ADHESIVE,
        {"VISCOSITY": "of bonds that snap, at first", "REDUCTION": "and from level to level"},
    ),
    (
        SPRINGS,
        PUSHED,
        {
            "LARGEST_LOAD_SHARE": "springs that carry a load are no solution",
            "STIFFER": "springs where weak ones fail",
            "LARGEST_ENERGY_SHARE": "and the energy that they may take",
            "INITIAL_FACTOR": "springs at first where a load acts",
            "RELEASED": "springs are let go under planes by force",
            "HELD": "share that springs carry, from which weak ones are tried at once",
        },
    ),
    (
        "assembly.stabilization_stiffness",
        PUSHED,
        {"RELATIVE_STIFFNESS": "of weak springs", "TRAVEL_STIFFNESS": "the same of a plane by force"},
    ),
]


def _scaled() -> Iterator[Switch]:
    """Each tuned constant a quarter and four times as large."""
    for module, cases, constants in SCALED:
        for name, purpose in constants.items():
            value = getattr(importlib.import_module(f"piezomat.{module}"), name)
            for factor in FACTORS:
                yield Switch(f"{name} {factor:g} times ({module})", module, {name: factor * value}, purpose, cases)


def switches() -> list[Switch]:
    """All changes, the solver as it is first."""
    off = [Switch(name, module, values, purpose, *cases) for module, values, name, purpose, *cases in OFF]
    return [Switch("as it is", "solver.newton", {}), *off, *_scaled()]
