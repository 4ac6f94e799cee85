"""The columns of the history, each listed once: name, unit, meaning, value.

`GROUPS` has them in the order of the columns. To add a column, add a `Quantity` to the group of its place; its value is
computed from the record of that group (a reaction, the totals of a plane or of a pair, the energies, ...). A script can
append it before the run, such as to `WHOLE`, whose record is the `ConvergedStep`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import Any

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.contact.interface_laws import gap_medium
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array
from piezomat.results.box import box_of, box_state
from piezomat.results.contact_totals import PairTotals, totals_of_pairs, totals_of_planes
from piezomat.results.electrodes import electrode_states
from piezomat.results.energy_balance import EnergyBalance
from piezomat.results.reactions import reaction
from piezomat.results.rigid_boundaries import travels
from piezomat.scene.tables import markdown
from piezomat.solver.capacitance import between
from piezomat.solver.load_steps import Step, StepReport

AXES = ("x", "y", "z")
PLACE, AXIS = "{place}", "{axis}"
# In 2D what is summed over the depth is per um of it.
PER_DEPTH = {"uN": "uN/um", "pC": "pC/um", "pJ": "pJ/um", "um2": "um", "pC/V": "pC/(V um)"}


def augments(model: Model) -> bool:
    """Whether contact is augmented."""
    return model.scene.contact is not None and model.scene.contact.augment is not None


@dataclass(frozen=True)
class Quantity:
    """A column for each place of its group, and for each axis if it is a vector.

    name: with `{place}`, and `{axis}` if it is a vector.
    unit: in 3D; in 2D forces, charges and energies are per um of depth. Empty for a number without unit.
    meaning: one line for the table of columns.
    value: float, int or (d,) from the record of the group.
    applies: whether a model has the column.
    """

    name: str
    unit: str
    meaning: str
    value: Callable[[Any], Any]
    applies: Callable[[Model], bool] = lambda model: True

    def columns(self, dim: int, place: str) -> list[str]:
        """Names of the columns."""
        name = self.name.replace(PLACE, place)
        return [name.replace(AXIS, axis) for axis in AXES[:dim]] if AXIS in name else [name]

    def values(self, record: Any) -> list[float | int]:
        """Values of the columns."""
        value = self.value(record)
        entries = value if AXIS in self.name else [value]
        return [entry if isinstance(entry, int) else float(entry) for entry in entries]


def unit_in(quantity: Quantity, dim: int) -> str:
    """The unit of a quantity in `dim` dimensions."""
    return PER_DEPTH.get(quantity.unit, quantity.unit) if dim == 2 else quantity.unit


@dataclass(frozen=True)
class ConvergedStep:
    """What the values of a row are computed from; `seconds`: wall clock of the step.

    capacitance: computes the matrix of the electrodes, see `piezomat.solver.capacitance`
    """

    problem: Problem
    terms: Terms
    balance: EnergyBalance
    step: Step
    report: StepReport
    seconds: float
    capacitance: Callable[[], Array | None]


@dataclass(frozen=True)
class Group:
    """The quantities of one kind of place.

    symbol: stands for the place in the table of columns; empty where there is only one place.
    places: names of the places of a model and its interfaces, None without any.
    records: the record of each place, in this order. Collective.
    """

    symbol: str
    places: Callable[[Model, Interfaces | None], Sequence[str]]
    records: Callable[[ConvergedStep], Sequence[Any]]
    quantities: list[Quantity]

    def columns(self, model: Model, place: str) -> list[str]:
        """Names of the columns of a place."""
        return [name for q in self._of(model) for name in q.columns(model.dim, place)]

    def values(self, model: Model, record: Any) -> list[float | int]:
        """Values of the columns of a place."""
        return [value for q in self._of(model) for value in q.values(record)]

    def _of(self, model: Model) -> Iterator[Quantity]:
        return (q for q in self.quantities if q.applies(model))


def _one_place(model: Model, contact: Interfaces | None) -> Sequence[str]:
    return ("",)


def _listed_pairs(contact: Interfaces | None) -> Mapping[int, str]:
    return contact.pairs.listed if contact is not None else {}


def _reactions(at: ConvergedStep) -> list[Any]:
    groups = at.problem.model.constraints.groups
    return [reaction(at.problem, conditions, at.step.after) for conditions in groups.values()]


def _planes(at: ConvergedStep) -> list[Any]:
    contact = at.terms.contact
    return totals_of_planes(contact) if contact is not None else []


def _pairs(at: ConvergedStep) -> list[Any]:
    listed = _listed_pairs(at.terms.contact)
    totals = totals_of_pairs(at.terms.contact) if listed else {}
    return [totals.get(number, PairTotals.none(at.problem.model.dim)) for number in listed]


def _box(at: ConvergedStep) -> list[Any]:
    box = box_of(at.problem.model, at.terms.contact)
    return [box_state(at.problem.model, box)] if box is not None else []


def _energies(at: ConvergedStep) -> list[Any]:
    """Energies of the terms by name, with the work of the balance."""
    none = dict.fromkeys(("contact", "adhesion", "dissipated"), 0.0)
    work = {"stabilization": at.balance.stabilization_work, "external_work": at.balance.external_work}
    return [none | at.problem.energies(at.problem.state) | work]


def _electric(model: Model) -> bool:
    return model.electric


STEP = Group(
    "",
    _one_place,
    lambda at: [at.step],
    [
        Quantity("step", "", "number of the load step, from 1", attrgetter("number")),
        Quantity("stage", "", "number of the stage that the step belongs to, from 1", attrgetter("stage")),
    ],
)
FACTOR = Group(
    "NAME",
    lambda model, contact: list(model.scene.load.factors),
    lambda at: [at.step.after[name] for name in at.problem.model.scene.load.factors],
    [Quantity("factor:{place}", "", "value of a load factor", lambda value: value)],
)
BOUNDARY = Group(
    "B",
    lambda model, contact: list(model.constraints.groups),
    _reactions,
    [
        Quantity(
            "force_{axis}@{place}",
            "uN",
            "force that the surroundings exert on the model there: negative `force_y@top` pushes down",
            attrgetter("force"),
        ),
        Quantity("displacement_{axis}@{place}", "um", "mean displacement of the boundary", attrgetter("displacement")),
        Quantity("charge@{place}", "pC", "free charge on the boundary", attrgetter("charge"), _electric),
        Quantity(
            "mean_potential@{place}",
            "V",
            "mean of the potential over the boundary. On a boundary without `potential` this is the mean over an "
            "insulating surface, not the voltage of an electrode",
            attrgetter("mean_potential"),
            _electric,
        ),
    ],
)
RIGID = Group(
    "B",
    lambda model, contact: [r.boundary.on for r in model.constraints.rigid],
    lambda at: travels(at.problem, at.step.after),
    [Quantity("travel@{place}", "um", "how far a rigid boundary has moved along its force", lambda value: value)],
)
FACETS_ACROSS = Quantity(
    "facets_across@{place}",
    "",
    "least number of facets across a place of contact that carries 5 % of the load or more; 0 without any, and on flat "
    "faces",
    attrgetter("facets_across"),
)
MAX_FIELD = Quantity(
    "max_field@{place}",
    "V/um",
    "largest field in an open gap, the potential jump over the gap: in the wedge at a contact it reaches hundreds, "
    "where air would break down",
    attrgetter("max_field"),
    lambda model: gap_medium(model) is not None,
)
PLANE = Group(
    "P",
    lambda model, contact: [plane.name for plane in model.scene.planes],
    _planes,
    [
        Quantity(
            "travel@{place}", "um", "how far the plane has moved along its normal, to the bodies", attrgetter("travel")
        ),
        Quantity("force_{axis}@{place}", "uN", "force that the plane exerts on the bodies", attrgetter("force")),
        Quantity("contact_area@{place}", "um2", "area that touches the plane", attrgetter("area")),
        Quantity("max_pressure@{place}", "MPa", "largest contact pressure", attrgetter("max_pressure")),
        FACETS_ACROSS,
        Quantity(
            "max_penetration@{place}",
            "um",
            "largest penetration of contact points and of nodes",
            attrgetter("max_penetration"),
        ),
        MAX_FIELD,
        Quantity("charge@{place}", "pC", "charge of an electrode", attrgetter("charge"), _electric),
        Quantity(
            "mean_potential@{place}",
            "V",
            "potential of an electrode; of an insulator the mean over the surfaces that touch it, `nan` where nothing "
            "does",
            attrgetter("potential"),
            _electric,
        ),
    ],
)
# Of a recipe's fibers between a floor and a lid.
BOX = Group(
    "",
    lambda model, contact: [""] if box_of(model, contact) is not None else [],
    _box,
    [
        Quantity(
            "strain",
            "",
            "of a recipe's fibers between two planes: change of the planes' distance over that at the start, negative "
            "where they approach",
            attrgetter("strain"),
        ),
        Quantity(
            "stress",
            "MPa",
            "of the same: force of the upper plane over the area of the fibers' box, negative where it presses",
            attrgetter("stress"),
        ),
    ],
)
ELECTRODE = Group(
    "E",
    lambda model, contact: model.electrode_names,
    lambda at: electrode_states(at.problem, at.terms),
    [
        Quantity("voltage@{place}", "V", "potential of an electrode", attrgetter("voltage")),
        Quantity("charge@{place}", "pC", "free charge on an electrode", attrgetter("charge")),
    ],
)
PAIR = Group(
    "C",
    lambda model, contact: list(_listed_pairs(contact).values()),
    _pairs,
    [
        Quantity("contact_force_{axis}@{place}", "uN", "force on the first body of the pair", attrgetter("force")),
        Quantity("contact_area@{place}", "um2", "area where the gap is closed", attrgetter("area")),
        Quantity("max_pressure@{place}", "MPa", "largest contact pressure", attrgetter("max_pressure")),
        FACETS_ACROSS,
        Quantity(
            "max_penetration@{place}",
            "um",
            "largest penetration of contact points and of nodes, an error of the penalty: it should be small",
            attrgetter("max_penetration"),
        ),
        Quantity(
            "max_potential_jump@{place}",
            "V",
            "largest difference of the potentials where bodies touch or stick, an error of the penalty: it should be "
            "small",
            attrgetter("max_potential_jump"),
            _electric,
        ),
        MAX_FIELD,
        Quantity("bonded_area@{place}", "um2", "area where adhesion has not broken", attrgetter("bonded_area")),
    ],
)
ENERGY = Group(
    "",
    _one_place,
    _energies,
    [
        Quantity("elastic", "pJ", "stored elastic energy of the bodies", itemgetter("elastic")),
        Quantity("electric", "pJ", "stored electric energy of bodies and contact", itemgetter("electric")),
        Quantity("contact", "pJ", "energy of the contact penalty", itemgetter("contact")),
        Quantity("adhesion", "pJ", "energy of the bonds", itemgetter("adhesion")),
        Quantity(
            "stabilization",
            "pJ",
            "work of the weak springs on bodies that nothing holds, and energy set free by snap-through",
            itemgetter("stabilization"),
        ),
        Quantity("external_work", "pJ", "work done from outside", itemgetter("external_work")),
        Quantity("dissipated", "pJ", "energy of broken bonds", itemgetter("dissipated")),
    ],
)
# After all that contact's last evaluation holds: this evaluates it anew.
CAPACITANCE = Group(
    "",
    lambda model, contact: [""] if len(model.constraints.electrodes) == 2 else [],
    lambda at: [at.capacitance()] if len(at.problem.model.constraints.electrodes) == 2 else [],
    [Quantity("capacitance", "pC/V", "between the electrodes, of a scene with two", between)],
)
# Of the whole step: its effort, and what a user's script appends.
WHOLE = Group(
    "",
    _one_place,
    lambda at: [at],
    [
        Quantity("newton", "", "Newton iterations", attrgetter("report.newton")),
        Quantity("linear_solves", "", "linear solves with the tangent", attrgetter("report.linear_solves")),
        Quantity("krylov", "", "Krylov iterations, a direct solve counted as one", attrgetter("report.krylov")),
        Quantity("cutbacks", "", "how often the step was cut", attrgetter("report.cutbacks")),
        Quantity("seconds", "s", "wall clock of the step", attrgetter("seconds")),
        Quantity(
            "augmentations",
            "",
            "repetitions with multipliers; with `contact.augment` only",
            attrgetter("report.augmentations"),
            augments,
        ),
    ],
)
GROUPS = (STEP, FACTOR, BOUNDARY, RIGID, PLANE, BOX, ELECTRODE, PAIR, ENERGY, CAPACITANCE, WHOLE)


def columns(model: Model, contact: Interfaces | None) -> list[str]:
    """Names of the history's columns, in order."""
    return [name for g in GROUPS for place in g.places(model, contact) for name in g.columns(model, place)]


