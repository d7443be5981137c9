#!/usr/bin/env python3
"""Compares dual contouring with what people do now: marching cubes, then quadric decimation of each part's mesh.

    python3 benches/peers/decimate.py --engine shared/data/engine/engine.mha
    python3 benches/peers/decimate.py --size 64 --tolerances 0.2

Needs cargo (or --program) and, once, the network: VTK, NumPy, SciPy, pyfqmr and PyMeshLab are installed from PyPI
into a virtual environment (target/peers/decimate-venv, or --python for one that has them; decimators that it has not
are left out). Every material's closed shell of our marching mesh is decimated alone, to the number of triangles
that the same material's shell has with `--method dual` at the same tolerance. Lengths are voxels.

What is measured:
  error       RMS and maximum of the distance to the truth (phantoms: `interfacet compare`, all pairs pooled, from the
              mesh to the truth, and RMS of the points more than 6 voxels from every junction and sharp edge,
              which tell of the surface itself: near these, blur sets the error), or to our marching mesh that was not decimated (engine: 50 000 points)
  edges       RMS of the distance from the true sharp edges to the surface, and to the nearest edge of a triangle,
              clear of corners and junctions (phantoms)
  q > 0.3     share of triangles with q = 4 sqrt(3) S / (l1^2 + l2^2 + l3^2) above 0.3
  alone       vertices of the interface between the two solids, in one shell, that the other shell has not, percent
  apart       largest distance of the two shells there
  gap, overlap  volume between the shells and in both of them, cubic voxels (20 000 points on one shell)
  crossings   pairs of triangles that meet where they must not: in each shell alone, and in all shells together
              (`interfacet check`; ours: in the assembly)
  seconds     extraction and decimation together, files included for ours
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from common import OUTSIDE, ROOT, must_run, our_program, python_with, read_assembly, run, write_assembly

PACKAGES = ["vtk", "numpy", "scipy", "pyfqmr", "pymeshlab"]
SEED = 7


# ---- meshes ----------------------------------------------------------------------------------------------------

def write_stl(path, shells):
    import numpy as np

    corners = np.concatenate([shell["p"][shell["t"]] for shell in shells]).astype("<f4")
    out = np.zeros(len(corners), np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
    out["c"] = corners
    path.write_bytes(b"\0" * 80 + np.uint32(len(out)).tobytes() + out.tobytes())


def compacted(positions, triangles, pairs):
    import numpy as np

    used, new = np.unique(triangles, return_inverse=True)
    return {"p": positions[used], "t": new.reshape(-1, 3), "pair": pairs}


def shells_of(positions, triangles, pairs):
    """Each solid's closed shell, wound outwards, with the pair of each triangle."""
    import numpy as np

    out = {}
    for material in sorted(set(pairs.ravel()) - {0, OUTSIDE}):
        back, front = pairs[:, 0] == material, pairs[:, 1] == material
        wound = np.concatenate([triangles[back], triangles[front][:, ::-1]])
        out[int(material)] = compacted(positions, wound, np.concatenate([pairs[back], pairs[front]]))
    return out


def labelled(shell, like):
    """The shell with pairs: those of the nearest triangle of the shell that was decimated."""
    from scipy.spatial import cKDTree

    def centres(s):
        return s["p"][s["t"]].mean(axis=1)

    nearest = cKDTree(centres(like)).query(centres(shell))[1]
    return {**shell, "pair": like["pair"][nearest]}


# ---- decimators: (positions, triangles, wanted number of triangles) -> (positions, triangles) ---------------------

def vtk_poly(p, t):
    import numpy as np
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk

    mesh, points, cells = vtk.vtkPolyData(), vtk.vtkPoints(), vtk.vtkCellArray()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(p, float), deep=True))
    starts = np.arange(0, 3 * len(t) + 1, 3)
    cells.SetData(*(numpy_to_vtk(ids.astype(np.int64).ravel(), deep=True) for ids in (starts, t)))
    mesh.SetPoints(points)
    mesh.SetPolys(cells)
    return mesh


