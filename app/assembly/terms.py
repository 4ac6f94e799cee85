"""The terms of a problem other than contact."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from piezomat.assembly.bulk import Bulk
from piezomat.assembly.circuits import Circuits
from piezomat.assembly.nodal_loads import NodalLoads
from piezomat.assembly.stabilization_stiffness import StabilizationStiffness
from piezomat.discretization.model import Model
from piezomat.discretization.term import AssembledTerm

NewTerm = Callable[[Model], AssembledTerm]
# Of every problem beside those below, which nothing else asks for by name.
FURTHER: tuple[NewTerm, ...] = ()


@dataclass(frozen=True)
class Terms:
    """The assembled terms, in the order in which they are summed. By name for results and for the solver's rules.

    further: those of `FURTHER` and of a user's script
    """

    bulk: Bulk
    circuits: Circuits
    loads: NodalLoads
    stabilization: StabilizationStiffness
    further: tuple[AssembledTerm, ...] = ()

    @classmethod
    def of(cls, model: Model, further: tuple[NewTerm, ...] = ()) -> Terms:
        """The terms of a model. Collective."""
        own = Bulk(model), Circuits(model), NodalLoads(model), StabilizationStiffness(model)
        return cls(*own, tuple(new(model) for new in (*FURTHER, *further)))

    def __iter__(self) -> Iterator[AssembledTerm]:
        return iter((self.bulk, self.circuits, self.loads, self.stabilization, *self.further))
