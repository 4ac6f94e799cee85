"""The mesh of a run: of the scene's geometry, or the run's own copy when it goes on."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from piezomat.meshes.body_mesh import BodyMesh, Partition, create
from piezomat.meshes.gmsh_io.mesh_file import MeshFile
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.results.files import OutputError
from piezomat.results.folder import CHECKPOINT, MESH
from piezomat.scene import Scene
from piezomat.scene.errors import mesh_error


def mesh_of_run(
    scene: Scene,
    comm: MPI.Comm,
    out: Path | None = None,
    *,
    resume: bool = False,
    save: Path | None = None,
    partition: Partition | None = None,
) -> BodyMesh:
    """The mesh, saved to `save` if it is given. Collective.

    resume: that of the run in `out`. SceneError: there is no such mesh. OutputError: it cannot be saved.
    """
    geometry = MeshFile(file=out / CHECKPOINT / MESH) if resume else scene.geometry
    try:
        return create(comm, geometry, scene.sizes, save=save, partition=partition)
    except MeshError as error:
        if error.key == "out":
            raise OutputError(f"cannot write results in {out}: {error}") from None
        raise mesh_error(error) from None