def with_vtk(name, setting):
    def run(p, t, wanted):
        import numpy as np
        import vtk
        from vtk.util.numpy_support import vtk_to_numpy

        tool = getattr(vtk, name)()
        tool.SetInputData(vtk_poly(p, t))
        tool.SetTargetReduction(1.0 - wanted / len(t))
        for key, value in setting.items():
            getattr(tool, "Set" + key)(value)
        tool.Update()
        mesh = tool.GetOutput()
        found = vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        return vtk_to_numpy(mesh.GetPoints().GetData()).astype(float), found.astype(np.int64)

    return run


def with_pyfqmr(p, t, wanted):
    import numpy as np
    import pyfqmr

    tool = pyfqmr.Simplify()
    tool.setMesh(p, t.astype(np.int32))
    tool.simplify_mesh(target_count=wanted, aggressiveness=5, preserve_border=True, verbose=False)
    found = tool.getMesh()
    return np.asarray(found[0], float), np.asarray(found[1], np.int64)


def with_pymeshlab(p, t, wanted):
    import numpy as np
    import pymeshlab

    tool = pymeshlab.MeshSet(verbose=False)
    tool.add_mesh(pymeshlab.Mesh(p, t.astype(np.int32)))
    tool.meshing_decimation_quadric_edge_collapse(
        targetfacenum=wanted, preservenormal=True, preservetopology=True, optimalplacement=True
    )
    mesh = tool.current_mesh()
    return np.asarray(mesh.vertex_matrix(), float), np.asarray(mesh.face_matrix(), np.int64)


DECIMATORS = {
    "vtkQuadricDecimation": ("vtk", with_vtk("vtkQuadricDecimation", {})),
    "vtkDecimatePro": ("vtk", with_vtk("vtkDecimatePro", {"PreserveTopology": True, "Splitting": False})),
    "pyfqmr": ("pyfqmr", with_pyfqmr),
    "MeshLab quadric": ("pymeshlab", with_pymeshlab),
}


# ---- measures --------------------------------------------------------------------------------------------------

