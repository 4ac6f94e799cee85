"""Fields with pyvista: parts, slices, lines, a picture of one's own.

.venv/bin/python scripts/tutorials/pyvista_fields.py
"""

# %% A run in 3D, small enough for a tutorial. pz.open("DIR") gives the same of a finished one.
import numpy as np
import pyvista as pv

import piezomat as pz

small = {"mesh.size": 0.4, "mesh.contact_size": 0.12, "load.steps": [2, 1], "load.factors.press": [0.5, 0.25]}
r = pz.run("crossed_fibers", small, quiet=True)
grid, contact = r.grid(2), r.contact(2)

# %% Bodies by name, components by name.
number = {name: i for i, name in enumerate(grid.field_data["body_names"])}
upper = grid.threshold([number["upper"]] * 2, scalars="body")
stress = grid.GetCellData().GetArray("stress")
component = [stress.GetComponentName(i) for i in range(6)]
print("upper body:", upper.n_cells, "cells; stress components", component)
print("most negative zz:", grid.cell_data["stress"][:, component.index("zz")].min().round(1), "MPa")

# %% A boundary by name: bit i of `places` belongs to `place_names[i]`.
names = list(grid.field_data["place_names"])
top = (grid["places"] >> names.index("top")) & 1 == 1
print(
    f"the top moves by {grid['displacement'][top, 2].mean():.4f} um,",
    f"its potential is {grid['potential'][top].mean():.3f} V",
)
assert np.allclose(grid["potential"][top], r.column("voltage@top")[1])  # an electrode has one potential

# %% A slice of the deformed bodies, and the potential along a line.
deformed = grid.warp_by_vector("displacement")
cut = deformed.slice(normal="y", origin=(0.0, 1e-4, 0.0))
line = deformed.sample_over_line((0.0, 1e-3, -0.45), (0.0, 1e-3, 0.45), resolution=50)
inside = line["vtkValidPointMask"].astype(bool)
print("potential along z:", line["potential"][inside][::10].round(3), "V")

# %% Contact points: where they touch, and how hard.
touching = contact["status"] == list(contact.field_data["status_names"]).index("touching")
print(f"{touching.sum()} of {contact.n_points} points touch, up to {contact['pressure'].max():.0f} MPa")
assert touching.any()

# %% A picture. Off screen here; in a notebook plotter.show() is interactive.
plotter = pv.Plotter(off_screen=True, window_size=(900, 700))
plotter.add_mesh(cut, scalars="potential", cmap="viridis", scalar_bar_args={"title": "potential (V)"})
plotter.add_mesh(deformed.extract_feature_edges(35.0), color="black", line_width=1)
plotter.add_points(contact.points[touching], color="#E69F00", point_size=9, render_points_as_spheres=True)
plotter.view_xz()
plotter.screenshot("crossed_fibers_section.png")
