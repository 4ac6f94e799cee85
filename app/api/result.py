"""The result of a run: its history as a table, its fields as pyvista grids, plots; of this process or of a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from piezomat.results.units import symbols, unit_of
from piezomat.results.vtk import ContactPoints, FieldPiece


class Stored(Protocol):
    """Fields and contact points by step, in memory or in files."""

    @property
    def steps(self) -> list[int]:
        """The steps that have fields."""

    def fields(self, step: int) -> FieldPiece | None:
        """The fields of a step, of all ranks; None without cells."""

    def contact(self, step: int) -> ContactPoints | None:
        """The contact points of a step, of all ranks; None without any."""


class Result:
    """What a run has found.

    title; history: a dict for each load step, by column; summary: sizes, timings, warnings, what `summary.json` holds.
    out: the folder of the results, None without. dim: 2 or 3. finished: the `piezomat.simulation.Run` with model and
    state, None where the run was read from its folder.
    """

    def __init__(
        self,
        history: list[dict[str, Any]],
        summary: dict[str, Any],
        stored: Stored,
        *,
        dim: int,
        out: Path | None = None,
        finished: Any = None,
    ) -> None:
        self.title = str(summary.get("title", ""))
        self.history = history
        self.summary = summary
        self.dim = dim
        self.out = out
        self.finished = finished
        self._stored = stored

    @property
    def converged(self) -> bool:
        """Whether all load steps have converged."""
        return bool(self.summary.get("converged"))

    @property
    def warnings(self) -> list[str]:
        """Doubts about the results, one sentence each."""
        return list(self.summary.get("warnings") or [])

    @property
    def columns(self) -> list[str]:
        """Names of the history's columns."""
        return list(self.history[0]) if self.history else []

    @property
    def steps(self) -> list[int]:
        """The steps that have fields."""
        return self._stored.steps

    def column(self, name: str) -> np.ndarray:
        """A column of the history (steps,). KeyError: there is none of this name."""
        if name not in self.columns:
            raise KeyError(f"there is no column {name!r}; there are {', '.join(self.columns)}")
        return np.array([row[name] for row in self.history])

    def unit(self, name: str) -> str:
        """The unit of a column; empty for numbers without one."""
        return unit_of(name, self.dim)

    def frame(self) -> Any:
        """The history as a pandas DataFrame with a row for each step; without pandas a dict of arrays by column."""
        return table(self.history)

    def grid(self, step: int | None = None) -> Any:
        """The bodies at the end of a step (default: the last one that has fields) as a pyvista UnstructuredGrid.

        At the points, without load: displacement (um), potential (V). In the cells: stress and strain (xx yy zz yz xz
        xy, MPa), von_mises, electric_field (V/um), electric_displacement (pC/um2), poling (a unit vector), body: its
        number in the field data `body_names`. Under mpirun collective, and the same on all ranks. KeyError: the step
        has no fields.
        """
        piece = self._stored.fields(self._known(step))
        if piece is None:
            raise KeyError(f"step {step} has no cells")
        return piece.vtk()

    def contact(self, step: int | None = None) -> Any:
        """The contact points at the end of a step as a pyvista PolyData, in current positions.

        gap (um), pressure (MPa), normal, potential_jump (V), status (place in the field data `status_names`), pair (its
        number and name in `pair_numbers`, `pair_names`). Under mpirun collective. KeyError: the step has no fields.
        """
        import pyvista

        points = self._stored.contact(self._known(step))
        return points.vtk() if points is not None else pyvista.PolyData()

    def plot(self, y: str | Sequence[str], x: str = "step", ax: Any = None, **style: Any) -> Any:
        """Columns of the history over another one, on new matplotlib axes or on `ax`; the axes.

        style: of the lines, as for matplotlib's `plot`. KeyError: there is no such column.
        """
        names = [y] if isinstance(y, str) else list(y)
        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.subplots(layout="constrained")[1]
        for name in names:
            label = style.get("label", name)
            ax.plot(self.column(x), self.column(name), **({"marker": "o", "markersize": 4} | style | {"label": label}))
        ax.set_xlabel(self._axis(x))
        units = dict.fromkeys(symbols(self.unit(name)) for name in names)
        ax.set_ylabel(self._axis(names[0]) if len(names) == 1 else f"({', '.join(filter(None, units))})")
        if len(names) > 1:
            ax.legend()
        return ax

    def __repr__(self) -> str:
        end = "converged" if self.converged else "not converged"
        where = f", in {self.out}" if self.out is not None else ""
        size = f", {self.summary['dofs']:,} unknowns" if self.summary.get("dofs") else ""
        return f"<Result {self.title!r}: {len(self.history)} steps, {end}{size}{where}>"

    def _axis(self, name: str) -> str:
        unit = symbols(self.unit(name))
        name = name.replace("$", r"\$")
        return f"{name} ({unit})" if unit else name

    def _known(self, step: int | None) -> int:
        steps = self._stored.steps
        if step is None and steps:
            return steps[-1]
        if step in steps:
            return step
        which = f"steps {', '.join(map(str, steps))}" if steps else "none"
        raise KeyError(f'there are no fields of step {step}, but of {which} (output.fields = "all" keeps each step)')


def table(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Rows as a pandas DataFrame; without pandas as a dict of numpy arrays by column."""
    try:
        import pandas
    except ImportError:
        names = list(dict.fromkeys(name for row in rows for name in row))
        return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
    return pandas.DataFrame(list(rows))
