"""Attempts to break the program from outside, seeded: keys, overrides, arguments, TOML, tables of fibers, mesh files.

`python -m tests.fuzz` makes all of them and prints how many came out right; tests/test_fuzz.py takes a sample. Right
is: taken, or refused in one line, soon.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from piezomat import cli
from piezomat.scene import Scene, SceneError, schema
from piezomat.scene.json_schema import all_keys

SEED = 20200214
LIMIT = 10.0  # s of the processor
SHAPES = {
    "facing_halves": "bottom",
    "crossed_fibers": "bottom",
    "parallel_fibers": "bottom",
    "fiber_on_block": "bottom",
    "stacked_blocks": "bottom",
    "cantilever": "root",
    "fiber_array": "surfaces",
    "cross_ply": "surfaces",
    "mat": "surfaces",
    "fibers": "surfaces",
}
VALUES = (
    *("0", "-1", "1", "1.5", "1e300", "-1e300", "1e-300", "1e30", "nan", "inf", "true", '""', '"x"', "x y", "[]", "{}"),
    *(
        "[[]]",
        "[0, 0, 0, 0]",
        "[nan]",
        "1000000000000000000",
        "9" * 400,
        "9" * 5000,
        "[" * 300 + "]" * 300,
        "2020-01-01",
    ),
    *('"a\\u2028b"', '"\\u0000"', "{ a = { a = { a = 1 } } }"),
)
TABLE = "fiber,x,y,z,radius\na,0,0,0.5,0.5\na,5,0,0.5,0.5\nb,2,-2,1.5,0.5\nb,2,2,1.5,0.5\n"
MESH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
1 1 "bottom"
2 1 "body"
$EndPhysicalNames
$Nodes
4
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
$EndNodes
$Elements
3
1 1 2 1 1 1 2
2 2 2 1 1 1 2 3
3 2 2 1 1 1 3 4
$EndElements
"""
MESH_SCENE = (
    'geometry.file = "x.msh"\nbodies.body = "elastic"\nboundaries = [{ on = "bottom", displacement = [0, 0] }]\n'
)
Attempt = Callable[[], int]
LINES = ("\n", "\r", "\u2028", "\x0b", "\x85", "\x1b[0m", "\0", '"', ",", "=")


def scene_of(shape: str) -> str:
    """A scene of this shape, in the file `scene.toml` beside `x.csv`."""
    file = 'file = "x.csv"\n' if shape == "fibers" else ""
    return (
        f'title = "t"\nbodies = {{ "*" = "pvdf" }}\n[geometry]\nshape = "{shape}"\n{file}[mesh]\nsize = 0.5\n'
        f'[[boundaries]]\non = "{SHAPES[shape]}"\npotential = 0\n'
    )


def keys() -> Iterator[tuple[str, Attempt]]:
    """Every key of the schema with every value: those of the geometry for their shape, all others once."""
    paths = [".".join(map(str, path)) for path in all_keys(schema(), schema())]
    others = [path for path in dict.fromkeys(paths) if not path.startswith("geometry")]
    for shape in SHAPES:
        table = next(
            t for t in schema()["$defs"].values() if t.get("properties", {}).get("shape", {}).get("const") == shape
        )
        mine = [f"geometry.{name}" for name in table["properties"]] + (others if shape == "facing_halves" else [])
        for key in mine:
            for value in VALUES:
                yield f"{shape} {key}={value[:40]}", _checked(shape, f"{key}={value}")


def _checked(shape: str, *overrides: str) -> Attempt:
    def attempt() -> int:
        Path("x.csv").write_text(TABLE, encoding="utf-8")
        Path("scene.toml").write_text(scene_of(shape), encoding="utf-8")
        return _load(overrides)

    return attempt


def _load(overrides: tuple[str, ...] = ()) -> int:
    try:
        Scene.load("scene.toml", overrides)
    except SceneError as error:
        assert "\n" not in str(error), str(error)[:200]
        return 2
    return 0


