#!/usr/bin/env python3
"""All tables of docs/accuracy.md: interfacet as published and with models (`--accuracy full`), and what people do now, multi-level
Otsu and then surface nets, beside what is wanted.

    python3 benches/peers/accuracy.py --out DIR                        everything: parts in DIR/parts, then the tables
    python3 benches/peers/accuracy.py --out DIR --docs docs/accuracy.md    and the tables into docs
    python3 benches/peers/accuracy.py --out DIR --tool "full, dual" --scene steps --again    some parts again
    python3 benches/peers/accuracy.py --out DIR --tables               only the tables, of the parts there are

A part is one scene in one image by one method, a JSON file of its own: a run that was stopped goes on where it was, and parts of
an earlier build stay until they are made `--again`. Ours are made by `examples/accuracy_table`, which also says which phantoms;
the peer gets the same ones, made by `interfacet phantom`, and is measured by `interfacet compare`. The peer is told how many
materials there are: scikit-image's threshold_multiotsu (the same by a histogram and dynamic programming, should scikit-image be
missing) makes labels, vtkSurfaceNets3D makes the mesh of them, not smoothed and smoothed with its defaults. Needs cargo (or
--interfacet and --table) and, once, the network: VTK, NumPy and scikit-image are installed from PyPI into a virtual environment
(target/peers/accuracy-venv, or --python for one that has at least the first two). Everything at 112 voxels takes an hour or
so on two cores.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

from common import ROOT, must_run, our_example, our_program, python_with, write_assembly

PACKAGES = ["vtk", "numpy", "scikit-image"]

# As in examples/accuracy_table/cases.rs: the images by column, the scenes by set.
CONDITIONS = ["noise 1 %", "noise 4 %", "cupping 10 %, noise 2 %"]
COMMON = ["wedge", "thin-plate", "thin-gap", "thin-layer", "pores", "fillet"]
SETS = {
    "tuning": ["sphere", "steps", "cube-in-cube", "press-fit-ring", "sphere-on-cylinder", "four-materials", *COMMON],
    "held out": ["sphere", "cube", "flush-cubes", "bolt-in-plate", "four-materials", *COMMON],
}
NUMBER = {"wedge": "--angle", "fillet": "--fillet"}
# Options of accuracy_table by tool; whether the peer smooths.
OURS = {
    "paper": ["--accuracy", "paper"],
    "full, marching": ["--accuracy", "full"],
    "full, dual": ["--accuracy", "full", "--method", "dual"],
}
PEERS = {"surface nets": False, "surface nets, smoothed": True}
TOOLS = [*OURS, *PEERS]
# Marks in the page that holds the summary.
BEGIN, END = "<!-- figures: begin -->", "<!-- figures: end -->"


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

    # Left to itself, scikit-image takes a bin for each integer: thirty thousand, and four classes take hours.
    counts, edges = np.histogram(values, bins=256)
    try:
        from skimage.filters import threshold_multiotsu

        # Where nothing lies between two classes the cut is at the lower one's last bin: its upper edge is meant.
        return threshold_multiotsu(classes=classes, hist=(counts, edges[1:]))
    except ImportError:
        pass
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
        out.append(edges[end])
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


# ---- figures of a comparison, as in examples/accuracy_table/metrics.rs ------------------------------------------

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
    fillets = [f["to_mesh"] for f in found["fillets"]]
    return {
        "interfaces farther than 3 voxels from junctions": worst([s["off_junctions"] for s in splits], "rms", "p99", "max"),
        "the same, and from sharp edges": worst([s["clear"] for s in splits], "rms", "p99", "max"),
        "interfaces within 3 voxels of a junction": worst([s["near_junction"] for s in splits], "rms"),
        "junction curves, wedges of 50 degrees and more, radius 6 and more": curve("plain"),
        "the same, narrower wedges": curve("narrow"),
        "junction curves of a radius under 6": curve("tight"),
        "junction points (four materials)": worst([junctions.get("points", {}).get("distances")], "max"),
        "ends and kinks of junction curves": worst([junctions.get("kinks", {}).get("distances")], "rms", "max"),
        "sharp edges of 90 degrees, farther than 3 voxels from corners and junctions": worst([e["right"]["off_ends"] for e in found["edges"]], "rms", "max"),
        "the same, within 3 voxels of them": worst([e["right"]["at_ends"] for e in found["edges"]], "rms", "max"),
        "volume per material, percent": [max(volumes)] if volumes else None,
        "radius of a sphere by least squares": [max(radii)] if radii else None,
        "roundings": worst(fillets, "rms", "max"),
    }


def reduced(case, phantom, found):
    """What the tables need of one comparison; `found` is None where there is no mesh."""
    title = case["scene"] + (f" {case['number']:g}" if case["number"] else "")
    out = {"object": title, "role": case["role"], "phantom": phantom, "figures": None}
    if found is None:
        return out
    wrong = [f"{m['name']} {m['topology']['components']}/{m['topology']['euler']} for {m['expected']['components']}/{m['expected']['euler']}"
             for m in found["materials"] if m["topology"] != m["expected"]]
    missing = sum(p["in_truth"] and not p["triangles"] for p in found["pairs"])
    wrong += [f"{missing} interfaces missing"] if missing else []
    thin = found["thickness"]
    error = thin and thin["error"] and thin["error"]["voxels"]
    return out | {
        "figures": figures(found),
        "wrong": wrong,
        "thin": thin and {"present": thin["present_percent"], "error": error and [error["signed_mean"], error["p95"]]},
        "coverage": found["coverage"][0] if found["coverage"] else None,
    }


# ---- parts ------------------------------------------------------------------------------------------------------

def number(value):
    return f"{value:g}" if value == value and abs(value) < 1e6 else "inf"


class Run:
    """The parts, each a JSON file in OUT/parts/SET/TOOL: made once, and again only where asked for."""

    def __init__(self, options):
        self.options = options
        self.parts = options.out / "parts"
        self.program = Path(options.interfacet).resolve()
        self.table = Path(options.table).resolve()

    def path(self, which, tool, scene, column):
        return self.parts / which / tool.replace(" ", "-").replace(",", "") / f"{scene}-{column + 1}.json"

    def write(self, path, part):
        path.parent.mkdir(parents=True, exist_ok=True)
        # Whole or not there.
        scrap = path.with_suffix(".part")
        scrap.write_text(json.dumps(part) + "\n")
        scrap.replace(path)

    def ours(self, which, tool, scene, column):
        """A part of our own program, made unless it is there."""
        path = self.path(which, tool, scene, column)
        if not path.exists():
            scrap = path.with_suffix(".all")
            path.parent.mkdir(parents=True, exist_ok=True)
            held_out = ["--held-out"] if which == "held out" else []
            must_run([self.table, *OURS[tool], *held_out, "--scene", scene, "--column", column + 1,
                      "--size", self.options.size, "--json", scrap])
            found = json.loads(scrap.read_text())
            scrap.unlink()
            runs = []
            for run in found["runs"]:
                made = run["found"].get("Ok")
                part = reduced(run["case"], run["phantom"], made and made["comparison"])
                runs.append(part | {"case": run["case"], "defects": made and made["defects"]})
            self.write(path, {"targets": found["targets"], "runs": runs})
        return json.loads(path.read_text())

    def peers(self, which, scene, column):
        """The parts of the peer, smoothed and not, of the phantoms of the published method's part."""
        paths = {tool: self.path(which, tool, scene, column) for tool in PEERS}
        if all(path.exists() for path in paths.values()):
            return
        runs = {tool: [] for tool in PEERS}
        work = self.options.out / "work"
        work.mkdir(parents=True, exist_ok=True)
        for run in self.ours(which, "paper", scene, column)["runs"]:
            p, volume, mesh = run["phantom"], work / "phantom.mha", work / "peer.ply"
            place = ["--size", p["size"][0], "--fill", p["fill"], "--seed", p["seed"], "--sigma", p["sigma"],
                     "--rotate=" + ",".join(map(str, p["rotation"])), "--noise", p["noise"]["percent"],
                     "--cupping", p["cupping"]]
            own = [NUMBER.get(scene, "--thickness"), run["case"]["number"]] if run["case"]["number"] else []
            must_run([self.program, "phantom", scene, *own, *place, "--uncompressed", "--out", volume])
            truth = volume.with_suffix(".phantom.json")
            for tool, smooth in PEERS.items():
                found = None
                if peer(volume, truth, mesh, smooth):
                    out = mesh.with_suffix(".json")
                    must_run([self.program, "compare", mesh, "--truth", truth, "--json", out])
                    found = json.loads(out.read_text())
                runs[tool].append(reduced(run["case"], p, found))
        for tool, path in paths.items():
            self.write(path, {"runs": runs[tool]})

    def wanted(self):
        """All parts asked for, cheapest column first."""
        chosen = self.options
        for column in chosen.column or range(len(CONDITIONS)):
            for which, scenes in SETS.items():
                for scene in scenes:
                    for tool in [*OURS, "surface nets"]:
                        if ((chosen.set in (None, which)) and (not chosen.scene or scene in chosen.scene)
                                and (not chosen.tool or tool in chosen.tool)):
                            yield which, tool, scene, column

    def make(self):
        todo = list(self.wanted())
        if self.options.again:
            for which, tool, scene, column in todo:
                for one in PEERS if tool in PEERS else [tool]:
                    self.path(which, one, scene, column).unlink(missing_ok=True)
        for done, (which, tool, scene, column) in enumerate(todo):
            print(f"{done + 1}/{len(todo)} {which}: {scene}, {CONDITIONS[column]}: {tool}", file=sys.stderr, flush=True)
            if tool in OURS:
                self.ours(which, tool, scene, column)
            else:
                self.peers(which, scene, column)


