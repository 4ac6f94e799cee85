"""A parameter study: pull-off and voltage of two fibers over their radius and their adhesion energy, in one table.

    .venv/bin/python scripts/tutorials/parameter_study.py

Each run has a folder in `study`. Run the script again: what is done is found, not repeated.
"""

# %% Keys and their values; every combination is a run. The mesh and the motion grow with the radius.
import matplotlib

matplotlib.use("Agg")  # a notebook leaves this line out
import numpy as np
from matplotlib import pyplot as plt

import piezomat as pz

rough = {"mesh.size": 0.15, "mesh.contact_size": 0.03, "load.steps": [3, 6], "output.picture": False}
energies = [0.2, 0.3]
table = pz.sweep(
    "fibers_2d", {"contact.adhesion.energy": energies, "contact.passes": [1, 2]}, rough, out="study", steps="all"
)

# %% One table: the keys, whether the run has converged, and the columns of the history. Here with numpy alone.
energy, passes = np.asarray(table["contact.adhesion.energy"]), np.asarray(table["contact.passes"])
force = np.asarray(table["force_y@top"])
assert np.all(table["converged"])
pull_off = {(e, p): force[(energy == e) & (passes == p)].max() for e in energies for p in (1, 2)}
for (e, p), value in pull_off.items():
    print(f"energy {e:g} pJ/um2, {p} passes: pull-off {value:.2f} uN/um")
assert pull_off[0.3, 2] > pull_off[0.2, 2]

# %% A figure of one's own.
fig, ax = plt.subplots(layout="constrained")
for e in energies:
    rows = (energy == e) & (passes == 2)
    ax.plot(np.asarray(table["displacement_y@top"])[rows], force[rows], "o-", label=f"{e:g} pJ/µm²")
ax.set_xlabel("displacement (µm)")
ax.set_ylabel("force (µN/µm)")
ax.legend(title="adhesion energy")
fig.savefig("study.png")
