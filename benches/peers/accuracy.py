#!/usr/bin/env python3
"""Compares the accuracy of interfacet with that of what people do now: multi-level Otsu, then surface nets.

    python3 benches/peers/accuracy.py
    python3 benches/peers/accuracy.py --interfacet target/release/interfacet --python /path/to/python --size 96
    python3 benches/peers/accuracy.py --objects wedge:30 --ours "--method dual" --ours ""

The phantoms are those of `examples/accuracy_table` (tuning set), made by `interfacet phantom`. The peer is told how many
materials there are: scikit-image's threshold_multiotsu (the same by a histogram and dynamic programming, should
scikit-image be missing) makes labels, vtkSurfaceNets3D makes the mesh of them, not smoothed and smoothed with its
defaults. Every mesh is measured by `interfacet compare`; what cannot be extracted is marked `none`. Needs cargo (or
--interfacet) and, once, the network: VTK, NumPy and scikit-image are installed from PyPI into a virtual environment
(target/peers/accuracy-venv, or --python for one that has at least the first two).
"""

import argparse
import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from common import ROOT, must_run, our_program, python_with, run, write_assembly

PACKAGES = ["vtk", "numpy", "scikit-image"]

# The images, by column, as in examples/accuracy_table/cases.rs.
CONDITIONS = {
    "noise 1 %": ["--noise", 1],
    "noise 4 %": ["--noise", 4],
    "cupping 10 %, noise 2 %": ["--noise", 2, "--cupping", 0.1],
}
OBJECTS = ["sphere", "steps", "cube-in-cube", "press-fit-ring", "sphere-on-cylinder", "four-materials", "wedge:60", "wedge:30"]
THIN = ["thin-plate:2.5", "thin-plate:3", "thin-gap:2.5", "thin-gap:3", "thin-layer:2.5", "thin-layer:3"]
NUMBER = {"wedge": "--angle", "fillet": "--fillet"}


# ---- the peer ----------------------------------------------------------------------------------------------------

def read_volume(path):
    """Grey values as [z, y, x], spacing and origin of an uncompressed .mha of 16-bit voxels, as we write it."""
    import numpy as np

    data = path.read_bytes()
    end = data.index(b"ElementDataFile = LOCAL\n") + len(b"ElementDataFile = LOCAL\n")
    header = dict(line.split(" = ", 1) for line in data[:end].decode().splitlines())
    size = [int(n) for n in header["DimSize"].split()]
    numbers = [[float(n) for n in header[key].split()] for key in ("ElementSpacing", "Offset")]
    if header["ElementType"] != "MET_USHORT" or header["CompressedData"] != "False":
        raise SystemExit(f"{path} is not an uncompressed volume of 16-bit voxels")
    return np.frombuffer(data, "<u2", offset=end).reshape(size[::-1]), *numbers


def otsu(values, classes):
    """Thresholds of multi-level Otsu on a histogram of 256 bins."""
    import numpy as np

    try:
        from skimage.filters import threshold_multiotsu

        return threshold_multiotsu(values, classes=classes)
    except ImportError:
        pass
    counts, edges = np.histogram(values, bins=256)
    centres = 0.5 * (edges[1:] + edges[:-1])
    weight = np.concatenate([[0], np.cumsum(counts)]).astype(float)
    moment = np.concatenate([[0], np.cumsum(counts * centres)])
    # score[i, j]: what bins i to j - 1 as one class add to the variance between classes.
    with np.errstate(divide="ignore", invalid="ignore"):
        score = (moment[None, :] - moment[:, None]) ** 2 / (weight[None, :] - weight[:, None])
    score = np.where(weight[None, :] > weight[:, None], score, -np.inf)
    best, cuts = score[0], []
    for _ in range(classes - 1):
        total = best[:, None] + score
        cuts.append(total.argmax(axis=0))
        best = total.max(axis=0)
    end, out = len(centres), []
    for cut in reversed(cuts):
        end = cut[end]
        out.append(centres[end - 1])
    return np.array(out[::-1])


def surface_nets(labels, spacing, origin, classes, smooth):
    """Positions, triangles and pairs (back, front), wound so that normals point from back to front."""
    import numpy as np
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    image = vtk.vtkImageData()
    image.SetDimensions(labels.shape[::-1])
    image.SetSpacing(spacing)
    image.SetOrigin(origin)
    image.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(labels).ravel(), deep=True))
    nets = vtk.vtkSurfaceNets3D()
    nets.SetInputData(image)
    nets.SetBackgroundLabel(0)
    for k in range(1, classes):
        nets.SetValue(k - 1, k)
    nets.SetOutputMeshTypeToTriangles()
    nets.SetSmoothing(smooth)
    nets.Update()
    mesh = nets.GetOutput()
    if mesh.GetNumberOfPolys() == 0:
        return None
    p = vtk_to_numpy(mesh.GetPoints().GetData()).astype(float)
    t = vtk_to_numpy(mesh.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64)
    pairs = vtk_to_numpy(mesh.GetCellData().GetArray("BoundaryLabels")).astype(np.int64)
    # The label behind is the first that a triangle names; ours is the larger one.
    flip = pairs[:, 0] < pairs[:, 1]
    t[flip] = t[flip][:, ::-1]
    pairs = np.sort(pairs, axis=1)[:, ::-1]
    return p, t, pairs