# ---- tables -----------------------------------------------------------------------------------------------------

def load(run):
    """(set, column, tool) to the runs there are, and the targets."""
    found, targets = {}, []
    for which, scenes in SETS.items():
        for column in range(len(CONDITIONS)):
            for tool in TOOLS:
                for scene in scenes:
                    path = run.path(which, tool, scene, column)
                    if path.exists():
                        part = json.loads(path.read_text())
                        targets = part.get("targets", targets)
                        found.setdefault((which, column, tool), []).extend(part["runs"])
    return found, targets


def values(run, title):
    return (run["figures"] or {}).get(title)


# The object that is wanted less of, in rows of its own, and which rows.
NARROW = "wedge 30"
OF_NARROW = ["the same, and from sharp edges", "interfaces within 3 voxels of a junction", "ends and kinks of junction curves", "volume per material, percent"]


def row(runs, target, column, of, prefix, out):
    """A line of the summary: the worst of the runs that `of` picks, by tool."""
    title, wanted = target["title"], [] if prefix else target["wanted"][column]
    cells = []
    for tool in TOOLS:
        picked = [values(r, title) for r in runs[tool] if of(r)]
        worst = [max(v) for v in zip(*filter(None, picked))]
        good = [k >= len(wanted) or v <= wanted[k] for k, v in enumerate(worst)]
        bold = tool.startswith("full")
        cells.append(" / ".join(f"{v:.3f}" if ok or not bold else f"**{v:.3f}**" for v, ok in zip(worst, good)) or "-")
    if any(cell != "-" for cell in cells):
        names = {"the same, and from sharp edges": "interfaces farther than 3 voxels from junctions and edges"} if prefix else {}
        name = prefix + names.get(title, title) + (f": {' / '.join(target['figures'])}" if len(target["figures"]) > 1 else "")
        out(f"| {name} | {' / '.join(map(number, wanted)) or '-'} | {' | '.join(cells)} |")


