"""Reads the results of a run with pyvista and matplotlib alone, prints a few numbers and draws one picture.

    scripts/run fibers_2d                                            any scene, whose output.fields is not "none"
    .venv/bin/python scripts/read_results.py results/fibers_2d       writes results/fibers_2d/read_results.png
    .venv/bin/python scripts/read_results.py results/fibers_2d --step 44

Copy and change it: it needs nothing of piezomat, and shows where each result is found.

- history.csv has a row a load step. Column `contact_force_z@lower-upper` is the force on "lower" in uN (2D: uN a um of
  depth), `mean_potential@top` a potential in V, `factor:press` a load factor.
- fields.pvd names the files of all steps and of all ranks. In them, at the points: displacement (um), potential (V); in
  the cells: stress (MPa, order 11 22 33 23 13 12), electric_field (V/um), electric_displacement (pC/um2), body. The
  electric quantities exist only if a material of the scene has a permittivity.
- contact.pvd does so for the contact points, at their places in the deformed state: gap (um), pressure (MPa), normal,
  potential_jump (V), status (0 apart, 1 touching, 2 bonded, 3 broken), pair.

The step shown is the last one with fields, or the one with the largest contact force if nothing touches in the end.

The picture: the bodies where they have moved to, coloured by the strength of the electric field (where nothing is
electric, by the stress along the last axis), on them the points that touch, and the energy over the load steps.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import matplotlib
import numpy as np
import pyvista
from vtkmodules.vtkCommonCore import vtkLogger

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import MaxNLocator


def read_history(path: Path) -> dict[str, np.ndarray]:
    """The columns of history.csv."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def steps_with_fields(path: Path) -> list[int]:
    """The load steps that a .pvd file names: a step's time is its number."""
    return [round(time) for time in pyvista.PVDReader(str(path)).time_values]


def read_step(path: Path, step: int) -> list[pyvista.DataSet]:
    """What each rank wrote of a step, from a .pvd file."""
    reader = pyvista.PVDReader(str(path))
    reader.set_active_time_value(float(step))
    return [part for part in reader.read() if part.n_points]


def telling_step(history: dict[str, np.ndarray], steps: list[int]) -> int:
    """The last of the steps, or where no contact force is left then, the one with the largest."""
    rows = [int(np.flatnonzero(history["step"] == step)[0]) for step in steps]
    forces = [np.abs(values[rows]) for name, values in history.items() if name.startswith("contact_force_")]
    if not forces:
        return steps[-1]
    force = np.max(forces, axis=0)
    return steps[-1] if force[-1] > 1e-6 * force.max() else steps[int(force.argmax())]


def print_numbers(history: dict[str, np.ndarray], step: int, bodies: list, contact: list) -> None:
    """A few numbers of the run and of the step that is shown."""
    print(f"{len(history['step'])} load steps")
    for name, values in history.items():
        if name.startswith(("contact_force_", "max_pressure@", "max_potential_jump@", "mean_potential@")):
            at = int(np.argmax(np.abs(values)))
            print(f"  {name:40s} last {values[-1]:12.5g}   largest {values[at]:12.5g} in step {history['step'][at]:g}")
    print(f"step {step}")
    moved = max(float(np.linalg.norm(part["displacement"], axis=1).max()) for part in bodies)
    print(f"  largest displacement {moved:.5g} um")
    if all("potential" in part.point_data for part in bodies):
        low = min(float(part["potential"].min()) for part in bodies)
        high = max(float(part["potential"].max()) for part in bodies)
        print(f"  potential from {low:.5g} V to {high:.5g} V")
    for number in range(max(int(part["body"].max()) for part in bodies) + 1):
        volume, stress = 0.0, np.zeros(6)
        for part in bodies:
            mine = part["body"] == number
            sizes = part.compute_cell_sizes(length=False)
            size = np.abs(sizes["Volume"] + sizes["Area"])[mine]
            volume += size.sum()
            stress += size @ part["stress"][mine]
        print(f"  body {number}: mean stress (MPa) " + " ".join(f"{s:.4g}" for s in stress / volume))
    if contact:
        status = np.concatenate([part["status"] for part in contact])
        names = ("apart", "touching", "bonded", "broken")
        counts = zip(np.bincount(status, minlength=4), names, strict=True)
        print("  contact points: " + ", ".join(f"{count} {name}" for count, name in counts))


