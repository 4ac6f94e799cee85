"""The folder of a run: which files are a run's, whose the folder is, and who is at work in it.

A folder is a run's once it holds the file `MARK`. The ranks of the run lock that file while they are at work; the
system takes the lock from a process that ends, however it ends. NFS passes the lock on to other hosts.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import shutil
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

from mpi4py import MPI

from piezomat.meshes.parallel import on_root
from piezomat.scene.errors import SceneError, named

MARK = ".piezomat"
CHECKPOINT = "checkpoint"
MESH, FIBERS = "mesh.msh", "fibers.csv"
PIECES = {"fields": "vtu", "contact": "vtp"}
_FILES = "scene.toml history.csv pairs.csv summary.json fields.pvd contact.pvd log.txt".split()
_FILES += "picture.png picture.pdf picture.svg report.txt report.html report.json".split()
# Names of a run's files in each of its folders.
_NAMES = {
    "": re.compile("|".join(map(re.escape, _FILES))),
    "fields": re.compile(r"step_\d{4,}_rank_\d{4,}\.vtu"),
    "contact": re.compile(r"step_\d{4,}_rank_\d{4,}\.vtp"),
    CHECKPOINT: re.compile(rf"step_\d{{4,}}\.npz|{re.escape(MESH)}|{re.escape(FIBERS)}"),
}
# What a killed process has not finished; before the names were random they had no digits.
_UNFINISHED = re.compile(
    r"\.(step_\d{4,}(_rank_\d{4,})?|scene|history|pairs|summary|fields|contact|picture|report|mesh|fibers)"
    r"(\.[0-9a-f]{16})?\.part(\.\w+)?"
)
_ELSEWHERE = "a folder of its own for each run, such as --out results/A"
# File systems without locks say one of these.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


def files(out: Path) -> Iterator[Path]:
    """The files in a folder that bear names of a run's files."""
    for folder, names in _NAMES.items():
        yield from (path for path in _entries(out / folder) if names.fullmatch(path.name) and not path.is_dir())


def remove_unfinished(out: Path, but: Path | None = None) -> None:
    """Remove what a killed process has left under temporary names, but one. The caller holds the folder."""
    for folder in _NAMES:
        for path in _entries(out / folder):
            if _UNFINISHED.fullmatch(path.name) and path != but:
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)


def remove_results(out: Path, but: Path | None = None) -> None:
    """Remove the files of a run, finished or not, but one, and nothing else. The caller holds the folder."""
    remove_unfinished(out, but)
    for path in list(files(out)):
        path.unlink()
    for folder in _NAMES:
        if folder and (out / folder).is_dir() and not any((out / folder).iterdir()):
            (out / folder).rmdir()


def is_of_a_run(out: Path) -> bool:
    """Whether a run has written into the folder: the mark is there, or a checkpoint or a summary (before the mark)."""
    if (out / MARK).is_file() or any(_NAMES[CHECKPOINT].fullmatch(path.name) for path in _entries(out / CHECKPOINT)):
        return True
    try:
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(summary, dict) and {"converged", "reason", "steps", "versions"} <= set(summary)


def check_scene_stays(out: Path, scene: Path) -> None:
    """Raise SceneError where the scene file that is read lies in the folder that a run is to write into."""
    if out.resolve() in (scene.resolve().parent, scene.absolute().parent.resolve()):
        raise SceneError("--out", f"{out}, the folder of {scene.name}, which is read", _ELSEWHERE)


def check_free(out: Path, read: Sequence[Path] = ()) -> None:
    """Raise SceneError unless a run that reads the files `read` may write into `out`, which need not exist.

    It may not where one of these files would be replaced, nor where files bear a run's names and are no run's: the
    folder has neither the mark nor a checkpoint nor a summary (earlier versions set no mark).
    """
    there = list(files(out))
    for path in read:
        if path.resolve() in [file.resolve() for file in there]:
            raise SceneError("--out", f"{out}, which holds {path}, which the run reads", _ELSEWHERE)
    if there and not is_of_a_run(out):
        names = named([path.relative_to(out).as_posix() for path in there])
        raise SceneError("--out", f"{out}, where no run has written {names}", _ELSEWHERE)


