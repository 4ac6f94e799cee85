"""The cases and the switches of the ablation study: what is solved, and what of the solver is off or changed."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from typing import Any

from piezomat.scene import Scene
from scripts.studies.two_fibers import scene_of_shape

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


def _pushed() -> Scene:
    """Six fibers of an array under a lid that a force pushes, their surfaces and the planes in air."""
    shape = ["geometry.columns=3", "geometry.rows=2", "mesh.contact_size=0.06", "mesh.size=0.25", "load.steps=[3]"]
    scene = _shipped("fiber_array", *shape).model_dump(exclude_unset=True)
    lid = next(plane for plane in scene["planes"] if plane["name"] == "lid")
    lid.pop("motion")
    lid["force"] = [0.0, -40.0]
    return Scene(**scene)


# Name -> a function that makes the scene. Each takes a few seconds.
CASES = {
    "discs 1e5": lambda: _halves(1e5, 0.008),
    "discs 1e8": lambda: _halves(1e8, 0.008),
    "discs, one step 1e8": lambda: _halves(1e8, 0.008, steps=1),
    "discs, node": lambda: _halves(1e5, contact={"method": "node"}),
    "discs, segment": lambda: _halves(1e6, contact={"method": "segment", "passes": 2}),
    "discs, load, 20 V": _loaded,
    "adhesive pull-off": lambda: _shipped("fibers_2d"),
    "crossed fibers": lambda: scene_of_shape("crossed_fibers", 0.05, 0.2, {"passes": 1, "normal_penalty": 1e5}),
    "crossed, multigrid": lambda: scene_of_shape("crossed_fibers", 0.0355, 0.144, {"normal_penalty": 1e5}),
    "array": lambda: _shipped("fiber_array", "geometry.columns=3", "mesh.contact_size=0.06", "mesh.size=0.25"),
    "array, by force": _pushed,
    "mat": lambda: _shipped("random_mat", "mesh.contact_size=0.4", "mesh.size=0.8", "geometry.count=6"),
}


@dataclass(frozen=True)
class Switch:
    """A change of one module's constants: `module` below `piezomat`, and their values."""

    name: str
    module: str
    values: dict[str, Any]

    def set(self) -> None:
        """Change the constants, also where other modules have imported them; AttributeError for an unknown name."""
        module = importlib.import_module(f"piezomat.{self.module}")
        for name, value in self.values.items():
            before = getattr(module, name)
            for other in [m for m in sys.modules.values() if getattr(m, "__name__", "").startswith("piezomat.")]:
                if vars(other).get(name) is before:
                    setattr(other, name, value)


def _off() -> Iterator[Switch]:
    """Each heuristic of the solver and of the contact search taken away."""
    yield Switch("no line search", "solver.line_search", {"CONVERGING": inf})
    yield Switch("no active-set prediction", "solver.active_set_prediction", {"CANDIDATE_LIMIT": 0})
    yield Switch("no condensation", "solver.linear", {"CONDENSED_LIMIT": 0})
    yield Switch("consistent tangent always", "solver.newton", {"CONSISTENT": inf, "CONSISTENT_UNCONSTRAINED": inf})
    yield Switch("consistent tangent never", "solver.newton", {"CONSISTENT": 0.0, "CONSISTENT_UNCONSTRAINED": 0.0})
    yield Switch("attraction from the start", "solver.newton", {"ATTRACTION": inf})
    yield Switch("points keep no facet", "contact.closest_points", {"PROJECTION_TOLERANCES": ((0, 0.02),)})
    yield Switch("springs weak at first", "solver.stabilization_continuation", {"MANY_BODIES": 10**9})
    yield Switch("springs stiff at first", "solver.stabilization_continuation", {"MANY_BODIES": 1})
    yield Switch("no snap-through", "solver.load_steps", {"SNAP_CUTBACKS": 99})
    yield Switch("stored interior not scaled", "solver.condensation", {"SAME_DIRECTION": 0.0})
    yield Switch("preconditioner kept for ever", "solver.multigrid", {"AGED": inf})
    yield Switch("preconditioner made anew", "solver.multigrid", {"AGED": 0.0})


# Constants that are scaled by each of these factors: the answer may not depend on them, the effort may.
FACTORS = (0.25, 4.0)
SCALED = {
    "contact.closest_points": ["FINAL_PROJECTION_TOLERANCE"],
    "contact.contact_points": ["NEAR"],
    "contact.gap_exchange": ["CLOSE", "AHEAD"],
    "contact.interface_laws": ["FADE", "NEAR"],
    "contact.search": ["DRIFT", "MARGIN"],
    "contact.setup": ["NEAR"],
    "contact.shared_points": ["REACH"],
    "contact.segmented_pair": ["CUT_DRIFT"],
    "solver.active_set_prediction": ["PREDICTION_TOLERANCE", "POOR_STEP"],
    "solver.coarse_space": ["AGGREGATE_NODES", "RELAXATION", "SAFETY"],
    "solver.condensation": ["CANDIDATE_DISTANCE"],
    "solver.convergence": ["FIELD_FLOOR"],
    "solver.first_contact": ["FIRST"],
    "solver.line_search": ["SLOPE_REDUCTION", "CONVERGING", "UPHILL_GROWTH", "JUMP"],
    "solver.multigrid": ["START_TOLERANCE", "LOOSE_TOLERANCE"],
    "solver.newton": ["ATTRACTION", "CONSISTENT", "CONSISTENT_UNCONSTRAINED", "SETTLED"],
    "solver.snap_through": ["VISCOSITY", "REDUCTION"],
    "solver.stabilization_continuation": [
        "LARGEST_LOAD_SHARE",
        "STIFFER",
        "LARGEST_ENERGY_SHARE",
        "INITIAL_FACTOR",
        "RELEASED",
    ],
    "assembly.stabilization_stiffness": ["RELATIVE_STIFFNESS", "TRAVEL_STIFFNESS"],
}


def _scaled() -> Iterator[Switch]:
    """Each tuned constant a quarter and four times as large."""
    for module, names in SCALED.items():
        for name in names:
            value = getattr(importlib.import_module(f"piezomat.{module}"), name)
            for factor in FACTORS:
                yield Switch(f"{name} {factor:g} times ({module})", module, {name: factor * value})


def switches() -> list[Switch]:
    """All changes, the solver as it is first."""
    return [Switch("as it is", "solver.newton", {}), *_off(), *_scaled()]
