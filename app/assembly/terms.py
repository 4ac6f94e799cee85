"""The terms of a problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from petsc4py import PETSc

from piezomat.assembly.bulk import Bulk
from piezomat.assembly.circuits import Circuits
from piezomat.assembly.nodal_loads import NodalLoads
from piezomat.assembly.stabilization_stiffness import StabilizationStiffness
from piezomat.assembly.term_check import check_terms
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.discretization.term import AssembledTerm, BlockTerm, Term

NewTerm = Callable[[Model], Term]
# Of every problem beside those below, which nothing else asks for by name.
FURTHER: tuple[NewTerm, ...] = ()


@dataclass(frozen=True)
class Terms:
    """The terms, in the order in which they are summed. By name for results and for the solver's rules.

    contact: None without any
    further: those of `FURTHER` and of a user's script
    """

    bulk: Bulk
    circuits: Circuits
    loads: NodalLoads
    stabilization: StabilizationStiffness
    contact: Interfaces | None
    further: tuple[Term, ...] = ()

    @classmethod
    def of(cls, model: Model, contact: Interfaces | None, further: Sequence[NewTerm] = ()) -> Terms:
        """The terms of a model, and what `further` makes for it. Collective. ValueError: see `check_terms`."""
        own = Bulk(model), Circuits(model), NodalLoads(model), StabilizationStiffness(model), contact
        every = cls(*own, tuple(new(model) for new in (*FURTHER, *further)))
        check_terms(model, [term for term in every.further if isinstance(term, AssembledTerm)], every.new_matrix)
        return every

    def __iter__(self) -> Iterator[Term]:
        named = self.bulk, self.circuits, self.loads, self.stabilization, *self.further, self.contact
        return (term for term in named if term is not None)

    def new_matrix(self) -> PETSc.Mat:
        """A matrix with the places of the assembled tangent."""
        return self.bulk.new_matrix()

    @property
    def assembled(self) -> tuple[AssembledTerm, ...]:
        """Those whose tangent has its places among those of the bulk."""
        return tuple(term for term in self if isinstance(term, AssembledTerm))

    @property
    def blocks(self) -> tuple[BlockTerm, ...]:
        """Those whose tangent has places that change."""
        return tuple(term for term in self if isinstance(term, BlockTerm))
