"""The sections of a scene file, one model each, with what can be checked inside a section.

Units: um, uN, MPa, V, pC, pJ. Unknown keys, strings or booleans for numbers, inf and nan are refused.
What needs more than one section (names of bodies, the dimension) is checked by `piezomat.scene.scene`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema, model_validator

from piezomat.forms.contact.laws.catalogue import REVERSIBLE
from piezomat.scene.errors import SceneError, named, shown
from piezomat.scene.keys import Capacitance, Count, Direction, Keys, Name, Positive
from piezomat.scene.petsc_options import check_petsc_options

# Literal[1, 2] alone takes 1.0 and true too; what is no integer is handed on as None, which no Literal takes.
OneOrTwo = Annotated[Literal[1, 2], BeforeValidator(lambda value: value if type(value) is int else None)]

Component = Annotated[
    float | None,
    BeforeValidator(lambda value: None if value == "free" else value),
    PlainSerializer(lambda value: "free" if value is None else value),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"const": "free"}]}),
]


class MeshKeys(Keys):
    """[mesh]: sizes (without effect on mesh files and where a shape has divisions) and kind of elements."""

    size: Positive | None = Field(None, description="size of elements far from contact, um; required for built shapes")
    contact_size: Positive | None = Field(
        default_factory=lambda given: given["size"] / 4 if given.get("size") else None,
        description="size of elements where bodies meet, um; default: a quarter of size",
    )
    order: OneOrTwo = Field(1, description="order of displacement, potential and geometry")
    cells: Literal["simplex", "tensor"] = Field("simplex", description="tensor: quadrilaterals or bricks")
    size_factors: dict[str, Positive] = Field({}, description="body = factor on its sizes of elements")
    max_cells: Count | None = Field(
        None, description="most cells, as estimated from the sizes before meshing; absent: what the memory here holds"
    )

    @model_validator(mode="after")
    def _refined(self) -> Self:
        if self.size and self.contact_size and self.contact_size > self.size:
            raise SceneError("contact_size", self.contact_size, f"a number > 0 and <= mesh.size = {self.size:g}")
        return self


class ModelKeys(Keys):
    """[model]: the mechanics."""

    plane: Literal["strain", "stress"] = Field("strain", description="2D only")
    kinematics: Literal["small", "finite"] = Field(
        "small", description="finite: Green-Lagrange strain, referential field"
    )


class Boundary(Keys):
    """[[boundaries]]: what is prescribed on a group of facets."""

    on: Name = Field(description="facet group")
    displacement: Annotated[list[Component], Field(min_length=2, max_length=3)] | None = Field(
        None, description='um, one a dimension; "free" leaves a component free'
    )
    potential: float | None = Field(None, description="V")
    traction: Annotated[list[float], Field(min_length=2, max_length=3)] | None = Field(
        None, description="MPa per reference area, one a dimension"
    )
    pressure: float | None = Field(None, description="MPa, pushing inward")
    rigid: bool | None = Field(None, description="true: the group moves as one, without rotation, under a force")
    force: Annotated[list[float], Field(min_length=2, max_length=3)] | None = Field(
        None, description="uN (2D: per um of depth), on a rigid group: its total force, one a dimension"
    )
    charge_density: float | None = Field(None, description="pC/um2 of free charge")
    follows: Name | None = Field(None, description="load factor on the values of this row; absent: constant")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        conditions = ("displacement", "potential", "traction", "pressure", "force", "charge_density")
        fixed = [value is not None for value in self.displacement or []]
        others = [key for key in conditions[1:] if getattr(self, key) is not None]
        if not any(fixed) and not others:
            raise SceneError("", "no condition", f"at least one of {named(conditions)}")
        if self.potential is not None and self.charge_density is not None:
            raise SceneError(
                "charge_density", "both potential and charge_density", "either potential or charge_density"
            )
        for axis, (held, load) in enumerate(zip(fixed, self.traction or [], strict=False)):
            if held and load:
                allowed = f'0 where displacement[{axis}] is a number, or displacement[{axis}] = "free"'
                raise SceneError(f"traction[{axis}]", load, allowed)
        if fixed and all(fixed) and self.pressure is not None:
            raise SceneError(
                "pressure",
                "a pressure where every displacement is prescribed",
                'a "free" displacement component',
            )
        self._check_rigid(fixed)
        return self

    def _check_rigid(self, fixed: list[bool]) -> None:
        """Raise SceneError for a rigid group without a force, or a force without a rigid group that it can move."""
        if not self.rigid:
            if self.force is not None:
                raise SceneError("force", self.force, "rigid = true with it; traction on a group that is not rigid")
            return
        if self.force is None:
            raise SceneError("force", "nothing", "the total force on the group, with rigid = true")
        for key in ("traction", "pressure"):
            if getattr(self, key) is not None:
                raise SceneError(key, getattr(self, key), "force alone, with rigid = true")
        if fixed and all(fixed):
            allowed = 'false where every displacement is prescribed, or a "free" component'
            raise SceneError("rigid", "true", allowed)
        for axis, (held, force) in enumerate(zip(fixed, self.force, strict=False)):
            if held and force:
                allowed = f'0 where displacement[{axis}] is a number, or displacement[{axis}] = "free"'
                raise SceneError(f"force[{axis}]", force, allowed)


Side = Literal["bottom", "top", "left", "right", "front", "back"]
# Axis and end of each side of the box around the bodies, by dimension; its plane's normal points inward.
SIDES: dict[int, dict[str, tuple[int, int]]] = {
    2: {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1)},
    3: {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)},
}


class Plane(Keys):
    """[[planes]]: a rigid plane without a mesh, which all bodies meet: platen, wall, electrode."""

    name: Name = Field(description="names its columns of the history")
    point: Side | Annotated[list[float], Field(min_length=2, max_length=3)] = Field(
        description="um, or the side of the box around the bodies that the plane lies on"
    )
    normal: Direction | None = Field(None, description="to the side where the bodies are; default of a side: inward")
    motion: Annotated[list[float], Field(min_length=2, max_length=3)] | None = Field(
        None, description="um; without motion, force and pressure the plane stays"
    )
    force: Annotated[list[float], Field(min_length=2, max_length=3)] | None = Field(
        None, description="uN (2D: per um of depth), instead of motion: the plane moves along it as far as bodies yield"
    )
    pressure: Positive | None = Field(None, description="MPa, instead of a force: pushes the plane along its normal")
    area: Positive | None = Field(
        None,
        description="um2 (2D: um) that pressure acts on, and with which electrodes face each other; default: a box's "
        "area seen from above, of a built shape",
    )
    follows: Name | None = Field(
        None, description="load factor on motion, force or pressure; absent: there from the start"
    )
    potential: float | None = Field(None, description="V, of an electrode; absent: an insulator")
    potential_follows: Name | None = Field(None, description="load factor on the potential; absent: constant")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.normal is None and not isinstance(self.point, str):
            raise SceneError("normal", "nothing", "a direction, to the side where the bodies are")
        if self.normal is not None and not any(self.normal):
            raise SceneError("normal", self.normal, "a direction: not the zero vector")
        given = [key for key in ("motion", "force", "pressure") if getattr(self, key) is not None]
        if len(given) > 1:
            raise SceneError(given[1], f"both {' and '.join(given)}", "at most one of motion, force and pressure")
        if self.follows is not None and not given:
            raise SceneError("follows", shown(self.follows), "nothing without motion, force or pressure")
        if self.potential_follows is not None and self.potential is None:
            raise SceneError("potential_follows", shown(self.potential_follows), "nothing without potential")
        return self

    @property
    def is_pushed(self) -> bool:
        """Whether a force moves it, not a given motion."""
        return self.force is not None or self.pressure is not None

    def inward(self, dimension: int) -> NDArray[np.float64]:
        """Unit normal (d,), to the side where the bodies are."""
        if self.normal is not None:
            return np.array(self.normal) / np.linalg.norm(self.normal)
        axis, end = SIDES[dimension][self.point]
        return np.eye(dimension)[axis] * (1.0 if end == 0 else -1.0)

    def motion_share(self, factors: dict[str, float]) -> float:
        """Share of `motion` at these load factors; without any factors only a plane moved from the start has moved."""
        return factors.get(self.follows, 0.0) if self.follows is not None else 1.0


class Electrode(Keys):
    """[[electrodes]]: metal on facet groups, bodies and planes, all at one potential; absent: insulators."""

    name: Name = Field(description="names its columns of the history")
    on: Annotated[list[Name], Field(min_length=1)] = Field(
        description='facet groups, bodies and planes, or patterns of them such as "cap_*"'
    )
    potential: float | None = Field(None, description="V; without potential and charge: open, no net charge")
    charge: float | None = Field(None, description="pC, the net charge of an open electrode")
    follows: Name | None = Field(None, description="load factor on the potential or charge; absent: constant")

    @model_validator(mode="after")
    def _one_condition(self) -> Self:
        if self.potential is not None and self.charge is not None:
            raise SceneError("charge", "both potential and charge", "either potential or charge")
        if self.follows is not None and self.potential is None and self.charge is None:
            raise SceneError("follows", shown(self.follows), "nothing without potential or charge")
        return self


class Circuit(Keys):
    """[[circuits]]: what is connected between two electrodes: an instrument, a cable, stray field."""

    between: Annotated[list[Name], Field(min_length=2, max_length=2)] = Field(description="names of two electrodes")
    capacitance: Capacitance = Field(
        description='pC/V (= pF; 2D: per um of depth), or text with a unit: "10 pF", "2 nF"'
    )


class Adhesion(Keys):
    """[contact.adhesion]: tension that the contact carries; absent: none."""

    law: Literal["cutoff", "bilinear", *REVERSIBLE] = Field(description="tension over the opening of the gap")
    strength: Positive = Field(description="largest tension, MPa")
    energy: Positive | None = Field(None, description="work of separation, pJ/um2")
    range: Positive | None = Field(None, description="um, for law cutoff instead of energy")
    starts: Literal["touch", "always"] = Field(
        default_factory=lambda given: "always" if given.get("law") in REVERSIBLE else "touch",
        description='touch: sticks once pressed together; default "touch", and "always" for law lennard_jones',
    )

    @model_validator(mode="after")
    def _one_work(self) -> Self:
        if self.law != "cutoff" and self.range is not None:
            raise SceneError("range", self.range, f'energy for law "{self.law}"; range belongs to law "cutoff"')
        if self.law in REVERSIBLE and self.starts == "touch":
            raise SceneError("starts", '"touch"', f'"always": law "{self.law}" attracts whatever comes near')
        if self.energy is None and self.range is None:
            allowed = "energy or range, a number > 0" if self.law == "cutoff" else "a number > 0"
            raise SceneError("energy", "nothing", allowed)
        if self.energy is not None and self.range is not None:
            raise SceneError("range", "both energy and range", "exactly one of energy and range")
        return self


def _factor(penalty: str, default: float) -> Any:
    """Default of a penalty's factor, unless the penalty itself is given."""
    return lambda given: default if given.get(penalty) is None else None


