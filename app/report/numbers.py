"""The numbers of a report, from the history, the summary and the scene of a run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.pictures.curves import driver_of
from piezomat.pictures.data import RunData
from piezomat.results.quantities import PER_DEPTH
from piezomat.scene.data import key_of
from piezomat.scene.scene import Scene

PER_NEWTON = 1e6  # uN
PER_KILOPASCAL = 1e-3  # MPa
ROUNDING = 1e-6  # of the charge that stores the electric energy: less is zero


class Number(NamedTuple):
    """A number of the report: its key in JSON, its name, value, unit, and how it was found."""

    key: str
    name: str
    value: float | int | str
    unit: str = ""
    how: str = ""


class Section(NamedTuple):
    """Numbers under a heading."""

    title: str
    numbers: list[Number]


class Numbers:
    """Finds the numbers of a run; `run` has no fields.

    run: history, names and tables of the scene; summary: that of the run; scene: as it was run; pairs: largest value of
    each column of pairs.csv.
    """

    def __init__(self, run: RunData, summary: dict[str, Any], scene: Scene, pairs: dict[str, float]) -> None:
        self.run, self.summary, self.scene, self.pairs = run, summary, scene, pairs
        self.driver = driver_of(run)
        self.names = list(run.history[0]) if run.history else []
        self.area = (summary.get("recipe") or {}).get("area")

    def sections(self) -> list[Section]:
        """The sections that have numbers."""
        found = [
            Section("Recipe", list(self._recipe())),
            Section("Force and travel", list(self._force())),
            Section("Voltage and charge", list(self._electric())),
            Section("Contact", list(self._contact())),
            Section("Energy", list(self._energy())),
            Section("Effort", list(self._effort())),
        ]
        return [section for section in found if section.numbers]

    # --- what the sections hold

    def _recipe(self) -> Iterator[Number]:
        recipe = self.summary.get("recipe")
        if not recipe:
            return
        yield Number("fibers", "fibers", recipe["fibers"])
        yield Number("crossings", "crossings", recipe["crossings"])
        yield Number("porosity", "porosity", recipe["porosity"])
        yield Number("areal_density", "areal density", recipe["areal_density"], "um", "volume over area, from above")
        box = " x ".join(f"{b - a:.4g}" for a, b in zip(recipe["low"], recipe["high"], strict=True))
        yield Number("box", "box of the fibers", box, "um")
        yield Number("area", "area from above", recipe["area"], "um" if self.run.flat else "um2")

    def _force(self) -> Iterator[Number]:
        if self.driver is None:
            return
        travel, force = self.run.column(self.driver.motion), self.run.column(self.driver.force)
        place, most = self.driver.place, int(np.abs(force).argmax())
        unit = self._per_depth("uN")
        yield Number("force", f"largest force on {place}", force[most], unit, f"step {most + 1}")
        yield Number("travel", f"travel of {place} there", travel[most], "um", self.driver.motion)
        pull = -np.sign(force[most]) * force
        if self.scene.contact is not None and self.scene.contact.adhesion is not None and pull.max() > 0.0:
            at = int(pull.argmax())
            yield Number("pull_off", f"largest pull on {place}", force[at], unit, f"pull-off, step {at + 1}")
        if "strain" in self.names:
            strain, stress = self.run.column("strain"), self.run.column("stress")
            at = int(np.abs(stress).argmax())
            yield Number("stress", "largest stress of the box", stress[at], "MPa", "force of the lid over the area")
            yield Number("strain", "strain of the box there", strain[at])
            if strain[at] != 0.0:
                yield Number("modulus", "secant modulus", stress[at] / strain[at], "MPa", "stress over strain there")
            if at > 0 and strain[at] != strain[at - 1]:
                slope = (stress[at] - stress[at - 1]) / (strain[at] - strain[at - 1])
                yield Number("tangent_modulus", "tangent modulus", slope, "MPa", "over the step that ends there")

    def _electric(self) -> Iterator[Number]:
        force = self.run.column(self.driver.force) if self.driver is not None else None
        for name in self.names:
            kind, _, place = name.partition("@")
            if kind == "voltage" or (kind == "mean_potential" and self._is_driven(place)):
                yield from self._voltage(name, kind, place, force)
        charges = [name for name in self.names if name.startswith("charge@")]
        least = ROUNDING * self._charge_scale()
        for name in charges:
            charge = self.run.column(name)
            at = int(np.abs(charge).argmax())
            if np.abs(charge[at]) <= least:
                continue
            place = name.partition("@")[2]
            yield Number(name, f"largest charge on {place}", charge[at], self._per_depth("pC"), f"step {at + 1}")
        yield from self._d33(charges, force)
        if "capacitance" in self.names:
            values = self.run.column("capacitance")
            yield Number("capacitance", "capacitance", values[-1], self._per_depth("pC/V"), "at the last step")

    def _charge_scale(self) -> float:
        """The charge that stores the electric energy at the largest potential."""
        names = [name for name in self.names if name.startswith(("voltage@", "mean_potential@"))]
        potential = max((float(np.abs(self.run.column(name)).max()) for name in names), default=0.0)
        energy = float(np.abs(self.run.column("electric")).max())
        return 2.0 * energy / potential if potential > 0.0 else 0.0

    def _voltage(self, name: str, kind: str, place: str, force: Array | None) -> Iterator[Number]:
        values = self.run.column(name)
        at = int(np.abs(values).argmax())
        words = "voltage of" if kind == "voltage" else "mean potential of"
        how = f"step {at + 1}" if kind == "voltage" else f"step {at + 1}; of an insulating surface, not of a metal"
        yield Number(name, f"largest {words} {place}", values[at], "V", how)
        if place in self._given() or force is None or np.abs(force).max() == 0.0:
            return
        most = int(np.abs(force).argmax())
        how = "open circuit" if kind == "voltage" else "insulating surface"
        how += ", secant at the largest force"
        yield Number(f"per_force@{place}", f"{words} {place} per force", values[most] / force[most],
                     f"V/({self._per_depth('uN')})" if self.run.flat else "V/uN", how)  # fmt: skip
        if self.area:
            pressure = abs(force[most]) / self.area / PER_KILOPASCAL
            yield Number(f"sensitivity@{place}", f"sensitivity of {place}", values[most] / pressure, "V/kPa", how)

    def _d33(self, charges: list[str], force: Array | None) -> Iterator[Number]:
        """Charge over force where no electrode is open, and no potential changes."""
        if force is None or np.abs(force).max() == 0.0 or not self._is_short_circuit():
            return
        most = int(np.abs(force).argmax())
        name = max(charges, key=lambda name: abs(self.run.column(name)[most]), default=None)
        if name is None or abs(self.run.column(name)[most]) <= ROUNDING * self._charge_scale():
            return
        value = abs(self.run.column(name)[most] / force[most]) * PER_NEWTON
        yield Number("d33", "effective d33", value, "pC/N", f"{name} over {self.driver.force}, step {most + 1}")

    def _contact(self) -> Iterator[Number]:
        pressures = self._largest("max_pressure")
        limits = [getattr(keys, "yield") for keys in self.scene.materials.values() if getattr(keys, "yield")]
        if pressures is not None:
            place, value = pressures
            how = f"{place}; the least yield stress is {min(limits):g} MPa" if limits else place
            yield Number("max_pressure", "largest contact pressure", value, "MPa", how)
            if limits:
                yield Number("pressure_over_yield", "that over the yield stress", value / min(limits))
        depth = self._largest("max_penetration")
        if depth is not None:
            yield Number(
                "max_penetration", "largest penetration", depth[1], "um", f"{depth[0]}; an error of the penalty"
            )
        jump = self._largest("max_potential_jump")
        if jump is not None and jump[1] > 0.0:
            yield Number("max_potential_jump", "largest potential jump", jump[1], "V", jump[0])
        field = self._largest("max_field")
        if field is not None and field[1] > 0.0:
            yield Number("max_field", "largest field in an open gap", field[1], "V/um", field[0])
        across = [
            (float(values[values > 0.0].min()), name.partition("@")[2])
            for name in self.names
            if name.startswith("facets_across@") and (values := self.run.column(name)).max() > 0.0
        ]
        if across:
            least = min(across)
            yield Number("facets_across", "least facets across a contact", least[0], "", f"{least[1]}; ten are fine")

    def _energy(self) -> Iterator[Number]:
        stored = sum(self.run.column(name) for name in ("elastic", "electric", "contact", "adhesion"))
        gone = sum(self.run.column(name) for name in ("dissipated", "stabilization"))
        work = self.run.column("external_work")
        unit = self._per_depth("pJ")
        at = int(np.abs(work).argmax())
        yield Number("external_work", "work from outside", work[at], unit, f"largest, step {at + 1}")
        yield Number("elastic", "elastic energy", self.run.column("elastic")[at], unit, "there")
        yield Number("electric", "electric energy", self.run.column("electric")[at], unit, "there")
        if self.run.column("dissipated")[-1] > 0.0:
            yield Number("dissipated", "dissipated", self.run.column("dissipated")[-1], unit, "at the end, by bonds")
        scale = max(float(np.abs(work).max()), float(np.abs(stored).max()))
        if scale > 0.0:
            missing = float(np.abs(work - stored - gone).max()) / scale
            yield Number(
                "imbalance", "energy that is not accounted for", missing, "", "part of the largest; of the steps' size"
            )

    def _effort(self) -> Iterator[Number]:
        yield Number("steps", "load steps", len(self.run.history))
        for key, name in (("dofs", "unknowns"), ("cells", "cells"), ("ranks", "ranks")):
            if key in self.summary:
                yield Number(key, name, self.summary[key])
        yield Number("newton", "Newton iterations", int(self.run.column("newton").sum()))
        if self.summary.get("timings"):
            yield Number("seconds", "time", self.summary["timings"]["total"], "s")
            yield Number("peak_memory_mb", "memory", self.summary["peak_memory_mb"], "MB", "over all ranks")

    # --- what they share

    def _per_depth(self, unit: str) -> str:
        return PER_DEPTH.get(unit, unit) if self.run.flat else unit

    def _given(self) -> set[str]:
        """Boundaries, planes and electrodes that have a potential."""
        rows = [(row.on, row) for row in self.scene.boundaries]
        rows += [(row.name, row) for row in (*self.scene.planes, *self.scene.electrodes)]
        return {name for name, row in rows if row.potential is not None}

    def _is_driven(self, place: str) -> bool:
        return self.driver is not None and place == self.driver.place and place not in self._given()

    def _is_short_circuit(self) -> bool:
        """Whether at least two places have a potential, none changes it, and no electrode is open."""
        rows = [*self.scene.boundaries, *self.scene.planes, *self.scene.electrodes]
        given = [row for row in rows if row.potential is not None]
        follows = [getattr(row, "potential_follows", getattr(row, "follows", None)) for row in given if row.potential]
        is_open = any(row.potential is None for row in self.scene.electrodes)
        return len(given) > 1 and not is_open and not any(follows)

    def _largest(self, kind: str) -> tuple[str, float] | None:
        """Place and largest value of the columns of a kind, pairs.csv included."""
        found = [(float(self.run.column(n).max()), n.partition("@")[2]) for n in self.names if n.startswith(f"{kind}@")]
        if kind in self.pairs:
            found.append((self.pairs[kind], "pairs.csv"))
        if not found:
            return None
        value, place = max(found)
        return place, value


def model_lines(scene: Scene) -> list[str]:
    """What was modelled, in a few lines."""
    plane = f", plane {scene.model.plane}" if scene.dimension == 2 else ""
    shape = getattr(scene.geometry, "shape", None) or f"mesh {getattr(scene.geometry, 'file', '')}"
    lines = [f"{scene.dimension}D{plane}, {scene.model.kinematics} kinematics; {shape}, order {scene.mesh.order}"]
    materials: dict[str, int] = {}
    for body in scene.body_names:
        name = scene.bodies[key_of(body, scene.bodies)]
        materials[name] = materials.get(name, 0) + 1
    lines.append("bodies: " + ", ".join(f"{count} of {name}" for name, count in materials.items()))
    if scene.contact is not None:
        adhesion = scene.contact.adhesion
        glue = f", adhesion {adhesion.law} of {adhesion.strength:g} MPa" if adhesion is not None else ", no adhesion"
        lines.append(f"contact: {scene.contact.method}, {scene.contact.passes} passes{glue}")
    given = [f"{row.on} {row.potential:g} V" for row in scene.boundaries if row.potential is not None]
    given += [
        f"{row.name} {'open' if row.potential is None else f'{row.potential:g} V'}"
        for row in (*(p for p in scene.planes if p.potential is not None), *scene.electrodes)
    ]
    if given:
        lines.append("electrodes: " + ", ".join(given))
    factors = [f"{name} {[float(f'{v:g}') for v in values]}" for name, values in scene.load.factors.items()]
    lines.append("; ".join([f"load: {sum(scene.load.steps)} steps", *factors]))
    return lines
