"""Fields and contact points of a run by step: kept in memory by a run of this process, or in the files of a folder."""

from __future__ import annotations

from pathlib import Path

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.forms.arrays import Array
from piezomat.results.fields import FieldOutput, contact_points
from piezomat.results.pieces import joined_contact, joined_fields, read_contact, read_fields
from piezomat.results.vtk import ContactPoints, FieldPiece, read_index


class InMemory:
    """Keeps this rank's solution and contact points of each step: some numbers a node, not the fields."""

    def __init__(self) -> None:
        self._problem: Problem | None = None
        self._output: FieldOutput | None = None
        self._solutions: dict[int, Array] = {}
        self._contact: dict[int, ContactPoints] = {}

    @property
    def steps(self) -> list[int]:
        """The steps that were kept."""
        return list(self._solutions)

    def keep(self, problem: Problem, contact: Interfaces | None, step: int) -> None:
        """Keep the present state as the end of a step. Collective."""
        self._problem = problem
        self._solutions[step] = problem.solution().x.array.copy()
        if contact is not None:
            self._contact[step] = contact_points(contact, problem.model)

    def fields(self, step: int) -> FieldPiece | None:
        """The fields of a step, of all ranks. Collective."""
        if self._output is None:
            self._output = FieldOutput(self._problem)
        return joined_fields(self._problem.comm.allgather(self._output.piece(self._solutions[step])))

    def contact(self, step: int) -> ContactPoints | None:
        """The contact points of a step, of all ranks. Collective."""
        points = self._contact.get(step)
        return None if points is None else joined_contact(self._problem.comm.allgather(points))


class InFolder:
    """Reads what a run has written. ResultsError: a file is missing or damaged."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._fields = {entry.step: entry for entry in read_index(directory / "fields.pvd")}
        self._contact = {entry.step: entry for entry in read_index(directory / "contact.pvd")}

    @property
    def steps(self) -> list[int]:
        """The steps in fields.pvd."""
        return list(self._fields)

    def fields(self, step: int) -> FieldPiece | None:
        """The fields of a step, of all ranks."""
        return read_fields(self.directory, self._fields[step])

    def contact(self, step: int) -> ContactPoints | None:
        """The contact points of a step, of all ranks."""
        return read_contact(self.directory, self._contact[step]) if step in self._contact else None