# Keys of [contact] that have a meaning without a medium alone.
EQUAL_POTENTIAL = ("electric_penalty", "electric_penalty_factor", "electric_range")


def _electric_factor(given: dict[str, Any]) -> float | None:
    """Default of electric_penalty_factor."""
    return 10.0 if given.get("medium") == "none" and given.get("electric_penalty") is None else None


class Contact(Keys):
    """[contact]: which surfaces meet and how that is integrated; absent: none."""

    pairs: Literal["auto"] | list[Annotated[list[Name], Field(min_length=2, max_length=2)]] = Field(
        "auto",
        description='every two bodies that can meet, or [["slave", "master"], ...] of facet groups or bodies',
    )
    method: Literal["node", "point", "segment"] = Field(
        "point",
        description="node-to-surface, quadrature points on the slave, or on slave facets cut along master edges",
    )
    self_contact: bool = Field(
        False, description='pairs "auto" only: bodies also meet themselves, and others that they share nodes with'
    )
    passes: OneOrTwo = Field(2, description="2: both ways, half each")
    normal_penalty: Positive | None = Field(None, description="MPa/um per area")
    normal_penalty_factor: Positive | None = Field(
        default_factory=_factor("normal_penalty", 10.0),
        description="times stiffness / facet size; default 10 without normal_penalty",
    )
    augment: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None,
        description="gap (in facet sizes) and potential jump (in the potential's range) that augmentation may leave; "
        "absent: what the penalties leave",
    )
    smoothing: bool = Field(
        False,
        description="facets of order 1 curved between their nodes, with a continuous normal; edges sharper than 50 "
        "degrees stay",
    )
    nodal_weight: Literal["area", "unit"] | None = Field(
        default_factory=lambda given: "area" if given.get("method") == "node" else None,
        description="method node only; unit: one spring per node with no area; default area",
    )
    medium: Literal["air", "none"] | Positive = Field(
        "air",
        description='in open gaps, where bodies have a permittivity: "air", a permittivity in pC/(V um), or "none": '
        "potentials are equal where surfaces touch, and no charge passes an open gap; that is the default beside one "
        "of its keys",
    )
    medium_gap: Positive | None = Field(
        None, description="um; gap at which the capacitance of the medium levels off; absent: chosen, see plan"
    )
    medium_range: Positive | None = Field(
        None, description="um; gap up to which surfaces exchange charges; absent: a radius, see plan"
    )
    electric_penalty: Annotated[float, Field(ge=0)] | None = Field(
        None, description='medium "none": pC/(V um2); 0: surfaces in contact are insulated from each other'
    )
    electric_penalty_factor: Positive | None = Field(
        default_factory=_electric_factor,
        description='medium "none": times permittivity / facet size; default 10 without electric_penalty',
    )
    electric_range: Positive | None = Field(
        None,
        description='medium "none": gap over which the electric contact is switched off, half of it before touch, um; '
        "absent: chosen, see plan",
    )
    adhesion: Adhesion | None = None

    @model_validator(mode="before")
    @classmethod
    def _without_medium(cls, data: Any) -> Any:
        """Keys of the law without a medium ask for it."""
        asks = isinstance(data, dict) and "medium" not in data
        if asks and (data.get("nodal_weight") == "unit" or any(data.get(key) is not None for key in EQUAL_POTENTIAL)):
            return {**data, "medium": "none"}
        return data

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for key in ("normal_penalty", "electric_penalty"):
            if getattr(self, key) is not None and getattr(self, f"{key}_factor") is not None:
                raise SceneError(key, f"both {key} and {key}_factor", f"either {key} or {key}_factor")
        for key in ("medium_gap", "medium_range") if self.medium == "none" else EQUAL_POTENTIAL:
            if getattr(self, key) is not None:
                allowed = 'medium = "none"' if self.medium != "none" else 'a medium, such as medium = "air"'
                raise SceneError(key, f"{key} with medium = {shown(self.medium)}", f"{key} with {allowed} alone")
        if self.nodal_weight == "unit" and self.medium != "none":
            allowed = 'medium = "none" with nodal_weight = "unit", whose springs have no area'
            raise SceneError("medium", shown(self.medium), allowed)
        if self.nodal_weight is not None and self.method != "node":
            raise SceneError("nodal_weight", shown(self.nodal_weight), 'nothing unless method = "node"')
        if self.augment is not None and self.adhesion is not None and self.adhesion.law in REVERSIBLE:
            raise SceneError("augment", self.augment, f'nothing with law "{self.adhesion.law}"')
        if self.self_contact and self.pairs != "auto":
            raise SceneError("self_contact", "true", 'false, or pairs = "auto"')
        if self.pairs == []:
            raise SceneError("pairs", self.pairs, '"auto" or at least one ["slave", "master"]')
        return self


