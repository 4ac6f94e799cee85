"""piezomat: electromechanics of piezoelectric fibers in adhesive contact.

    import piezomat as pz

    r = pz.run("fibers_2d", {"load.steps": [4, 4]}, quiet=True)
    r.frame(), r.grid(4), r.contact(4), r.plot("force_y@top"), r.summary

A name is imported when it is first used, so `import piezomat` takes no time and loads neither DOLFINx nor gmsh. BLAS
works on one thread unless OMP_NUM_THREADS or OPENBLAS_NUM_THREADS says otherwise.
"""

from importlib import import_module
from typing import Any

from piezomat.environment import one_blas_thread

__version__ = "0.1.0"

one_blas_thread()

# Public names and the modules that define them.
_MODULES = {
    "BUILT_IN": "piezomat.forms.material_library",
    "Material": "piezomat.forms.materials",
    "Scene": "piezomat.scene",
    "SceneError": "piezomat.scene",
    "schema": "piezomat.scene",
    "NotConverged": "piezomat.simulation",
    "Interrupted": "piezomat.simulation",
    "plan": "piezomat.simulation",
    "view": "piezomat.pictures.picture",
    "Result": "piezomat.api.result",
    "run": "piezomat.api.runs",
    "open": "piezomat.api.runs",
    "sweep": "piezomat.api.sweep",
}

__all__ = ["__version__", *_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'piezomat' has no attribute '{name}'")
    hidden = import_module("piezomat.environment").hidden_packages()
    if hidden is not None:
        raise ImportError(hidden)
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