def overrides() -> Iterator[tuple[str, Attempt]]:
    """Keys and values of --set that are none."""
    odd = ["", "=", "a", ".=1", "a..b=1", "[0]=1", "boundaries=1", "boundaries.0=1", "boundaries.9.on=x", "mesh=1"]
    odd += [
        f"boundaries.{'9' * 5000}.on=1",
        f"boundaries[{'9' * 5000}].on=1",
        "a" + ".a" * 5000 + "=1",
        "a=" + "[" * 5000,
    ]
    odd += [f"title={'x' * 5000}", '"\u00b2"=1', 'boundaries."\u00b2".on=1', "boundaries.-1.on=1", "title.x=1"]
    for text in odd:
        yield f"--set {text[:40]}", _checked("facing_halves", text)
    random = np.random.default_rng(SEED)
    alphabet = [*"abc.[]{}=\"'0129-+e,# \\", "mesh", "size", "boundaries", *LINES]
    for number in range(200):
        text = "".join(random.choice(alphabet, random.integers(1, 12)))
        yield f"--set random {number} {text!r}", _checked("facing_halves", text)


def arguments() -> Iterator[tuple[str, Attempt]]:
    """Command lines."""
    long = "a" * 5000
    odd = [
        [],
        [""],
        ["run"],
        ["run", ""],
        ["run", long],
        ["plan", "."],
        ["plan", "/dev/null"],
        ["view", ""],
        ["view", long],
    ]
    odd += [
        ["resume", long],
        ["resume", "/dev/null"],
        ["mesh", "stack", "--out", ""],
        ["mesh", "stack", "--out", "/proc/x.msh"],
    ]
    odd += [
        ["run", "stack", "--out", place] for place in ("", long, "/proc/x", "/sys/kernel/x", "/dev/null", "/dev/null/x")
    ]
    odd += [
        ["run", "stack", "--set"],
        ["run", "--set", "a=1"],
        ["run", "stack", "stack"],
        ["--help", "x"],
        ["schema", "x"],
    ]
    odd += [["run", "a\nb"], ["run", "\x1b[0m"], ["mesh", "stack", "--out", f"{long}.msh"]]
    for words in odd:
        yield f"command {' '.join(words)[:40]!r}", lambda words=words: _command(words)


def _command(words: list[str]) -> int:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = cli.main(words)
    assert err.getvalue().count("\n") <= 1, err.getvalue()[-300:]
    return status


def tomls() -> Iterator[tuple[str, Attempt]]:
    """Scene files with bytes changed, cut, or in other encodings."""
    text = scene_of("stacked_blocks")
    whole = [text.encode(e) for e in ("utf-8-sig", "utf-16", "utf-16-le")] + [
        text.replace("\n", n).encode() for n in ("\r\n", "\r")
    ]
    whole += [b"", b"\0", b"a = " + b"[" * 400 + b"]" * 400, b"a = " + b"[" * 9000, b"[" + b"a." * 20000 + b"a]\n"]
    whole += [
        b"[" + b"a." * 500 + b"a]\n",
        b"a = " + b"9" * 5000,
        b"a = " + b"9" * 500,
        b"a = { b = " * 300 + b"1" + b" }" * 300,
    ]
    whole += [
        b"#" * 5_000_000,
        text.encode() + b"\xff",
        b"x = 1\n" * 3,
        b"".join(b"k%d = 1\n" % i for i in range(100_000)),
    ]
    for number, data in enumerate([*whole, *_damaged(text.encode(), 200)]):
        yield f"toml {number}", _file("scene.toml", data)