class RunFolder:
    """Context in which the ranks of a run own the folder `out`. Entering is collective.

    SceneError: it is another's (`check_free`), or another run is at work there. Unless `keep` is called, an exception
    leaves the folder as it was.

    locked (bool, of rank 0): False where the file system has no locks, so that nothing keeps a second run out.
    """

    def __init__(self, comm: MPI.Comm, out: Path, *, resume: bool, read: Sequence[Path] = ()) -> None:
        self.comm, self.out, self.resume, self.read = comm, out, resume, read
        self.locked = True
        self._handle: int | None = None
        self._made: list[Path] = []
        self._kept = False

    def __enter__(self) -> RunFolder:
        self.comm.barrier()  # a rank may still be leaving the run before
        on_root(self.comm, self._open)
        if self.comm.rank > 0:
            self._share()
        ranks = self.comm.gather((socket.gethostname(), os.getpid()))
        if ranks is not None:
            self._sign(ranks)
        return self

    def __exit__(self, kind: object, *error: object) -> None:
        if kind is not None and self.comm.rank == 0 and not self._kept:
            remove_unfinished(self.out)
            for path in self._made:
                try:
                    path.rmdir() if path.is_dir() else path.unlink()
                except OSError:
                    break
        self._close()

    def keep(self) -> None:
        """From now on the folder is this run's, whatever happens."""
        self._kept = True

    def _open(self) -> None:
        """Lock the folder for this run alone, then share the lock with the run's other ranks."""
        try:
            if self.resume and not is_of_a_run(self.out):
                found = "neither a checkpoint nor another sign of a run" if self.out.is_dir() else "no such directory"
                raise SceneError("", found, "the directory of a run").in_file(self.out)
            if not self.resume:
                check_free(self.out, self.read)
            self._made = [path for path in (self.out, *self.out.absolute().parents) if not path.exists()]
            self.out.mkdir(parents=True, exist_ok=True)
            while not self._lock():
                pass
        except OSError as error:
            raise SceneError("--out", f"{self.out} ({error.strerror})", "a folder that can be written to") from None

    def _lock(self) -> bool:
        """Lock the mark, made where it is missing; False where a run that failed has just removed it."""
        mark = self.out / MARK
        if not mark.exists():
            self._made.insert(0, mark)
        self._handle = os.open(mark, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        try:
            for kind in (fcntl.LOCK_EX, fcntl.LOCK_SH):
                fcntl.flock(self._handle, kind | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _NO_LOCKS:
                self.locked = False
                return True
            self._close()
            raise self._busy() from None
        if mark.exists() and os.path.samestat(os.fstat(self._handle), mark.stat()):
            return True
        self._close()
        return False

    def _share(self) -> None:
        """Hold the lock too, so that a rank that outlives the others keeps it."""
        try:
            self._handle = os.open(self.out / MARK, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
            fcntl.flock(self._handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            self._close()  # rank 0 holds it

    def _sign(self, ranks: Sequence[tuple[str, int]]) -> None:
        """Write which processes are at work into the mark."""
        text = json.dumps({"about": "This folder belongs to a run of piezomat.", "processes": ranks}, indent=2) + "\n"
        try:
            os.ftruncate(self._handle, 0)
            os.pwrite(self._handle, text.encode(), 0)
        except OSError:
            pass  # a full disk: the lock is what counts

    def _busy(self) -> SceneError:
        try:
            ranks = json.loads((self.out / MARK).read_text(encoding="utf-8"))["processes"]
            who = f" (process {named([f'{number} on {host}' for host, number in ranks])})"
        except (OSError, ValueError, KeyError, TypeError):
            who = ""
        found = f"{self.out}, where another run is at work{who}"
        if self.resume:
            return SceneError("", found, "a run that has ended, or that you end")
        return SceneError("--out", found, _ELSEWHERE)

    def _close(self) -> None:
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None


def _entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []
