"""The programs that piezomat is compared with, each installed on request into a folder of its own beside .venv."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

from scripts.studies.two_fibers import ROOT

NGSOLVE, GETFEM = ROOT / ".ngsolve", ROOT / ".getfem"


def _pip(folder: Path, *packages: str) -> None:
    """A virtual environment with these packages."""
    venv.create(folder, with_pip=True)
    subprocess.run([folder / "bin" / "python", "-m", "pip", "install", "--quiet", *packages], check=True)


def _debian(folder: Path, package: str) -> None:
    """A package of Debian and its missing dependencies, unpacked into a folder; the system stays unchanged."""
    command = ["apt-get", "install", "--no-install-recommends", "--simulate", package]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    names = [line.split()[1] for line in listing.splitlines() if line.startswith("Inst ")]
    folder.mkdir()
    subprocess.run(["apt-get", "-q", "download", *names], check=True, cwd=folder, capture_output=True)
    for archive in folder.glob("*.deb"):
        subprocess.run(["dpkg", "-x", archive, folder], check=True)
        archive.unlink()


def ngsolve() -> tuple[list[str], dict[str, str]]:
    """Command, to be followed by a mesh, and environment variables of NGSolve; installed at the first call."""
    python = NGSOLVE / "bin" / "python"
    if not python.exists():
        _pip(NGSOLVE, "ngsolve==6.2.2608", "mkl==2026.2.0", "numpy==2.4.6", "scipy==1.17.1")
    return [str(python), str(ROOT / "scripts" / "studies" / "benchmark_ngsolve.py")], {}


def getfem() -> tuple[list[str], dict[str, str]]:
    """Command, to be followed by a mesh, and environment variables of Debian's GetFEM; unpacked at the first call."""
    if not GETFEM.exists():
        _debian(GETFEM, "python3-getfem")
    libraries = os.pathsep.join(str(folder) for folder in (GETFEM / "usr" / "lib").glob("*-linux-gnu"))
    environment = {"LD_LIBRARY_PATH": libraries, "PYTHONPATH": str(GETFEM / "usr/lib/python3/dist-packages")}
    return ["/usr/bin/python3", str(ROOT / "scripts" / "studies" / "benchmark_getfem.py")], environment


PROGRAMS = {"ngsolve": ngsolve, "getfem": getfem}


def installed(names: list[str]) -> dict[str, tuple[list[str], dict[str, str]]]:
    """Commands and environment variables of these programs. Exits where one cannot be installed."""
    found = {}
    for name in names:
        try:
            found[name] = PROGRAMS[name]()
        except (subprocess.CalledProcessError, OSError) as error:
            sys.exit(f"{name} could not be installed: {error}")
    return found
