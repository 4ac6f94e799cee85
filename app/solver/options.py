"""PETSc options of one solver: given to PETSc under a prefix of its own, taken back, and asked for after its set-up."""

from __future__ import annotations

import ctypes
import itertools
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import petsc4py.PETSc
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.scene.errors import SceneError, named, shown
from piezomat.solver.outcome import LibraryError

_library = ctypes.CDLL(petsc4py.PETSc.__file__)  # PETSc itself is linked to it
_prefixes = (f"piezomat{number}_" for number in itertools.count())  # one run's options are not the next one's
OUT_OF_MEMORY = 55  # PETSC_ERR_MEM
# Options that nothing reads before the solve that they print.
_PRINTED = re.compile("view|monitor|reason|print")


class SolverOptions:
    """Options `own` of a solver and those `chosen` by the scene, which come first.

    prefix: of their names in PETSc's database, for the solver.
    """

    def __init__(self, own: dict[str, Any], chosen: dict[str, Any]) -> None:
        self.prefix = next(_prefixes)
        self._chosen = chosen
        self._all = {self.prefix + name: value for name, value in {**_kept(own, chosen), **chosen}.items()}
        database = PETSc.Options()
        for name, value in self._all.items():
            database[name] = value

    def remove(self) -> None:
        """Take them out of PETSc's database, which holds 512 at most. Not collective; ends their use."""
        database = PETSc.Options()
        for name in self._all:
            database.delValue(name)

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Context in which an error of PETSc is one of the scene's options, if it has any; else see `given_up`."""
        try:
            yield
        except PETSc.Error as error:
            self.remove()
            if not self._chosen:
                raise given_up(error) from error
            allowed = f"options that PETSc takes; it says: {reason(error)}"
            raise SceneError("solver.petsc", shown(self._chosen), allowed) from None

    def check_used(self, comm: MPI.Comm, prefixes: tuple[str, ...]) -> None:
        """Raise SceneError if PETSc has used none of the scene's options of a name on any rank. Collective."""
        asked = [name for name in self._chosen if name.startswith(prefixes) and not _PRINTED.search(name)]
        used = set().union(*comm.allgather([name for name in asked if self._is_used(name)]))
        unused = [name for name in asked if name not in used]
        if unused:
            self.remove()
            allowed = "options that the solvers of this scene use (solver.kind is another solver)"
            raise SceneError(f"solver.petsc.{unused[0]}", f"options that nothing uses: {named(unused)}", allowed)

    def _is_used(self, name: str) -> bool:
        used = ctypes.c_int()
        _library.PetscOptionsUsed(None, (self.prefix + name).encode(), ctypes.byref(used))
        return bool(used.value)


def _kept(own: dict[str, Any], chosen: dict[str, Any]) -> dict[str, Any]:
    """Those of our options that go with the choice: none of multigrid's where another preconditioner is chosen.

    Since 3.22 PETSc refuses `pc_mg_levels` for "gamg".
    """
    other = [name for name in chosen if name.endswith("pc_type") and chosen[name] != own.get(name, chosen[name])]
    gone = tuple(name.removesuffix("pc_type") + start for name in other for start in ("pc_mg_", "mg_"))
    return {name: value for name, value in own.items() if not gone or not name.startswith(gone)}


def given_up(error: PETSc.Error) -> Exception:
    """The error to raise in place of one of PETSc: with its last words, without the list of its functions."""
    if error.ierr == OUT_OF_MEMORY:
        return MemoryError("there is not enough memory")
    return LibraryError(f"PETSc gave up (its error {error.ierr}): {reason(error)}; another solver.kind may do")


def reason(error: PETSc.Error) -> str:
    """What PETSc says last about an error, on one line."""
    last = str(error).strip().splitlines()[-1]
    return " ".join(re.sub(r"^\[\d+\]", "", last).split())
