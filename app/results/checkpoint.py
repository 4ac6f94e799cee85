"""State of a run on disk, so that it goes on after an interruption, on any number of ranks, bit for bit.

The folder holds `step_0007.npz` of the last converged step and the one before, in case the newest is damaged. Each is
an ordinary NumPy archive: nodal values stand with the node numbers of the mesh file, those of contact points with keys
that do not depend on the ranks. A process killed at any moment leaves the newest complete file in place.
"""

from __future__ import annotations

import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.meshes.parallel import on_root
from piezomat.results.atomic import replacing

Keyed = tuple[NDArray[np.int64], NDArray[Any]]

FORMAT = 2
# Rows that travel and are written at once: they bound what rank 0 holds, whatever the size of the mesh.
SLICE = 1 << 16
GENERATIONS = 2
_FILE = re.compile(r"step_(?P<step>\d{4,})\.npz")
_CONTENT = "content.json"


class CheckpointError(ValueError):
    """A checkpoint is missing, damaged, of another mesh, or cannot be written; the message says which."""


def save(
    comm: MPI.Comm,
    directory: Path,
    step: int,
    nodal: Mapping[str, Keyed],
    points: Mapping[str, Keyed],
    scalars: Mapping[str, Any],
) -> None:
    """Write the state after `step` to `directory`/step_NNNN.npz; of older ones the newest is kept. Collective.

    nodal[name] = (ids (n,), values (n, ...)) and points[name] = (keys (m, 4), values (m, ...)) hold what this
    rank owns, with the same names, trailing shapes and types on every rank; scalars, rank 0's, become JSON.
    CheckpointError: it cannot be written (those before are then still there).
    """
    directory = Path(directory)
    arrays = _arrays(comm, nodal, points)
    content = {"format": FORMAT, "step": step, "scalars": scalars}
    incoming = _incoming(comm, arrays)

    def write() -> None:
        try:
            text = json.dumps(content, default=_plain)
            directory.mkdir(parents=True, exist_ok=True)
            path = directory / f"step_{step:04d}.npz"
            with replacing(path) as whole, zipfile.ZipFile(whole, "w") as archive:
                archive.writestr(_CONTENT, text)
                for array, blocks in groupby(incoming, key=lambda item: item[0]):
                    with archive.open(f"{array.name}.npy", "w", force_zip64=True) as file:
                        np.lib.format.write_array_header_1_0(file, array.header())
                        for _, block in blocks:
                            file.write(np.ascontiguousarray(block).tobytes())
            older = [(number, file) for number, file in _files(directory) if number < step][: GENERATIONS - 1]
            for number, file in _files(directory):
                if (number, file) not in older and file != path:
                    file.unlink()
        finally:
            # After a failure the other ranks still send: receive everything, so that none waits.
            for _ in incoming:
                pass

    try:
        if comm.rank > 0:
            for _ in incoming:
                pass
        on_root(comm, write)
    except OSError as error:
        raise CheckpointError(f"cannot write a checkpoint in {directory}: {error.strerror or error}") from error


def load(comm: MPI.Comm, directory: Path, check: Callable[[int, Any], Any] | None = None) -> Checkpoint:
    """The newest sound checkpoint of a folder, checked as a whole. Collective. CheckpointError: none.

    `check(step, scalars)` returns the scalars to use and raises ValueError where they are not those of such a step.
    """
    directory = Path(directory)

    def newest() -> tuple[Path, int, Any, dict[str, tuple[int, ...]], str]:
        files = _files(directory)
        if not files:
            raise CheckpointError(f"there is no checkpoint in {directory}")
        damage = ""
        for step, path in files:
            try:
                scalars, arrays = _read_content(path, step)
                return path, step, scalars if check is None else check(step, scalars), arrays, damage
            except Exception as error:  # a damaged archive can raise anything
                damage = damage or f"{path} is damaged or not a checkpoint: {' '.join(str(error).split())}"
        raise CheckpointError(damage)

    try:
        return Checkpoint(comm, *on_root(comm, newest))
    except OSError as error:
        raise CheckpointError(f"cannot read {directory}: {error.strerror or error}") from error


