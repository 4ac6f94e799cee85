"""Doubts about the results of a run, one sentence each, once: what its steps show that a reader might not see."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from piezomat.assembly.problem import Problem
from piezomat.contact.facets_across import Across, facets_across
from piezomat.contact.interfaces import Interfaces
from piezomat.contact.unseen_penetration import new_warnings
from piezomat.contact.untouched_bodies import contact_forces, unconstrained_parts, untouched_bodies
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel
from piezomat.meshes.gmsh_io.mesh_file import MeshFile
from piezomat.results.vtk import FieldPiece
from piezomat.scene.errors import named, shown

LARGE_STRAIN = 0.1  # beyond which small kinematics are off by as much
SMALL_FORCE = 0.05  # of the largest on a body: less is that of a loose fiber on its way to the next
UNBALANCED = 0.5  # of the magnitudes of the contact forces on a body
FEW_FACETS = 6  # across a contact: with fewer the pressure has no shape
ZERO = 1e-6  # of the largest potential in the bodies


class RunDoubts:
    """Looks at each step that has converged, and at the end at all of them. Collective."""

    def __init__(self, problem: Problem, contact: Interfaces | None) -> None:
        self.problem = problem
        self.contact = contact
        model = problem.model
        self._touched: set[int] = set()
        self._unseen: set[str] = set()
        self._across: dict[int, Across] = {}  # of each pair and plane, in the step in which it bears most
        bodies = len(model.bodies.bodies)
        self._most, self._unbalanced = np.zeros(bodies), np.zeros(bodies)
        self._said: set[str] = set()
        self._largest_potential = 0.0
        self._small = model.kinematics == "small" and any(law.is_linear for law in model.materials)
        scene = model.scene
        materials = [scene.material_name(name) for name in model.bodies.bodies]
        limits = [getattr(scene.materials.get(name), "yield", None) for name in materials]
        self._yield = np.array([np.inf if limit is None else limit for limit in limits])

    def step(self, number: int, fields: Callable[[], FieldPiece]) -> list[str]:
        """The new doubts at the end of a step.

        fields: computes this rank's fields of the present state; called only where a doubt needs them.
        """
        found: list[str] = []
        model, contact = self.problem.model, self.contact
        if contact is not None:
            self._touched |= contact.touching_bodies()
            self._compare_forces()
            for pair, across in facets_across(contact).items():
                self._across[pair] = max(across, self._across.get(pair, across), key=lambda a: a.force)
            found += new_warnings(contact, self._unseen)
        if model.electric:
            potential = self.problem.solution().x.array.reshape(-1, model.unknowns.block)[:, model.dim]
            here = np.array([model.potential_scale * np.abs(potential).max(initial=0.0)])
            self._largest_potential = max(self._largest_potential, float(parallel.largest(model.comm, here)[0]))
        if self._looks_at_strain or self._looks_at_yield:
            found += self._of_fields(fields(), number)
        return found

    def end(self, history: list[dict[str, Any]]) -> list[str]:
        """The doubts about the run as a whole."""
        if not history:
            return []
        found = []
        model = self.problem.model
        untouched = untouched_bodies(model, self._touched) if self.contact is not None else []
        if untouched:
            found.append(f"held by weak springs alone, these bodies never touched anything: {named(untouched)}")
        drifting = self._drifting()
        if drifting:
            found.append(f"nothing but weak springs holds {_bodies(drifting)} against what presses on one side")
        coarse = self._coarse()
        if coarse is not None:
            found.append(coarse)
        zero = self._zero_voltages(history)
        if zero:
            found.append(
                f"the voltage of {named([shown(name) for name in zero])} is zero but for rounding, while potentials in "
                f"the bodies reach {self._largest_potential:.2g} V: by symmetry? Poling across the load gives none"
            )
        return found

    def _coarse(self) -> str | None:
        """The contact with the fewest facets across, if they are too few, and what to change."""
        if not self._across:
            return None
        number = min(self._across, key=lambda number: self._across[number].facets)
        least, scene = self._across[number].facets, self.problem.model.scene
        if least >= FEW_FACETS or getattr(scene.geometry, "divisions", None) is not None:
            return None
        few = sum(across.facets < FEW_FACETS for across in self._across.values())
        others = f", and {few - 1} other{'s' if few > 2 else ''} less than {FEW_FACETS}" if few > 1 else ""
        size = "make the facets of the mesh there smaller"
        if not isinstance(scene.geometry, MeshFile):
            size = f"lower mesh.contact_size to {rounded_down(scene.sizes.contact_size * least / FEW_FACETS)}"
        name = shown(self.contact.pairs.result_name(number))
        wide = f"{least:.2g} facet{'s' * (least > 1.05)} wide{others}"
        return (
            f"the contact {name} is {wide}: its largest pressure and the voltage are those of the mesh; {size} for "
            f"{FEW_FACETS} facets"
        )

    def _compare_forces(self) -> None:
        """Keep how far from balance the contact forces on each body are where they are largest."""
        net, gross = contact_forces(self.problem.model, self.contact)
        larger = gross > self._most
        self._most[larger] = gross[larger]
        self._unbalanced[larger] = np.linalg.norm(net[larger], axis=1) / gross[larger]

    def _drifting(self) -> list[str]:
        """Bodies that nothing holds, on which forces as large as others act from one side."""
        model = self.problem.model
        rows = model.scene.boundaries
        loaded = {row.on for row in rows if (row.traction, row.pressure, row.force) != (None, None, None)}
        if loaded:  # a load may be what presses a body against another
            return []
        names = model.bodies.bodies
        parts = [part for part in unconstrained_parts(model) if len(part) == 1]
        least = SMALL_FORCE * self._most.max(initial=0.0)
        return [names[b] for (b,) in parts if self._most[b] > least and self._unbalanced[b] > UNBALANCED]

    @property
    def _looks_at_strain(self) -> bool:
        return self._small and "strain" not in self._said

    @property
    def _looks_at_yield(self) -> bool:
        return bool(np.isfinite(self._yield).any()) and "yield" not in self._said

    def _of_fields(self, piece: FieldPiece, number: int) -> list[str]:
        names = self.problem.model.bodies.bodies
        found = []
        if self._looks_at_strain:
            largest = self._largest_by_body(largest_strain(piece.strain), piece)
            body = int(largest.argmax())
            if largest[body] > LARGE_STRAIN:
                self._said.add("strain")
                found.append(
                    f"strains reach {largest[body]:.2g} in body {shown(names[body])} in step {number}, where "
                    'model.kinematics = "small" is no longer accurate'
                )
        if self._looks_at_yield:
            pressure = np.maximum(-piece.stress[:, :3].min(axis=1, initial=np.inf), piece.von_mises)
            largest = self._largest_by_body(pressure, piece)
            over = largest / self._yield
            body = int(over.argmax())
            if over[body] > 1.0:
                self._said.add("yield")
                found.append(
                    f"stresses reach {largest[body]:.3g} MPa in body {shown(names[body])} in step {number}, beyond the "
                    f"yield stress of {self._yield[body]:g} MPa: no plasticity is modelled"
                )
        return found

    def _largest_by_body(self, values: Array, piece: FieldPiece) -> Array:
        """Largest of the cells' values in each body, on all ranks."""
        largest = np.zeros(len(self.problem.model.bodies.bodies))
        np.maximum.at(largest, piece.body, values)
        return parallel.largest(self.problem.comm, largest)

    def _zero_voltages(self, history: list[dict[str, Any]]) -> list[str]:
        """Boundaries without a potential, and open electrodes, whose voltages are all rounding."""
        model = self.problem.model
        if not model.electric or self._largest_potential == 0.0 or not any(m.is_piezoelectric for m in model.materials):
            return []
        given = {row.on for row in model.scene.boundaries if row.potential is not None}
        given |= {row.name for row in model.scene.electrodes if row.potential is not None}
        columns = {
            name.partition("@")[2]: name for name in history[0] if name.startswith(("mean_potential@", "voltage@"))
        }
        places = {row.on for row in model.scene.boundaries if row.charge_density is None}
        places |= {row.name for row in model.scene.electrodes if row.charge is None}
        electrode_groups = {g for row in model.scene.electrodes for g in model.scene.members(row).facet_groups}
        return [
            place
            for place, name in columns.items()
            if place in places - given - electrode_groups
            # exactly zero: the place is on a body without potential
            and 0.0 < max(abs(row[name]) for row in history) < ZERO * self._largest_potential
        ]


def largest_strain(strain: Array) -> Array:
    """The largest principal strain by its size (m,) of strains (m, 6) with engineering shears."""
    tensors = np.zeros((len(strain), 3, 3))
    for place, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))):
        tensors[:, i, j] = tensors[:, j, i] = strain[:, place] * (1.0 if place < 3 else 0.5)
    norm = np.sqrt((tensors**2).sum(axis=(1, 2)))  # a bound: principal strains of most cells are not needed
    values = np.minimum(norm, LARGE_STRAIN)
    large = np.flatnonzero(norm > LARGE_STRAIN)
    if len(large):
        values[large] = np.abs(np.linalg.eigvalsh(tensors[large])).max(axis=1)
    return values


def _bodies(names: list[str]) -> str:
    return f"bod{'ies' if len(names) > 1 else 'y'} {named([shown(name) for name in names])}"


def rounded_down(value: float) -> str:
    """A positive number as text of two digits, at most the number itself."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.floor(value / unit + 1e-9) * unit:.2g}"