def summary(found, targets, out):
    """The worst of all objects, by set and image."""
    for which in SETS:
        for column, condition in enumerate(CONDITIONS):
            runs = {tool: found.get((which, column, tool), []) for tool in TOOLS}
            if not any(runs.values()):
                continue
            out(f"\n### {which.capitalize()} objects, {condition}\n")
            out(f"| voxels | wanted | {' | '.join(TOOLS)} |")
            out("|---" * (2 + len(TOOLS)) + "|")
            rows = lambda run: run["role"] == "general" and run["object"] != NARROW
            for target in targets:
                # Narrower wedges are that object's.
                of = (lambda run: run["role"] == "general") if "narrower" in target["title"] else rows
                row(runs, target, column, of, "", out)
            for target in targets:
                if target["title"] in OF_NARROW:
                    row(runs, target, column, lambda run: run["object"] == NARROW, f"{NARROW} alone: ", out)
            for name, of in [
                ("objects without a mesh", lambda r: not r["figures"]),
                ("objects of wrong topology", lambda r: bool(r.get("wrong"))),
                ("defects", lambda r: bool(r.get("defects"))),
            ]:
                cells = [", ".join(r["object"] for r in runs[tool] if r["role"] == "general" and of(r)) or "none" for tool in TOOLS]
                if name == "defects":
                    cells = [cell if tool in OURS else "-" for cell, tool in zip(cells, TOOLS)]
                out(f"| {name} | none | {' | '.join(cells)} |")