class Checkpoint:
    """A checkpoint that has been found sound: values by their keys. Read it before the next `save` into its folder.

    path, step (int), scalars: as saved, or what the check of `load` has made of them. damage: what is wrong with the
    newest file where this is an older one, otherwise empty.
    """

    def __init__(
        self, comm: MPI.Comm, path: Path, step: int, scalars: Any, arrays: dict[str, tuple[int, ...]], damage: str
    ) -> None:
        self.comm = comm
        self.path = path
        self.step = step
        self.scalars = scalars
        self.damage = damage
        self._arrays = arrays

    def nodal(self, name: str, ids: NDArray[np.int64], width: int | None = None) -> NDArray[Any]:
        """Values (n, ...) of the nodes `ids` (n,), which each rank chooses for itself. Collective.

        CheckpointError: no such values, other than `width` at a node, or a node of which there are none (another mesh).
        """
        values, found = self._values(f"nodal/{name}", np.asarray(ids, np.int64).reshape(-1, 1), width)
        missing = self.comm.allreduce(int(np.count_nonzero(~found)))
        if missing:
            raise CheckpointError(
                f"{self.path} has no value of '{name}' for {missing} nodes: it belongs to another mesh"
            )
        return values

    def points(
        self, name: str, keys: NDArray[np.int64], width: int | None = None
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Values (m, ...) of the points `keys` (m, 4) of this rank, and whether each has one. Collective.

        A point of which there is no value gets zeros. CheckpointError: no such values, other than `width` at a point.
        """
        return self._values(f"points/{name}", np.asarray(keys, np.int64).reshape(-1, 4), width)

    def _values(
        self, table: str, wanted: NDArray[np.int64], width: int | None
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        kind, name = table.split("/", 1)
        if f"{table}/keys" not in self._arrays:
            raise CheckpointError(f"{self.path} has no {kind} values '{name}'")
        shape = self._arrays[f"{table}/values"]
        if width is not None and shape[1:] != (width,):
            raise CheckpointError(f"{self.path} has {kind} values '{name}' of shape {shape}, not (n, {width})")
        index = _Index(wanted)
        values: NDArray[Any] | None = None
        found = np.zeros(index.size, bool)
        reader = _read_table(self.path, table) if self.comm.rank == 0 else iter(())
        try:
            while (block := on_root(self.comm, lambda: next(reader, None))) is not None:
                keys, offered = block
                if values is None:
                    values = np.zeros((index.size, *offered.shape[1:]), offered.dtype)
                rows, places = index.match(keys)
                values[places] = offered[rows]
                found[places] = True
        except (OSError, zipfile.BadZipFile) as error:
            raise CheckpointError(f"cannot read {self.path}: {error}") from error
        assert values is not None  # a table has at least one block, which may be empty
        return values[index.places], found[index.places]


class _Array(NamedTuple):
    """An array of the archive: its name, its type, and its shape over all ranks."""

    name: str
    dtype: str
    shape: tuple[int, ...]

    def header(self) -> dict[str, Any]:
        return {"descr": self.dtype, "fortran_order": False, "shape": self.shape}


def _arrays(
    comm: MPI.Comm, nodal: Mapping[str, Keyed], points: Mapping[str, Keyed]
) -> list[tuple[_Array, NDArray[Any]]]:
    """What is to be written, with this rank's rows; ValueError on every rank if the ranks do not agree."""
    local: list[tuple[str, NDArray[Any]]] = []
    fault = ""
    for kind, tables, trailing in (("nodal", nodal, ()), ("points", points, (4,))):
        for name, (keys, values) in tables.items():
            keys, values = np.asarray(keys), np.asarray(values)
            if keys.dtype != np.int64 or keys.shape != (len(values), *trailing):
                fault = f"{kind} '{name}': keys {keys.dtype} {keys.shape} do not fit values {values.shape}"
            local += [(f"{kind}/{name}/keys", keys), (f"{kind}/{name}/values", values)]
    described = comm.allgather((fault, [(name, rows.dtype.str, rows.shape) for name, rows in local]))
    faults = [fault for fault, _ in described if fault]
    forms = {tuple((name, kind, shape[1:]) for name, kind, shape in arrays) for _, arrays in described}
    if faults or len(forms) != 1:
        raise ValueError(f"cannot save: {faults[0] if faults else 'the ranks give different arrays'}")
    totals = [sum(arrays[i][2][0] for _, arrays in described) for i in range(len(local))]
    return [
        (_Array(name, rows.dtype.str, (total, *rows.shape[1:])), rows)
        for (name, rows), total in zip(local, totals, strict=True)
    ]


def _incoming(comm: MPI.Comm, arrays: list[tuple[_Array, NDArray[Any]]]) -> Iterator[tuple[_Array, NDArray[Any]]]:
    """On rank 0 every rank's rows, array by array, in blocks of at most SLICE; the other ranks send them."""
    for array, rows in arrays:
        counts = comm.allgather(len(rows))
        for rank, count in enumerate(counts):
            # rank 0 gives at least one block, so that an array without rows is written too
            for start in range(0, max(count, rank == 0), SLICE):
                size = min(SLICE, count - start)
                if rank == 0 and comm.rank == 0:
                    yield array, rows[start : start + size]
                elif comm.rank == 0:
                    block = np.empty((size, *array.shape[1:]), array.dtype)
                    comm.Recv([block.view(np.uint8), MPI.BYTE], source=rank)
                    yield array, block
                elif comm.rank == rank:
                    block = np.ascontiguousarray(rows[start : start + size])
                    comm.Send([block.view(np.uint8), MPI.BYTE], dest=0)


def _files(directory: Path) -> list[tuple[int, Path]]:
    """Step and path of the checkpoints in a folder, the newest first."""
    found = []
    for file in directory.iterdir() if directory.is_dir() else ():
        match = _FILE.fullmatch(file.name)
        if match:
            found.append((int(match["step"]), file))
    return sorted(found, reverse=True)


def _read_content(path: Path, step: int) -> tuple[Any, dict[str, tuple[int, ...]]]:
    """Scalars of a checkpoint, and the shapes of its arrays by name; any exception if it is not whole."""
    with zipfile.ZipFile(path) as archive:
        damaged = archive.testzip()
        if damaged is not None:
            raise ValueError(f"'{damaged}' in it is not what was written")
        content = json.loads(archive.read(_CONTENT))
        if not isinstance(content, dict) or not {"format", "step", "scalars"} <= set(content):
            raise ValueError(f"{_CONTENT} has no format, step and scalars")
        if content["format"] != FORMAT:
            raise ValueError(f"its format is {content['format']}, this piezomat reads {FORMAT}")
        if content["step"] != step:
            raise ValueError(f"it is of step {content['step']}")
        shapes = {
            name.removesuffix(".npy"): _shape(archive, name) for name in archive.namelist() if name.endswith(".npy")
        }
    for name, shape in shapes.items():
        table, _, part = name.rpartition("/")
        other = shapes.get(f"{table}/{'values' if part == 'keys' else 'keys'}")
        if other is None or len(shape) == 0 or other[:1] != shape[:1]:
            raise ValueError(f"'{name}' does not fit the keys or values beside it")
        if part == "keys" and shape[1:] != ((4,) if table.startswith("points/") else ()):
            raise ValueError(f"'{name}' has the shape {shape}")
    return content["scalars"], shapes


def _shape(archive: zipfile.ZipFile, name: str) -> tuple[int, ...]:
    """Shape of an array; ValueError unless it has numbers (keys: integers), in C order, as many as its shape says."""
    with archive.open(name) as file:
        shape, fortran, dtype = _read_header(file)
        expected = file.tell() + dtype.itemsize * math.prod(shape)
    kinds = "i" if name.endswith("/keys.npy") else "biuf"
    if fortran or dtype.kind not in kinds or archive.getinfo(name).file_size != expected:
        raise ValueError(f"'{name}' is no array of {shape} numbers")
    return shape


def _read_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError("an array of another version of NumPy's format")
    return np.lib.format.read_array_header_1_0(file)


def _read_table(path: Path, table: str) -> Iterator[Keyed]:
    """Keys and values of a table in blocks of at most SLICE rows, at least one block."""
    with (
        zipfile.ZipFile(path) as archive,
        archive.open(f"{table}/keys.npy") as key_file,
        archive.open(f"{table}/values.npy") as value_file,
    ):
        headers = [_read_header(file) for file in (key_file, value_file)]
        rows = headers[0][0][0]
        for start in range(0, max(rows, 1), SLICE):
            size = min(SLICE, rows - start)
            blocks = []
            for file, (shape, _, dtype) in zip((key_file, value_file), headers, strict=True):
                block = np.empty((size, *shape[1:]), dtype)
                data = file.read(block.nbytes)
                blocks.append(np.frombuffer(data, dtype).reshape(block.shape))
            yield blocks[0], blocks[1]


class _Index:
    """Search for the rows of a set of integer keys; built once, then used block by block.

    A row is encoded column by column: the code of the columns before and the entry, each replaced by its place among
    the values that occur, give the next code, which thus stays below (number of rows) squared.

    places (n,): place of each wanted row among the different ones. size (int): number of different rows.
    """

    def __init__(self, wanted: NDArray[np.int64]) -> None:
        self._levels: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
        code = np.zeros(len(wanted), np.int64)
        for column in wanted.T:
            values, place = np.unique(column, return_inverse=True)
            codes, code = np.unique(code * len(values) + place, return_inverse=True)
            self._levels.append((values, codes))
        self.places = code
        self.size = int(code.max(initial=-1)) + 1

    def match(self, keys: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """Rows of `keys` that are wanted, and the place of each."""
        rows = np.arange(len(keys))
        code = np.zeros(len(keys), np.int64)
        for (values, codes), column in zip(self._levels, np.atleast_2d(keys.T), strict=True):
            place, known = _find(values, column[rows])
            rows, code = rows[known], code[known] * len(values) + place[known]
            place, known = _find(codes, code)
            rows, code = rows[known], place[known]
        return rows, code


def _find(sorted_values: NDArray[np.int64], wanted: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Place of each wanted value in a sorted array, and whether it is there."""
    if not len(sorted_values):
        return np.zeros(len(wanted), np.int64), np.zeros(len(wanted), bool)
    place = np.minimum(np.searchsorted(sorted_values, wanted), len(sorted_values) - 1)
    return place, sorted_values[place] == wanted


def _plain(value: Any) -> Any:
    """numpy's numbers and arrays as Python's own, for JSON."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be written to a checkpoint")
