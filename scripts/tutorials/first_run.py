"""First run: two fibers in 2D, pressed together and pulled apart. Cells for Jupyter, VS Code or Spyder, or a script.

Displacement u and potential phi make the enthalpy of two PVDF half discs stationary, with contact and adhesion between
them (app/scenes/crossed_fibers.toml has the equations). Each flat face is an electrode, the lower
one grounded, the upper one open.

    .venv/bin/python scripts/tutorials/first_run.py
"""

# %% Run a shipped scene, on a coarser mesh than its own. Any key of the scene file can be overridden.
import matplotlib

matplotlib.use("Agg")  # a notebook leaves this line out
import piezomat as pz

coarse = {"mesh.size": 0.12, "mesh.contact_size": 0.02, "load.steps": [5, 8]}
r = pz.run("fibers_2d", coarse)
print(r)

# %% The history: a row for each load step. With pandas a DataFrame, else a dict of arrays.
table = r.frame()
for name in ("force_y@top", "displacement_y@top", "voltage@top"):
    print(f"{name:20} {r.unit(name):6} {[float(f'{value:.3g}') for value in table[name]]}")

# %% The adhesion loop: force over displacement. It is negative under pressure, and positive where adhesion pulls.
ax = r.plot("force_y@top", x="displacement_y@top")
ax.figure.savefig("force_over_displacement.png")
pull_off = max(r.column("force_y@top"))
print(f"pull-off {pull_off:.2f} {r.unit('force_y@top')}")
assert 2.0 < pull_off < 4.2  # below JKR's 4.18: see app/scenes/fibers_2d.toml

# %% Fields at the end of a step, as a pyvista grid. Step 5 presses most.
grid = r.grid(5)
print(grid.array_names, "bodies:", list(grid.field_data["body_names"]))
print(f"potential up to {grid['potential'].max():.2f} V, von Mises stress up to {grid['von_mises'].max():.0f} MPa")

# %% What the run itself says, and how large it was.
print(r.summary["dofs"], "unknowns;", "; ".join(r.warnings) or "no warnings")
