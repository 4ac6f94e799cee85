"""Your own gmsh mesh: a PVDF film between two steel plates, which are its electrodes.

    .venv/bin/python scripts/tutorials/metal_plates.py

The plates share their nodes with the film, which bonds them. They have no permittivity, so no field is in them; an
electrode on a plate is the film's face beneath it, at one potential. In the middle of a wide film under a pressure p
with its plates unconnected, D = 0 and, sideways, nothing moves much: V is nearly h p e33 / (C33 eps + e33^2).
"""

# %% A mesh with gmsh: physical groups are the names that the scene uses. Lengths in um.
import gmsh

import piezomat as pz

WIDTH, FILM, PLATE = 20.0, 1.0, 0.5
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
geo = gmsh.model.geo
heights = [0.0, PLATE, PLATE + FILM, 2 * PLATE + FILM]
rows = [[geo.addPoint(x, y, 0.0) for x in (0.0, WIDTH)] for y in heights]
across = [geo.addLine(*row) for row in rows]
left = [geo.addLine(rows[i][0], rows[i + 1][0]) for i in range(3)]
right = [geo.addLine(rows[i][1], rows[i + 1][1]) for i in range(3)]
faces = [geo.addPlaneSurface([geo.addCurveLoop([across[i], right[i], -across[i + 1], -left[i]])]) for i in range(3)]
for lines, cells in ((across, 40), (left, 3), (right, 3)):
    for line in lines:
        geo.mesh.setTransfiniteCurve(line, cells + 1)
for face in faces:
    geo.mesh.setTransfiniteSurface(face)
    geo.mesh.setRecombine(2, face)
geo.synchronize()
for face, name in zip(faces, ("lower_plate", "film", "upper_plate"), strict=True):
    gmsh.model.addPhysicalGroup(2, [face], name=name)
for lines, name in (([across[0]], "bottom"), ([across[3]], "top")):
    gmsh.model.addPhysicalGroup(1, lines, name=name)
gmsh.model.mesh.generate(2)
gmsh.write("plates.msh")
gmsh.finalize()

# %% The scene, as a dict. A metal is a material without permittivity, and an electrode on its body.
scene = {
    "title": "A film between steel plates",
    "geometry": {"file": "plates.msh"},
    "mesh": {"order": 2},
    "materials": {"steel": {"young": 200e3, "poisson": 0.3}},
    "bodies": {"film": "pvdf", "*_plate": "steel"},
    "boundaries": [
        {"on": "bottom", "displacement": [0, 0]},
        {"on": "top", "pressure": 1.0, "follows": "press"},
    ],
    "electrodes": [
        {"name": "ground", "on": ["lower_plate"], "potential": 0},
        {"name": "sensor", "on": ["upper_plate"]},  # open: no potential and no charge given
    ],
    "load": {"steps": [1], "factors": {"press": [1.0]}},
}

# %% Open circuit: the voltage per pressure, and the capacitance between the plates.
r = pz.run(scene, quiet=True, out="plates")
last = r.history[-1]
print(f"voltage {last['voltage@sensor']:.4f} V at 1 MPa, capacitance {last['capacitance']:.3e} {r.unit('capacitance')}")

# %% Short circuit: a potential of 0 on both, and the charge that flows.
electrodes = [scene["electrodes"][0], {**scene["electrodes"][1], "potential": 0}]
short = pz.run(scene, {"electrodes": electrodes}, quiet=True).history[-1]
d33 = short["charge@sensor"] / short["force_y@top"] * 1e6
print(f"charge {short['charge@sensor']:.3e} pC/um, effective d33 {d33:.1f} pC/N")

# %% Both agree: Q = C V. And the middle of the film is as the closed form says.
pvdf = pz.BUILT_IN["pvdf"].rotated(poling=[0, 1, 0])
c, e, eps = pvdf.stiffness[1, 1], pvdf.piezo[1, 1], pvdf.permittivity[1, 1]
ideal = FILM * 1.0 * abs(e) / (c * eps + e**2)
print(f"wide film that cannot widen: {ideal:.4f} V")
assert abs(abs(short["charge@sensor"] / (last["capacitance"] * last["voltage@sensor"])) - 1) < 1e-3
assert abs(abs(last["voltage@sensor"]) / ideal - 1) < 0.1