def image_of(bodies: list[pyvista.DataSet], contact: list[pyvista.DataSet]) -> tuple[np.ndarray, str, tuple]:
    """The deformed bodies as an image, what colours them, and its smallest and largest value."""
    deformed = [part.warp_by_vector("displacement") for part in bodies]
    flat = all(np.ptp(part.points[:, 2]) == 0 for part in bodies)
    electric = all("electric_field" in part.cell_data for part in bodies)
    for part in deformed:
        axis = 1 if flat else 2
        field = part["electric_field"] if electric else part["stress"][:, [axis]]
        part["shown"] = np.linalg.norm(field, axis=1) if electric else field[:, 0]
    label = "electric field (V/um)" if electric else f"stress {'22' if flat else '33'} (MPa)"
    values = np.concatenate([part["shown"] for part in deformed])
    limits = tuple(np.percentile(values, (0.5, 99.5)))  # corners are singular
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 1000))
    plotter.set_background("white")
    for part in deformed:
        plotter.add_mesh(part, scalars="shown", clim=limits, cmap="viridis", show_scalar_bar=False)
    for part in contact:
        closed = np.isin(part["status"], (1, 2))
        if closed.any():
            plotter.add_points(part.points[closed], color="#c2410c", point_size=4)
    if flat:
        plotter.view_xy()
    else:
        plotter.view_vector((1.0, -1.7, 0.9), (0.0, 0.0, 1.0))
    plotter.enable_parallel_projection()
    plotter.camera.zoom(1.3)
    return plotter.screenshot(return_img=True), label, limits


def main() -> None:
    """Read, print, draw."""
    parser = argparse.ArgumentParser(description="Reads the results of a run, prints numbers, draws a picture.")
    parser.add_argument("results", type=Path, help="the folder of the run")
    parser.add_argument("--step", type=int, help="the load step to show (default: see above)")
    parser.add_argument("--out", type=Path, help="the picture (default: read_results.png in that folder)")
    arguments = parser.parse_args()
    folder = arguments.results
    for name in ("history.csv", "fields.pvd"):
        if not (folder / name).is_file():
            parser.error(f'{folder} has no {name}: give the folder of a run whose output.fields is not "none"')

    history = read_history(folder / "history.csv")
    steps = steps_with_fields(folder / "fields.pvd")
    step = telling_step(history, steps) if arguments.step is None else arguments.step
    if step not in steps:
        parser.error(f"no fields of step {step}; there are those of {', '.join(map(str, steps))}")
    bodies = read_step(folder / "fields.pvd", step)
    contact = read_step(folder / "contact.pvd", step) if (folder / "contact.pvd").is_file() else []
    print_numbers(history, step, bodies, contact)

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # VTK warns that there is no screen; it needs none
    image, label, limits = image_of(bodies, contact)
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5.5), layout="constrained")
    left.imshow(image)
    left.set_axis_off()
    left.set_title(f"Deformed bodies in step {step}" + ("; red: where they touch" if contact else ""))
    colours = plt.cm.ScalarMappable(plt.Normalize(*limits), "viridis")
    figure.colorbar(colours, ax=left, label=label)
    for name in ("elastic", "electric", "contact", "adhesion", "external_work", "dissipated"):
        if np.abs(history.get(name, np.zeros(1))).max() > 0:
            right.plot(history["step"], history[name], "o-", markersize=4, label=name.replace("_", " "))
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    right.set_xlabel("load step")
    right.set_ylabel("energy (pJ; pJ/um in 2D)")
    right.set_title("Energy over the load steps")
    if right.lines:
        right.legend()
    right.grid(True, alpha=0.3)
    out = arguments.out or folder / "read_results.png"
    figure.savefig(out, dpi=150)
    print(f"picture: {out}")


if __name__ == "__main__":
    main()
