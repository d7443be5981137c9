"""What the comparisons with other programs share: programs, packages, and our labelled PLY files."""

import re
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OUTSIDE = 255


def python_with(packages, given, name="venv"):
    """A Python that can import `packages`: `given`, or one of a virtual environment in target/peers/NAME that is made
    when it is first needed (from PyPI, by pip)."""
    if given:
        return given
    directory = ROOT / "target" / "peers" / name
    python = directory / "bin" / "python"
    if not python.exists():
        print(f"installing {', '.join(packages)} into {directory}", file=sys.stderr)
        venv.create(directory, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *packages], check=True)
    return str(python)


def our_program(given):
    """The interfacet binary: `given`, or as `cargo build --release` makes it."""
    if given:
        return Path(given)
    subprocess.run(["cargo", "build", "--release", "--bin", "interfacet"], cwd=ROOT, check=True)
    return ROOT / "target" / "release" / "interfacet"


def our_example(name):
    """One of our examples, as `cargo build --release` makes it."""
    subprocess.run(["cargo", "build", "--release", "--example", name], cwd=ROOT, check=True)
    return ROOT / "target" / "release" / "examples" / name


def our_bench(given, name):
    """One of our bench binaries: `given`, or as `cargo bench` builds it."""
    if given:
        return given
    built = subprocess.run(
        ["cargo", "bench", "--no-run", "--bench", name], cwd=ROOT, check=True, stderr=subprocess.PIPE, text=True
    )
    return str(ROOT / re.search(rf"\(([^()]*{name}-[^()]*)\)", built.stderr).group(1))


def run(command):
    return subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def must_run(command):
    done = run(command)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(map(str, command))}\n{done.stderr}")
    return done


def read_assembly(path):
    """Positions, triangles, pairs (back, front) and the comments on materials of a PLY that we wrote."""
    import numpy as np

    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:end].decode("latin-1").splitlines()
    count = {line.split()[1]: int(line.split()[2]) for line in header if line.startswith("element")}
    real = "<f8" if "property double x" in header else "<f4"
    vertex = np.dtype([("p", real, 3), ("kind", "u1")])
    face = np.dtype([("n", "u1"), ("v", "<i4", 3), ("pair", "u1", 2)])
    vertices = np.frombuffer(data, vertex, count["vertex"], end)
    faces = np.frombuffer(data, face, count["face"], end + vertices.nbytes)
    materials = [line for line in header if line.startswith("comment material")]
    return vertices["p"].astype(float), faces["v"].astype(np.int64), faces["pair"].astype(np.int64), materials


def write_assembly(path, positions, triangles, pairs, materials, kinds=2):
    """A PLY as ours; `materials` are its comments on them, `kinds` one for each vertex or for all."""
    import numpy as np

    vertices = np.zeros(len(positions), np.dtype([("p", "<f4", 3), ("kind", "u1")]))
    vertices["p"], vertices["kind"] = positions, kinds
    faces = np.zeros(len(triangles), np.dtype([("n", "u1"), ("v", "<i4", 3), ("pair", "u1", 2)]))
    faces["n"], faces["v"], faces["pair"] = 3, triangles, pairs
    header = ["ply", "format binary_little_endian 1.0", *materials, f"element vertex {len(vertices)}"]
    header += [f"property float {a}" for a in "xyz"] + ["property uchar kind", f"element face {len(faces)}"]
    header += ["property list uchar int vertex_indices", "property uchar material_back"]
    header += ["property uchar material_front", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + vertices.tobytes() + faces.tobytes())