def thin(found, out):
    """Plates, gaps, layers, pores, roundings."""
    out("\n### Thin parts, small spheres, roundings\n")
    out("Thickness less the exact one, mean / 95 % of its size (wanted: 95 % within 0.15, right topology); largest error of a")
    out("sphere's radius; distance from a rounding to the mesh, RMS / max (a sharp edge in its place: 0.29 of its radius).\n")
    out(f"| set, object, image | {' | '.join(TOOLS)} |")
    out("|---" * (1 + len(TOOLS)) + "|")
    for which in SETS:
        runs = [r for c in range(len(CONDITIONS)) for tool in TOOLS for r in found.get((which, c, tool), [])]
        objects = list(dict.fromkeys((r["object"], r["role"]) for r in runs if r["role"] != "general"))
        for name, role in objects:
            for column, condition in enumerate(CONDITIONS):
                cells = []
                for tool in TOOLS:
                    run = next((r for r in found.get((which, column, tool), []) if r["object"] == name), None)
                    cells.append(small(run, role, tool.startswith("full")))
                if any(cell != "-" for cell in cells):
                    out(f"| {which}, {name}, {condition} | {' | '.join(cells)} |")


def small(run, role, bold):
    if run is None:
        return "-"
    if not run["figures"]:
        return "no mesh"
    if role == "thin":
        t = run["thin"] or {}
        error = t.get("error")
        good = error and error[1] <= 0.15 and t["present"] > 99.9 and not run["wrong"]
        text = f"{error[0]:+.2f} / {error[1]:.2f}" if error else "lost"
        text += f", {t['present']:.0f} % there" if error and t["present"] <= 99.9 else ""
        text += ", topology" if error and run["wrong"] else ""
    elif role == "small":
        radius = (values(run, "radius of a sphere by least squares") or [float("inf")])[0]
        good = radius <= 0.15 and not run["wrong"]
        text = "lost" if radius == float("inf") else f"{radius:.3f}"
    else:
        good, v = True, values(run, "roundings")
        text = " / ".join(f"{x:.2f}" for x in v) if v else "-"
    return text if good or not bold else f"**{text}**"


def coverage(found, out):
    """Shares of vertices within one and two standard deviations."""
    out("\n### Stated standard deviations\n")
    out("Vertices whose error is within one / two stated standard deviations, percent, all objects together (wanted: 68 / 95,")
    out("five points either way).\n")
    groups = {"all": "all", "clear": "clear of edges and junctions by 2R", "near_edge": "near sharp edges", "near_junction": "near junctions"}
    out(f"| set, image, method | {' | '.join(groups.values())} |")
    out("|---" * (1 + len(groups)) + "|")
    for (which, column, tool), runs in found.items():
        cells = []
        for group in groups:
            parts = [c[group] for r in runs if (c := r.get("coverage")) and c[group]]
            n = sum(p["vertices"] for p in parts)
            shares = [sum(p[key] * p["vertices"] for p in parts) / n for key in ("within_1", "within_2")] if n else None
            good = shares and all(abs(s - w) <= 5 for s, w in zip(shares, (68.3, 95.4)))
            text = " / ".join(f"{s:.0f}" for s in shares) if shares else "-"
            cells.append(text if good or not shares else f"**{text}**")
        if any(cell != "-" for cell in cells):
            out(f"| {which}, {CONDITIONS[column]}, {tool} | {' | '.join(cells)} |")