def agree_with_labels(labels, spacing, origin, p, t, pairs):
    """Share of triangles, by area, half a voxel behind which their back label lies."""
    import numpy as np

    a, b, c = (p[t[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-300)[:, None]
    at = ((a + b + c) / 3 - 0.5 * np.min(spacing) * normal - origin) / spacing
    index = np.clip(np.rint(at).astype(int), 0, np.array(labels.shape[::-1]) - 1)
    right = labels[index[:, 2], index[:, 1], index[:, 0]] == pairs[:, 0]
    return float((area * right).sum() / area.sum())


def kinds(count, t, pairs):
    """By how many materials meet at a vertex: 2, 3, or 4 for more."""
    import numpy as np

    # Each vertex with each material of its triangles, once.
    both = np.unique(np.concatenate([(t[:, k] << 8) | pairs[:, side] for k in range(3) for side in range(2)]))
    return np.clip(np.bincount(both >> 8, minlength=count), 2, 4)


def peer(volume, truth, out, smooth):
    """Writes the peer's mesh of a volume; false if it has none."""
    import numpy as np

    values, spacing, origin = read_volume(volume)
    materials = json.loads(truth.read_text())["materials"]
    # As scikit-image's own example makes labels of thresholds.
    labels = np.digitize(values, otsu(values, len(materials))).astype(np.uint8)
    mesh = surface_nets(labels, spacing, origin, len(materials), smooth)
    if mesh is None:
        return False
    p, t, pairs = mesh
    if not smooth and agree_with_labels(labels, spacing, origin, p, t, pairs) < 0.9:
        raise SystemExit("this version of VTK winds its triangles in another way")
    comments = [f"comment material {m['id']} {m['name']} {m['grey']}" for m in materials]
    write_assembly(out, p, t, pairs, comments, kinds(len(p), t, pairs))
    return True


# ---- figures, as in examples/accuracy_table/metrics.rs ----------------------------------------------------------

def figures(found):
    """Name to values of a comparison's JSON; worst of pairs and of both ways."""
    def worst(parts, *keys):
        parts = [part["voxels"] for part in parts if part]
        return [max(part[key] for part in parts) for key in keys] if parts else None

    splits = [pair[way]["close"] for pair in found["pairs"] for way in ("mesh_to_truth", "truth_to_mesh")]
    junctions = found["junctions"] or {}

    def curve(name):
        return worst(list(junctions.get(name, {}).values()), "rms", "max")

    volumes = [abs(m["volume_error_percent"]) for m in found["materials"] if m["volume_error_percent"] is not None]
    radii = [abs(s["fit"]["radius_error"]) if s["fit"] else float("inf") for s in found["spheres"]]
    thin = found["thickness"] and found["thickness"]["error"]
    return {
        "interfaces farther than 3 voxels from junctions: RMS / 99 % / max": worst([s["off_junctions"] for s in splits], "rms", "p99", "max"),
        "the same, and from sharp edges: RMS / 99 % / max": worst([s["clear"] for s in splits], "rms", "p99", "max"),
        "interfaces within 3 voxels of a junction: RMS": worst([s["near_junction"] for s in splits], "rms"),
        "junction curves, wedges of 50 degrees and more, radius 6 and more: RMS / max": curve("plain"),
        "the same, narrower wedges: RMS / max": curve("narrow"),
        "junction points (four materials): max": worst([junctions.get("points", {}).get("distances")], "max"),
        "ends and kinks of junction curves: RMS / max": worst([junctions.get("kinks", {}).get("distances")], "rms", "max"),
        "sharp edges of 90 degrees, farther than 3 voxels from corners and junctions: RMS / max": worst([e["right"]["off_ends"] for e in found["edges"]], "rms", "max"),
        "volume per material, percent": [max(volumes)] if volumes else None,
        "radius of a sphere by least squares": [max(radii)] if radii else None,
        "thickness of thin parts: 95 %": [thin["p95"]] if (thin := thin and thin["voxels"]) else None,
        "interfaces without a triangle": [float(sum(p["in_truth"] and not p["triangles"] for p in found["pairs"]))],
        "wrong shells": [float(sum(m["topology"] != m["expected"] for m in found["materials"]))],
    }


def compared(program, mesh, truth):
    out = mesh.with_suffix(".json")
    must_run([program, "compare", mesh, "--truth", truth, "--json", out])
    return figures(json.loads(out.read_text()))


def table(title, rows, tools, results):
    """The worst of all objects, for each image a column for each tool; how many objects have no mesh below."""
    print(f"\n## {title}\n")
    columns = [(condition, tool) for condition in CONDITIONS for tool in tools]
    print("| voxels |", " | ".join(f"{condition}: {tool}" for condition, tool in columns), "|")
    print("|---" * (1 + len(columns)) + "|")
    for row in rows:
        cells = []
        for column in columns:
            values = [found[row] for found in results.get(column, {}).values() if found and found.get(row)]
            cells.append(" / ".join(f"{max(v):.3f}" for v in zip(*values)) if values else "-")
        if any(cell != "-" for cell in cells):
            print("|", " | ".join([row, *cells]), "|")
    missing = [", ".join(o for o, found in results.get(c, {}).items() if not found) or "none" for c in columns]
    print("|", " | ".join(["objects without a mesh", *missing]), "|", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", nargs="+", default=OBJECTS + THIN, help="scenes, with their number: wedge:30")
    parser.add_argument("--size", type=int, default=112, help="voxels per axis (default 112)")
    parser.add_argument("--fill", type=float, default=0.85, help="share of that which the object takes up (default 0.85)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rotate", default="7.3,11.9,4.1", help="degrees about x, y, z")
    parser.add_argument("--ours", action="append", help="options of our extract; may be given several times (default: none)")
    parser.add_argument("--each", action="store_true", help="a table for each object as well")
    parser.add_argument("--json", type=Path, default=None, help="write all figures to this file")
    parser.add_argument("--work", type=Path, default=ROOT / "target" / "peers" / "accuracy", help="for files")
    parser.add_argument("--python", default=None, help="a Python with vtk and numpy")
    parser.add_argument("--interfacet", default=None, help="the interfacet binary, if already built")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.inside:
        python = python_with(PACKAGES, options.python, "accuracy-venv")
        program = our_program(options.interfacet)
        command = [python, __file__, *sys.argv[1:], "--inside", "--interfacet", program]
        raise SystemExit(subprocess.run(list(map(str, command))).returncode)

    program = Path(options.interfacet).resolve()
    options.work.mkdir(parents=True, exist_ok=True)
    ours = {f"ours {text}".strip(): shlex.split(text) for text in options.ours or [""]}
    peers = {"surface nets": False, "surface nets, smoothed": True}
    results = {}
    for name in options.objects:
        scene, _, number = name.partition(":")
        own = [NUMBER.get(scene, "--thickness"), number] if number else []
        for column, (condition, image) in enumerate(CONDITIONS.items()):
            volume = options.work / f"{scene}{number}-{column}.mha"
            truth = volume.with_suffix(".phantom.json")
            place = ["--size", options.size, "--fill", options.fill, "--seed", options.seed, f"--rotate={options.rotate}"]
            must_run([program, "phantom", scene, *own, *place, *image, "--uncompressed", "--out", volume])
            for tool, extra in ours.items():
                out = options.work / "ours"
                shutil.rmtree(out, ignore_errors=True)
                done = run([program, "extract", volume, "--out", out, "--check", "topology", "-q", *extra])
                made = (out / "assembly.ply").exists()
                if not made:
                    print(f"{name}, {condition}: {done.stderr.strip()}", file=sys.stderr)
                found = compared(program, out / "assembly.ply", truth) if made else None
                results.setdefault((condition, tool), {})[name] = found
            for tool, smooth in peers.items():
                out = options.work / "peer.ply"
                found = compared(program, out, truth) if peer(volume, truth, out, smooth) else None
                results.setdefault((condition, tool), {})[name] = found
            volume.unlink()
        print(name, file=sys.stderr, flush=True)

    tools = [*ours, *peers]
    rows = list(dict.fromkeys(row for column in results.values() for found in column.values() if found for row in found))
    sets = {"Worst of all objects": [o for o in options.objects if not o.startswith("thin")],
            "Worst of all thin parts": [o for o in options.objects if o.startswith("thin")]}
    if options.each:
        sets |= {o: [o] for o in options.objects}
    for title, members in sets.items():
        if members:
            part = {c: {o: f for o, f in column.items() if o in members} for c, column in results.items()}
            table(title, rows, tools, part)
    if options.json:
        flat = [{"image": c, "tool": t, "object": o, "figures": f} for (c, t), column in results.items() for o, f in column.items()]
        options.json.write_text(json.dumps(flat, indent=1) + "\n")


if __name__ == "__main__":
    main()