def row(
    problem: Problem,
    terms: Terms,
    balance: EnergyBalance,
    step: Step,
    report: StepReport,
    seconds: float,
    capacitance: Callable[[], Array | None],
) -> dict[str, float | int]:
    """Row of the history of a converged step, by column. Collective; the same on all ranks."""
    at, model = ConvergedStep(problem, terms, balance, step, report, seconds, capacitance), problem.model
    values: dict[str, float | int] = {}
    for group in GROUPS:
        for place, record in zip(group.places(model, terms.contact), group.records(at), strict=True):
            values |= zip(group.columns(model, place), group.values(model, record), strict=True)
    return values


def pair_columns(model: Model) -> list[str]:
    """Names of the columns of pairs.csv behind step and pair: those of a pair, without its name."""
    return [name.removesuffix("@") for name in PAIR.columns(model, "")]


def pair_rows(contact: Interfaces, model: Model) -> list[tuple[str, list[float | int]]]:
    """Name and values of each pair of bodies that is in contact, or with charges across a gap. Collective."""
    return [
        (contact.pairs.name(number), PAIR.values(model, totals)) for number, totals in totals_of_pairs(contact).items()
    ]


def columns_table() -> str:
    """The columns as a table in Markdown: name, unit, meaning."""
    rows = [
        (f"`{q.name.replace(PLACE, g.symbol).replace(AXIS, 'x')}`{' ...' if AXIS in q.name else ''}", q.unit, q.meaning)
        for g in GROUPS
        for q in g.quantities
    ]
    return markdown(("column", "unit", "meaning"), rows)
