"""Which PETSc options a scene may hold: those of its solvers, with values that are numbers or names of methods.

PETSc itself would do more: load libraries and Python files, and write to any file. A scene is text, from anybody.
"""

from __future__ import annotations

import re
from typing import Any

from piezomat.scene.errors import SceneError, near, shown

MOST_OPTIONS = 64  # PETSc holds 512 in all
# Solvers inside the solver, in front of an option: fields, levels of multigrid, blocks.
_INNER = re.compile(r"(?:fieldsplit_(?:u|phi|[0-9])_|mg_levels_(?:[0-9]{1,2}_)?|mg_coarse_|sub_|(?:st|inner|esteig)_)*")
PREFIXES = ("snes_", "ksp_", "pc_", "mat_mumps_")
_NAME = re.compile(r"[a-z][a-z0-9_]{1,79}")
# What runs code, writes files, opens windows, reads files or ends the process.
_FORBIDDEN_NAME = re.compile(
    r"python|shell|script|matlab|file|path|dir\b|tmpdir|prefix|load|save|write|dump|binary|draw|plot|ooc|log\b|library|"
    r"debug|attach|exec|saws|database|dlname|mat_mumps_icntl_(?:1|2|3|22)$"
)
# Values that are types of solvers which run code, wherever they stand.
_FORBIDDEN_VALUES = ("python", "shell", "matlab", "user")
_VALUE = re.compile(r"[A-Za-z0-9_+.,-]{0,80}")
# These print to the terminal and take the name of a file, which they overwrite.
_PRINTED = re.compile(r"view|monitor|reason|print")
_TYPE = re.compile(r"(?:^|_)type$")
_POSITIVE = re.compile(r"_(?:rtol|atol|abstol|stol|divtol|dtol|haptol|rtol0|rtolmax|threshold_scale|omega|damping)$")
_REAL = re.compile(
    r"_(?:threshold|alpha|alpha2|gamma|shift_amount|fill|pivot|richardson_scale|cntl_[0-9]{1,2}|emin|emax)$"
)
_COUNT = re.compile(
    r"_(?:max_it|restart|max_funcs|levels|smoothup|smoothdown|nsmooths|coarse_eq_limit|its|lits|lag_jacobian|"
    r"lag_preconditioner|max_fail|asm_overlap)$"
)
_WHOLE = re.compile(r"_icntl_[0-9]{1,2}$")


def check_petsc_options(options: dict[str, Any]) -> None:
    """Raise SceneError, its key that of the option, for the first option that no scene may hold."""
    if len(options) > MOST_OPTIONS:
        raise SceneError("", f"{len(options)} options", f"at most {MOST_OPTIONS}")
    for name, value in options.items():
        _check_name(name)
        _check_value(name, value)


def _check_name(name: str) -> None:
    plain = name[_INNER.match(name).end() :]
    if not _NAME.fullmatch(name) or not plain.startswith(PREFIXES) or plain in PREFIXES:
        inner = "fieldsplit_u_, fieldsplit_phi_ or mg_levels_ before it"
        allowed = f"an option that begins with {', '.join(PREFIXES)}, with {inner} for an inner solver"
        raise SceneError(name, "an option that a scene has no use for", f"{allowed}{near(name, PREFIXES)}")
    if _FORBIDDEN_NAME.search(plain):
        raise SceneError(name, "an option that reads, writes or runs something", "options that only compute")


def _check_value(name: str, value: Any) -> None:
    words = value.split(",") if isinstance(value, str) else []
    if any(word.strip().lower() in _FORBIDDEN_VALUES for word in words):
        raise SceneError(name, shown(value), "methods of PETSc that run no code of others")
    if isinstance(value, str) and not _VALUE.fullmatch(value):
        raise SceneError(name, shown(value), "a number or the name of a method: letters, digits and _ + . , - alone")
    if _PRINTED.search(name):
        if value not in ("", True, False):
            raise SceneError(name, shown(value), 'true, false or "": it is printed on the terminal, never to a file')
    elif _TYPE.search(name):
        if not isinstance(value, str) or not value:
            raise SceneError(name, shown(value), "the name of a method")
    elif _POSITIVE.search(name):
        if _number(value) is None or _number(value) <= 0:
            raise SceneError(name, shown(value), "a number > 0")
    elif _REAL.search(name):
        if _number(value) is None:
            raise SceneError(name, shown(value), "a number")
    elif _COUNT.search(name):
        if _integer(value) is None or _integer(value) < 0:
            raise SceneError(name, shown(value), "an integer >= 0")
    elif _WHOLE.search(name) and _integer(value) is None:
        raise SceneError(name, shown(value), "an integer")


def _number(value: Any) -> float | None:
    """The finite number that PETSc would read, None for none."""
    try:
        number = float(value) if not isinstance(value, bool) else float("nan")
    except (TypeError, ValueError, OverflowError):
        return None
    return number if abs(number) < float("inf") else None


def _integer(value: Any) -> int | None:
    """The 32-bit integer that PETSc would read, None for none."""
    if isinstance(value, bool) or not re.fullmatch("[+-]?[0-9]{1,10}", str(value)) or abs(int(value)) >= 2**31:
        return None
    return int(value)