MOST_STEPS = 100_000  # each is a row of the history, which a checkpoint holds whole


class Load(Keys):
    """[load]: stages, the increments of each, and the factors that rows of the boundaries follow."""

    steps: Annotated[list[Count], Field(min_length=1)] = Field([1], description="increments of each stage")
    factors: dict[Name, list[float]] = Field({}, description="value at the end of each stage; 0 at the start")

    @model_validator(mode="after")
    def _a_value_a_stage(self) -> Self:
        if (total := sum(self.steps)) > MOST_STEPS:
            raise SceneError("steps", f"{total:,} load steps", f"at most {MOST_STEPS:,} in all")
        for name, values in self.factors.items():
            if len(values) != len(self.steps):
                raise SceneError(f"factors.{name}", values, f"{len(self.steps)} number(s), one a stage of load.steps")
        return self


class Solver(Keys):
    """[solver]: optional; the defaults suit nearly every scene."""

    tolerance: Annotated[float, Field(gt=0, lt=1e-2)] = Field(1e-8, description="of the residual, relative")
    max_iterations: Count = Field(25, description="Newton iterations of a step before it is cut")
    max_cutbacks: Annotated[int, Field(ge=0)] = Field(8, description="times that a step is halved before giving up")
    kind: Literal["auto", "direct", "iterative"] = Field("auto", description="linear solver")
    petsc: dict[Name, str | bool | int | float] = Field(
        {},
        description="PETSc options of the solvers: names from snes_, ksp_, pc_, mat_mumps_, values that name no file",
    )

    @model_validator(mode="after")
    def _harmless(self) -> Self:
        try:
            check_petsc_options(self.petsc)
        except SceneError as error:
            raise SceneError(f"petsc.{error.key}".rstrip("."), error.found, error.allowed) from None
        return self


class Output(Keys):
    """[output]: what is written beside history and summary."""

    fields: Literal["none", "end", "all"] = Field("end", description="after which steps fields and contact points are")
    picture: bool = Field(True, description="whether picture.png is drawn at the end")