EACH = [
    ("clear interfaces RMS", "the same, and from sharp edges", 0),
    ("max", "the same, and from sharp edges", 2),
    ("within 3 of a junction RMS", "interfaces within 3 voxels of a junction", 0),
    ("curves RMS", "junction curves, wedges of 50 degrees and more, radius 6 and more", 0),
    ("max", "junction curves, wedges of 50 degrees and more, radius 6 and more", 1),
    ("90 degree edges RMS", "sharp edges of 90 degrees, farther than 3 voxels from corners and junctions", 0),
    ("max", "sharp edges of 90 degrees, farther than 3 voxels from corners and junctions", 1),
    ("volume %", "volume per material, percent", 0),
]


def objects(found, out):
    """A row for each object, image and tool."""
    out("| set, object, image | method | " + " | ".join(name for name, _, _ in EACH) + " | topology |")
    out("|---" * (3 + len(EACH)) + "|")
    rows = {}
    for (which, column, tool), runs in found.items():
        for run in runs:
            if run["role"] == "general":
                rows.setdefault((which, run["object"], column), {})[tool] = run
    for (which, name, column), by_tool in rows.items():
        for tool in TOOLS:
            if (run := by_tool.get(tool)) is None:
                continue
            cells = [f"{v[k]:.3f}" if (v := values(run, title)) else "-" for _, title, k in EACH]
            topology = "; ".join(run["wrong"]) or "right" if run["figures"] else "no mesh"
            out(f"| {which}, {name}, {CONDITIONS[column]} | {tool} | {' | '.join(cells)} | {topology} |")


def tables(run):
    found, targets = load(run)
    lines = []
    summary(found, targets, lines.append)
    thin(found, lines.append)
    coverage(found, lines.append)
    text = "\n".join(lines) + "\n"
    (run.options.out / "summary.md").write_text(text)
    lines = ["# Accuracy: every object", "", "Made by `benches/peers/accuracy.py`; what is measured: [accuracy.md](accuracy.md). Voxels, volumes in percent.", ""]
    objects(found, lines.append)
    (run.options.out / "objects.md").write_text("\n".join(lines) + "\n")
    if run.options.docs:
        page = run.options.docs.read_text()
        head, rest = page.split(BEGIN)
        _, tail = rest.split(END)
        run.options.docs.write_text(f"{head}{BEGIN}\n{text}\n{END}{tail}")
        run.options.docs.with_name("accuracy_objects.md").write_text("\n".join(lines) + "\n")
    print(f"{run.options.out / 'summary.md'}, {run.options.out / 'objects.md'}", file=sys.stderr)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "target" / "peers" / "accuracy", help="for parts and tables")
    parser.add_argument("--set", choices=list(SETS), help="only these objects")
    parser.add_argument("--scene", nargs="+", help="only these scenes")
    parser.add_argument("--tool", nargs="+", choices=[*OURS, "surface nets"], help="only these (surface nets: smoothed and not)")
    parser.add_argument("--column", nargs="+", type=lambda text: int(text) - 1, help="only these images: 1 (noise 1 %%), 2 (noise 4 %%), 3 (cupping)")
    parser.add_argument("--again", action="store_true", help="make the parts asked for even where they are there")
    parser.add_argument("--tables", action="store_true", help="make no parts, only the tables of those there are")
    parser.add_argument("--docs", type=Path, help="put the summary into this page, between its marks, and the table of objects beside it")
    parser.add_argument("--size", type=int, default=112, help="voxels per axis (default 112); use another --out for each")
    parser.add_argument("--python", default=None, help="a Python with vtk and numpy")
    parser.add_argument("--interfacet", default=None, help="the interfacet binary, if already built")
    parser.add_argument("--table", default=None, help="the example accuracy_table, if already built")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.inside:
        python = python_with(PACKAGES, options.python, "accuracy-venv")
        program = our_program(options.interfacet)
        table = options.table or our_example("accuracy_table")
        command = [python, __file__, *sys.argv[1:], "--inside", "--interfacet", program, "--table", table]
        raise SystemExit(subprocess.run(list(map(str, command))).returncode)
    run = Run(options)
    options.out.mkdir(parents=True, exist_ok=True)
    if not options.tables:
        run.make()
    tables(run)


if __name__ == "__main__":
    main()
