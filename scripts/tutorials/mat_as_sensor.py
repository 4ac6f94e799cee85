"""A mat as a sensor: V/kPa, pC/N, capacitance and modulus of fibers between two electrodes.

    .venv/bin/python scripts/tutorials/mat_as_sensor.py

A small array in 2D stands for the mat, so that this takes seconds. For a mat of random fibers take the scene
`random_mat` with the same electrodes; everything below stays as it is.
"""

# %% The scene has two electrodes: `ground` on the floor, and `lid`, which is open for a voltage, at 0 V for a charge.
import json
from pathlib import Path

import piezomat as pz

mat = {
    "geometry.columns": 3,
    "geometry.rows": 2,
    "mesh.size": 0.25,
    "mesh.contact_size": 0.06,
    "load.steps": [4],
    "planes.1.motion": [0, -0.05],
}
scene = pz.Scene.load("fiber_array", mat)

# %% Open circuit: the voltage of the lid over the pressure on it.
r = pz.run(scene, quiet=True, out="mat_open")
volts, stress = r.column("voltage@lid"), r.column("stress")  # V, MPa
print("recipe:", {key: r.summary["recipe"][key] for key in ("fibers", "crossings", "porosity", "areal_density")})
for v, p, strain in zip(volts, stress, r.column("strain"), strict=True):
    print(f"{-1e3 * p:8.1f} kPa  {v:8.3f} V  {v / (-1e3 * p):.3e} V/kPa  strain {strain:.4f}")
capacitance = r.column("capacitance")[-1]

# %% Short circuit: the charge over the force.
s = pz.run(scene, {"electrodes.0.potential": 0}, quiet=True, out="mat_short")
charge, force = s.column("charge@lid")[-1], s.column("force_y@lid")[-1]
print(
    f"charge {charge:.3e} {s.unit('charge@lid')} for {force:.2f} {s.unit('force_y@lid')}:",
    f"{1e6 * charge / force:.1f} pC/N",
)
print(f"capacitance {capacitance:.3e} {r.unit('capacitance')}, modulus {stress[-1] / r.column('strain')[-1]:.0f} MPa")

# %% The same numbers on a page: `piezomat report mat_short`.
from piezomat.report.page import report  # noqa: E402

print(report(Path("mat_short")))
numbers = json.loads(Path("mat_short/report.json").read_text(encoding="utf-8"))["numbers"]
assert abs(numbers["d33"]["value"] / abs(1e6 * charge / force) - 1) < 1e-9
assert volts[-1] != 0.0 and numbers["modulus"]["value"] > 0.0
