"""piezomat: electromechanics of piezoelectric fibers in adhesive contact.

    from mpi4py import MPI
    import piezomat

    scene = piezomat.Scene.load("fibers_2d", ["load.steps=[4, 4]"])
    history = piezomat.run(scene, MPI.COMM_WORLD).history

A name is imported when it is first used, so `import piezomat` takes no time and loads neither DOLFINx nor gmsh.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Public names and the modules that define them.
_MODULES = {
    "BUILT_IN": "piezomat.forms.material_library",
    "Material": "piezomat.forms.materials",
    "Scene": "piezomat.scene",
    "SceneError": "piezomat.scene",
    "schema": "piezomat.scene",
    "Run": "piezomat.simulation",
    "NotConverged": "piezomat.simulation",
    "Interrupted": "piezomat.simulation",
    "run": "piezomat.simulation",
    "plan": "piezomat.simulation",
    "view": "piezomat.pictures.picture",
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