def tables() -> Iterator[tuple[str, Attempt]]:
    """Tables of fibers."""
    text = TABLE
    names = [text.replace("a,", f'"a{c}1",') for c in LINES if c != '"']
    whole = [text.encode(e) for e in ("utf-8-sig", "utf-16", "latin-1")] + [name.encode() for name in names]
    whole += [b"", b"fiber,x,y,z,radius\n", text.replace("0.5", "nan").encode(), text.replace("0.5", "1e300").encode()]
    whole += [text.replace("0.5", "1e-300").encode(), text.replace("5", "9" * 5000).encode(), b"," * 200_000]
    for number, data in enumerate([*whole, *_damaged(text.encode(), 150)]):
        yield f"csv {number}", _file("x.csv", data)


def meshes() -> Iterator[tuple[str, Attempt]]:
    """Mesh files."""
    whole = [MESH.replace("bottom", f"bottom{c}").encode() for c in LINES]
    whole += [MESH.replace('"body"', '"$EndPhysicalNames"').encode(), b"$Comments\nx\n$EndComments\n" + MESH.encode()]
    whole += [MESH.replace("2.2", v).encode() for v in ("4.0", "4.1", "1", "x")] + [b"", MESH.encode() * 2]
    whole += [MESH.replace("\n4\n", f"\n{n}\n").encode() for n in ("3", "5", "-1", "9" * 30, "9" * 5000, "1e300")]
    for number, data in enumerate([*whole, *_damaged(MESH.encode(), 150)]):
        yield f"msh {number}", _file("x.msh", data)


def _damaged(data: bytes, count: int) -> Iterator[bytes]:
    """Copies with bytes changed, taken out, put in, and cut."""
    random = np.random.default_rng(SEED)
    for number in range(count):
        found = bytearray(data)
        for _ in range(random.integers(1, 4)):
            at = int(random.integers(len(found)))
            if number % 4 == 0:
                found[at] = int(random.integers(256))
            elif number % 4 == 1:
                del found[at : at + int(random.integers(1, 9))]
            elif number % 4 == 2:
                found[at:at] = random.choice([b"9", b"-", b"\n", b'"', b"$", b"[", b"e", b",", b"nan"])
            else:
                del found[max(at, 10) :]

        yield bytes(found)


def _file(name: str, data: bytes) -> Attempt:
    def attempt() -> int:
        scene = MESH_SCENE if name == "x.msh" else scene_of("fibers")
        Path("scene.toml").write_text(scene, encoding="utf-8")
        Path(name).write_bytes(data)
        return _load()

    return attempt


GROUPS = {"keys": keys, "--set": overrides, "command line": arguments, "toml": tomls, "csv": tables, "msh": meshes}


def outcome(attempt: Attempt) -> str:
    """ "right", or what is wrong, of an attempt in the working folder, which is emptied."""

    def too_long(number: int, frame: object) -> None:
        raise TimeoutError

    before, start = signal.signal(signal.SIGALRM, too_long), time.process_time()
    signal.alarm(60)  # s of the clock: the machine may have other work
    try:
        status = attempt()
    except BaseException as error:
        return f"{type(error).__name__}: {' '.join(str(error).split())[:150]}"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        left = [path.name for path in Path().iterdir() if path.name not in ("scene.toml", "x.csv", "x.msh")]
    if left:
        return f"left behind: {left}"
    if time.process_time() - start > LIMIT:
        return f"{time.process_time() - start:.0f} s"
    return "right" if status in (0, 2, 3) else f"exit status {status}"


def main() -> None:
    """Make all attempts and print the table."""
    print("| what | tried | right | wrong |\n|---|--:|--:|---|")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for name, group in GROUPS.items():
            found: Counter[str] = Counter()
            for label, attempt in group():
                result = outcome(attempt)
                found[result] += 1
                if result != "right":
                    print(f"{label}: {result}", file=sys.stderr)
            wrong = ", ".join(f"{count} {what}" for what, count in found.items() if what != "right")
            print(f"| {name} | {found.total()} | {found['right']} | {wrong} |", flush=True)
        os.chdir("/")


if __name__ == "__main__":
    main()
