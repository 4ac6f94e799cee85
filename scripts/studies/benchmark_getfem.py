"""The benchmark's two fibers in GetFEM: python3 benchmark_getfem.py MESH.msh (ASCII MSH 2.2), one JSON line.

Contact by its raytracing transformation and a penalty in its weak form language: the penalties and the fading of the
electric contact are piezomat's, but the gap is measured along the slave's normal. The bulk is assembled once, each
step starts from an extrapolation, MUMPS factorizes in every iteration; the transformation cannot be frozen.
"""

# Runs in a Python without piezomat's packages.
from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from math import sqrt
from pathlib import Path

import getfem as gf
import numpy as np

YOUNG, POISSON, PERMITTIVITY = 2500.0, 0.3, 12 * 8.8541878128e-6
E31, E32, E33 = 0.0307692, -0.0057692, -0.075
RANGE, APPROACH, STEPS = 0.002, 0.05, 5
TOLERANCE, ASIDE = 1e-8, 1e-6

given = argparse.ArgumentParser()
given.add_argument("mesh")
given.add_argument("--normal", type=float, default=1e5)
given.add_argument("--electric", type=float, default=0.1)
given.add_argument("--surfaces", nargs=2, default=["lower_contact", "upper_contact"], help="slave and master")
given = given.parse_args()
gf.util_trace_level(0)
gf.util_warning_level(0)
text = Path(given.mesh).read_text()
lines = text.split("PhysicalNames")[1].split("\n")[2:-1]
number = {name.strip('"'): int(tag) for _, tag, name in (line.split() for line in lines)}
with tempfile.TemporaryDirectory() as scratch:
    # The import merges nodes with equal coordinates, such as where the bodies touch: one of them is moved by ASIDE.
    before, nodes, after = re.split(r"(?<=\$Nodes\n)|(?=\$EndNodes)", text)
    seen, apart = set(), []
    for line in nodes.splitlines():
        head, *place = line.split()
        key = tuple(round(float(value), 8) for value in place)
        if place and key in seen:
            place[0] = repr(float(place[0]) + ASIDE)
        seen.add(key)
        apart.append(" ".join([head, *place]))
    copy = Path(scratch) / "mesh.msh"
    copy.write_text(before + "\n".join(apart) + "\n" + after)
    mesh = gf.Mesh("import", "gmsh", str(copy))
dim = mesh.dim()
up = dim - 1
scale = sqrt(YOUNG / PERMITTIVITY)
displacement, potential = gf.MeshFem(mesh, dim), gf.MeshFem(mesh, 1)
for space in (displacement, potential):
    space.set_classical_fem(1)
rule = gf.MeshIm(mesh, 2)

model = gf.Model("real")
model.add_fem_variable("u", displacement)
model.add_fem_variable("p", potential)
constants = {
    "lame": YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)),
    "shear": YOUNG / (2 * (1 + POISSON)),
    "eps": PERMITTIVITY,
    "scale": scale,
    "kn": given.normal,
    "rho": given.electric,
    "range": RANGE,
}
for name, value in constants.items():
    model.add_initialized_data(name, value)
piezo = np.diag([E31, E33] if dim == 2 else [E31, E32, E33])  # polarization = piezo : strain
matrix = "[" + ";".join(",".join(f"{v:.17g}" for v in row) for row in piezo) + "]"
bulk = (
    "(lame*Trace(Grad_u)*Id(meshdim)+2*shear*Sym(Grad_u)):Grad_Test_u"
    f"+scale*Grad_p({dim})*({matrix}:Grad_Test_u)+scale*Grad_Test_p({dim})*({matrix}:Grad_u)"
    "-eps*scale*scale*(Grad_p.Grad_Test_p)"
)
model.add_linear_term(rule, bulk)
model.add_raytracing_transformation("other", APPROACH)
for add, name in (
    (model.add_slave_contact_boundary_to_raytracing_transformation, given.surfaces[0]),
    (model.add_master_contact_boundary_to_raytracing_transformation, given.surfaces[1]),
):
    add("other", mesh, "u", number[name])
model.add_macro("normal", "Normalized(Inv((Id(meshdim)+Grad_u)')*Normal)")
model.add_macro("gap", "((Interpolate(X,other)+Interpolate(u,other)-X-u).normal)")
model.add_macro("dgap", "((Interpolate(Test_u,other)-Test_u).normal)")
model.add_macro("jump", "(scale*(p-Interpolate(p,other)))")
model.add_macro("djump", "(scale*(Test_p-Interpolate(Test_p,other)))")
model.add_macro("away", "(pos_part(gap/range)-pos_part(gap/range-1))")
contact = "-kn*neg_part(gap)*dgap-rho*(1-away*away*(3-2*away))*jump*djump+3*rho*away*(1-away)/range*sqr(jump)*dgap"
model.add_nonlinear_term(rule, f"Interpolate_filter(other,{contact},1)", number[given.surfaces[0]])
model.add_initialized_data("held", [0.0] * dim)
model.add_initialized_data("down", [0.0] * dim)
model.add_initialized_data("earth", 0.0)
model.add_Dirichlet_condition_with_simplification("u", number["bottom"], "held")
model.add_Dirichlet_condition_with_simplification("u", number["top"], "down")
model.add_Dirichlet_condition_with_simplification("p", number["bottom"], "earth")
top_u = displacement.basic_dof_on_region(number["top"])
top_u = top_u[top_u % dim == up]

unknowns = displacement.nbdof() + potential.nbdof()
last, iterations = None, []


def reactions() -> np.ndarray:
    """Residual of the bulk on each unknown: not zero at constraints and in contact."""
    return gf.asm_generic(rule, 1, bulk, -1, model)


def part(vector: np.ndarray, name: str) -> np.ndarray:
    """The entries of a vector of all unknowns that belong to a variable."""
    first, count = model.interval_of_variable(name)
    return vector[first : first + count]


for step in range(1, STEPS + 1):
    before = model.from_variables()
    if step > 1:
        model.to_variables(2 * before - last)
    last = before
    model.set_variable("down", [0.0] * up + [-APPROACH * step / STEPS])
    for iteration in range(25):
        model.assembly("build_all")
        residual = model.rhs()
        if iteration > 0 and np.linalg.norm(residual) <= TOLERANCE * np.linalg.norm(reactions()):
            break
        state, change = model.from_variables(), gf.linsolve_mumps(model.tangent_matrix(), residual).ravel()
        for share in (1.0, 0.5, 0.25, 0.125):
            model.to_variables(state + share * change)
            model.assembly("build_rhs")
            if np.linalg.norm(model.rhs()) < np.linalg.norm(residual):
                break
    else:
        sys.exit(f"step {step} did not converge")
    iterations.append(iteration)
weight = gf.asm_generic(rule, 1, "Test_p", number["top"], model)
answer = {
    "unknowns": unknowns,
    "newton": iterations,
    "force": float(part(reactions(), "u")[top_u].sum()),
    "potential": scale * float(part(weight, "p") @ model.variable("p") / weight.sum()),
}
print(json.dumps(answer))
