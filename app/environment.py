"""What a process of the command line finds around it: streams, working folder, home. Set right before the rest loads.

`prepare` is called before MPI, DOLFINx and PETSc are imported, each of which ends in an error of its own where the
working folder is gone or an argument is no text. This module imports nothing but Python's own.
"""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

_notes: list[str] = []


def prepare(arguments: Sequence[str]) -> str | None:
    """Open the standard streams and look at folder and arguments: what is wrong, in one line, or None."""
    _open_streams()
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a name that the terminal has no characters for ends no run
            stream.reconfigure(errors="backslashreplace")
    try:
        os.getcwd()
    except OSError:
        return "the working folder: found none, it has been removed; allowed: a folder that exists"
    for argument in arguments:
        try:
            argument.encode("utf-8")
        except UnicodeEncodeError:
            return f"{ascii(argument)[:100]}: found bytes that are no text; allowed: arguments and file names in UTF-8"
        if len(os.fsencode(argument)) > 100_000:
            return f"{argument[:40]}...: found an argument of {len(argument)} characters; allowed: at most 100,000"
    return hidden_packages()


def one_blas_thread() -> None:
    """Let BLAS work on one thread, unless the user has said how many: ranks and runs are what goes on in parallel.

    A loaded OpenBLAS is told so itself, since it has read the environment already.
    """
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    if any(os.environ.get(name) for name in names):
        return
    for name in names:
        os.environ[name] = "1"
    try:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return
    for library in sorted({line.split(maxsplit=5)[5] for line in maps.splitlines() if "openblas" in line}):
        try:
            ctypes.CDLL(library).openblas_set_num_threads(1)
        except (OSError, AttributeError):  # gone, or its symbols have names of their own
            continue


def hidden_packages() -> str | None:
    """Packages of other versions than DOLFINx was built with, in one line that says what to type; None without any.

    scripts/setup writes down Debian's versions in the virtual environment, where pip may have put others before them.
    """
    root = Path(sys.prefix)
    try:
        pinned = (root / "debian.constraints").read_text(encoding="utf-8").split()
    except OSError:
        return None
    wrong = []
    for name, _, version in (pin.partition("==") for pin in pinned):
        try:
            found = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
        if found != version:
            wrong.append(f"{name} {found}, where DOLFINx needs {version}")
    if not wrong:
        return None
    return f"{root}: found {'; '.join(wrong)}; to mend it type: {root.parent / 'scripts' / 'setup'}"


def use_cache(made: str | None) -> None:
    """Let compiled forms, and Matplotlib, be kept in this folder; None: where they are by default."""
    if made is not None:
        os.environ["XDG_CACHE_HOME"] = os.environ["XDG_CONFIG_HOME"] = os.environ["MPLCONFIGDIR"] = made
        _notes.append(
            f"no folder for compiled forms can be written to in the home: they are kept in {made} for this run"
        )


def temporary_cache() -> str | None:
    """A new folder for compiled forms where that of the user cannot be written to, else None. The caller removes it."""
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fenics"
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=cache):
            return None
    except (OSError, RuntimeError):  # RuntimeError: there is no home
        return tempfile.mkdtemp(prefix="piezomat-cache-")


def notes() -> list[str]:
    """What of the surroundings a run depends on and its scene does not say, for its log."""
    options = os.environ.get("PETSC_OPTIONS")
    return [*_notes, *([f"PETSC_OPTIONS is set: {' '.join(options.split())}"] if options else [])]


def _open_streams() -> None:
    """Open closed standard streams on nothing: files opened later would get their numbers, and what is printed."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))


def for_mpirun() -> dict[str, str]:
    """The environment in which this process starts mpirun: not taken for a rank of its own, more ranks than cores."""
    launchers = ("OMPI_", "PMI", "PRTE_", "SLURM_")
    bare = {name: value for name, value in os.environ.items() if not name.startswith(launchers)}
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"} if os.geteuid() == 0 else {}
    return (
        bare
        | root
        | {
            "OMPI_MCA_rmaps_base_oversubscribe": "1",
            "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
            "OMPI_MCA_orte_execute_quiet": "1",
            "OMPI_MCA_btl": "^tcp",
        }
    )