def signed_distance(shell, points):
    """From points to a closed shell; negative inside."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    distance = vtk.vtkImplicitPolyDataDistance()
    distance.SetInput(vtk_poly(shell["p"], shell["t"]))
    out = vtk.vtkDoubleArray()
    distance.FunctionValue(numpy_to_vtk(points, deep=True), out)
    return vtk_to_numpy(out).copy()


def areas(p, t):
    import numpy as np

    a, b, c = (p[t[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def samples(p, t, count):
    """Random points, equally many per area."""
    import numpy as np

    random = np.random.default_rng(SEED)
    area = areas(p, t)
    which = t[random.choice(len(t), count, p=area / area.sum())]
    u, v = random.random((2, count))
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])
    a, b, c = (p[which[:, k]] for k in range(3))
    return a + u[:, None] * (b - a) + v[:, None] * (c - a)


def share_above(p, t):
    import numpy as np

    a, b, c = (p[t[:, k]] for k in range(3))
    sides = sum(((x - y) ** 2).sum(axis=1) for x, y in ((a, b), (b, c), (c, a)))
    q = 4 * np.sqrt(3) * areas(p, t) / np.maximum(sides, 1e-300)
    return 100 * (q > 0.3).mean()


def conformity(shells):
    """What becomes of the interface between the first two solids: alone %, apart, gap, overlap."""
    import numpy as np

    low, high = sorted(shells)[:2]

    def interface(shell):
        return shell["t"][(shell["pair"] == [high, low]).all(axis=1)]

    one, other = shells[low], shells[high]
    sheets = [interface(one), interface(other)]
    if min(map(len, sheets)) == 0:
        return None
    places = [{tuple(q) for q in np.round(s["p"][np.unique(t)], 4)} for s, t in zip((one, other), sheets)]
    alone = len(places[0] ^ places[1]) / (len(places[0]) + len(places[1]))
    points = samples(other["p"], sheets[1], 20_000)
    depth = signed_distance(one, points)
    back = signed_distance(other, samples(one["p"], sheets[0], 20_000))
    # What rounding of coordinates to 32 bits leaves is no distance.
    depth, back = (np.where(np.abs(d) < 1e-4, 0, d) for d in (depth, back))
    area = areas(other["p"], sheets[1]).sum()
    apart = max(np.abs(depth).max(), np.abs(back).max())
    return 100 * alone, apart, area * np.maximum(depth, 0).mean(), area * np.maximum(-depth, 0).mean()


def crossings(program, path):
    found = run([program, "check", path, "--json", "-"])
    return json.loads(found.stdout)["defects"]["self_intersections"]["count"]


def against_truth(program, path, truth):
    """RMS and maximum of the error, RMS clear of junctions and edges, RMS from true edges to the surface and to
    edges of triangles."""
    out = path.with_suffix(".json")
    must_run([program, "compare", path, "--truth", truth, "--clear", 6, "--json", out])
    found = json.loads(out.read_text())

    def pooled(parts):
        parts = [part for part in parts if part]
        weight = sum(part["measure"] for part in parts)
        return (sum(part["measure"] * part["voxels"]["rms"] ** 2 for part in parts) / weight) ** 0.5 if weight else None

    every, clear = (
        [pair["mesh_to_truth"][key] for pair in found["pairs"] if pair["in_truth"]] for key in ("all", "clear")
    )
    worst = max(part["voxels"]["max"] for part in every if part)
    edges = [pooled([edge[key] for edge in found["edges"]]) for key in ("to_surface_clear", "to_mesh_edge_clear")]
    return [pooled(every), worst, pooled(clear), *edges]


def against_marching(shells, marching, voxel):
    import numpy as np

    far = [np.abs(signed_distance(marching[m], samples(s["p"], s["t"], 50_000 // len(shells)))) for m, s in shells.items()]
    far = np.concatenate(far) / voxel
    return [float(np.sqrt((far**2).mean())), float(far.max()), None, None, None]


def row(name, program, work, shells, marching, truth, voxel, materials, seconds, assembly=None):
    """One line of the table. `assembly`: our mesh, whose shells share their interfaces."""
    import numpy as np

    triangles = sum(len(s["t"]) for s in shells.values())
    separate = []
    for m, shell in shells.items():
        write_stl(work / f"shell{m}.stl", [shell])
        separate.append(crossings(program, work / f"shell{m}.stl"))
    if assembly is None:
        write_stl(work / "merged.stl", shells.values())
        together = crossings(program, work / "merged.stl")
    else:
        together = crossings(program, assembly)
    if truth is None:
        error = against_marching(shells, marching, voxel)
    else:
        path = assembly
        if path is None:
            # Every interface once: as the shell of the material behind it has it.
            p, t, pairs, start = [], [], [], 0
            for m, s in shells.items():
                own = s["pair"][:, 0] == m
                p.append(s["p"])
                t.append(s["t"][own] + start)
                pairs.append(s["pair"][own])
                start += len(s["p"])
            path = work / "decimated.ply"
            write_assembly(path, np.concatenate(p), np.concatenate(t), np.concatenate(pairs), materials)
        error = against_truth(program, path, truth)
    quality = share_above(
        np.concatenate([s["p"][s["t"]].reshape(-1, 3) for s in shells.values()]), np.arange(3 * triangles).reshape(-1, 3)
    )
    fit = conformity(shells) if len(shells) > 1 else None
    numbers = [f"{e:.3f}" if e is not None else "" for e in error]
    apart = [f"{fit[0]:.0f} %", f"{fit[1] / voxel:.2f}", *(f"{v / voxel**3:.0f}" for v in fit[2:])] if fit else [""] * 4
    cells = [name, str(triangles), *numbers, f"{quality:.1f} %", *apart, " + ".join(map(str, separate)), str(together)]
    print("|", " | ".join([*cells, f"{seconds:.1f}"]), "|", flush=True)


# ---- the comparison --------------------------------------------------------------------------------------------

def available():
    out = {}
    for name, (module, tool) in DECIMATORS.items():
        try:
            __import__(module)
            out[name] = tool
        except ImportError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
    return out


def extracted(program, volume, out, *options):
    start = time.perf_counter()
    done = run([program, "extract", volume, "--out", out, "--accuracy", "paper", "--check", "topology", "-q", *options])
    if done.returncode != 0 and not (out / "assembly.ply").exists():
        raise SystemExit(done.stderr)
    return time.perf_counter() - start, read_assembly(out / "assembly.ply")


def compare_on(title, program, work, volume, extra, truth, tolerances, tools):
    work.mkdir(parents=True, exist_ok=True)
    base, (p, t, pairs, materials) = extracted(program, volume, work / "marching", *extra)
    geometry = json.loads((work / "marching" / "report.json").read_text())["input"]["geometry"]
    voxel = (geometry["spacing"][0] * geometry["spacing"][1] * geometry["spacing"][2]) ** (1 / 3)
    marching = shells_of(p, t, pairs)
    common = dict(program=program, work=work, marching=marching, truth=truth, voxel=voxel, materials=materials)
    print(f"\n{title}\n")
    print("| mesh | triangles of all shells | error RMS | max | clear RMS | edge to surface | edge to mesh edge | q > 0.3 | alone "
          "| apart | gap | overlap | crossings, each shell | together | seconds |")
    print("|---" * 15 + "|")
    row("ours, marching", shells=marching, seconds=base, assembly=work / "marching" / "assembly.ply", **common)
    for tolerance in tolerances:
        out = work / f"dual{tolerance}"
        seconds, mesh = extracted(program, volume, out, *extra, "--method", "dual", "--tolerance", tolerance)
        dual = shells_of(*mesh[:3])
        row(f"ours, dual {tolerance}", shells=dual, seconds=seconds, assembly=out / "assembly.ply", **common)
        for name, tool in tools.items():
            start, found = time.perf_counter(), {}
            for m, shell in marching.items():
                found[m] = tool(shell["p"], shell["t"], len(dual[m]["t"]))
            seconds = base + time.perf_counter() - start
            shells = {m: labelled({"p": f[0], "t": f[1]}, marching[m]) for m, f in found.items()}
            row(name, shells=shells, seconds=seconds, **common)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", type=Path, default=None, help="engine.mha; its first 100 slices are used")
    parser.add_argument("--scenes", nargs="*", default=["press-fit-ring", "flush-cubes"], help="phantoms")
    parser.add_argument("--size", type=int, default=128, help="voxels per axis of the phantoms (default 128)")
    parser.add_argument("--tolerances", type=float, nargs="+", default=[0.1, 0.2], help="voxels (default 0.1 0.2)")
    parser.add_argument("--work", type=Path, default=ROOT / "target" / "peers" / "decimate", help="for files")
    parser.add_argument("--python", default=None, help="a Python with the packages")
    parser.add_argument("--program", default=None, help="the interfacet binary, if already built")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.inside:
        python = python_with(PACKAGES, options.python, "decimate-venv")
        program = our_program(options.program)
        command = [python, __file__, *sys.argv[1:], "--inside", "--program", program]
        raise SystemExit(subprocess.run(list(map(str, command)), env=os.environ).returncode)

    tools, program = available(), Path(options.program).resolve()
    options.work.mkdir(parents=True, exist_ok=True)
    for scene in options.scenes:
        volume = options.work / f"{scene}.mha"
        must_run([program, "phantom", scene, "--size", options.size, "--out", volume])
        title = f"{scene}, {options.size} voxels per axis, sigma 1.15, noise 1 %"
        compare_on(title, program, options.work / scene, volume, [], volume.with_suffix(".phantom.json"), options.tolerances, tools)
    if options.engine:
        extra = ["--roi", ":,:,0:100"]
        compare_on("engine, 256 x 256 x 100; errors from our marching mesh", program, options.work / "engine",
                   options.engine, extra, None, options.tolerances, tools)


if __name__ == "__main__":
    main()
