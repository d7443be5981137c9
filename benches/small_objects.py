#!/usr/bin/env python3
"""Small phantoms by models, against the truth: topology, junction curves, volumes. They show what larger ones hide; two minutes on two cores.

    python3 benches/small_objects.py                       all objects, the program as built in target/release
    python3 benches/small_objects.py --only wedge          those with this in their name
    python3 benches/small_objects.py --interfacet PATH     another build of the program, to compare two

Prints for each object with junctions the distance of the true curves to the mesh's (RMS / maximum, voxels), the same of narrow wedges, and
volume errors in percent; then the objects of wrong topology. Phantoms are kept in --folder and made once. Needs Python alone.
"""

import argparse
import json
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROTATIONS = ["7.3,11.9,4.1", "23,-15,32", "41,9,-20", "12,33,7"]
# Seed and percent of noise of each rotation's image, as in tests/turned.rs.
IMAGES = [(1, 1), (7, 4), (3, 1), (1, 1)]


def objects():
    """Name, scene and options of each."""
    for thickness, noise, sizes in [(2.5, 1, (60, 64, 68, 72, 80)), (3, 4, (60, 64, 68, 72))]:
        for size in sizes:
            yield f"gap{thickness}-{size}", "thin-gap", {"size": size, "thickness": thickness, "noise": noise}
    for scene, sizes in [("thin-plate", (64, 72)), ("thin-layer", (64,))]:
        for size in sizes:
            yield f"{scene}-{size}", scene, {"size": size, "thickness": 2.5}
    for scene, sizes in [("four-materials", (48, 56)), ("press-fit-ring", (56, 64)), ("cube-in-cube", (56, 64))]:
        for size in sizes:
            for i, (rotation, (seed, noise)) in enumerate(zip(ROTATIONS, IMAGES)):
                options = {"size": size, "rotate": rotation, "seed": seed, "noise": noise, "fine": 2}
                yield f"{scene}-{size}-{i}", scene, options
    yield "sphere-on-cylinder-80", "sphere-on-cylinder", {"size": 80}
    for size in (96, 112):
        yield f"pores-{size}", "pores", {"size": size}
    for angle in (30, 45, 60):
        for size in (80, 96):
            wedge = {"angle": angle, "size": size, "fine": 2}
            for noise in (1, 4):
                yield f"wedge{angle}-{size}-{noise}", "wedge", {**wedge, "noise": noise}
            yield f"wedge{angle}-{size}-turned", "wedge", {**wedge, "rotate": ROTATIONS[1], "seed": 7}


def measured(program, folder, name, scene, options):
    """What `compare` says of the object's mesh, and whether the mesh has defects."""
    volume = folder / f"{name}.mha"
    truth = folder / f"{name}.phantom.json"
    if not truth.exists():
        given = [f"--{key}={value}" for key, value in {"fill": 0.85, **options}.items()]
        subprocess.run([program, "phantom", scene, "--out", volume, *given], check=True, capture_output=True)
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "result"
        extract = [program, "extract", volume, "--out", out, "--quiet", "--threads", "1"]
        sound = subprocess.run(extract, capture_output=True).returncode == 0
        mesh, figures = out / "assembly.ply", Path(scratch) / "figures.json"
        compare = [program, "compare", mesh, "--truth", truth, "--json", figures]
        subprocess.run(compare, check=True, capture_output=True)
        return json.loads(figures.read_text()), sound


def distance(part):
    voxels = (part or {}).get("truth_to_mesh")
    return f"{voxels['voxels']['rms']:.3f} / {voxels['voxels']['max']:.3f}" if voxels else "-"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--interfacet", default=ROOT / "target/release/interfacet")
    parser.add_argument("--folder", type=Path, default=ROOT / "target/small-objects")
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    chosen = [each for each in objects() if options.only in each[0]]
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(lambda each: measured(options.interfacet, options.folder, *each), chosen))
    wrong = []
    for (name, _, _), (figures, sound) in zip(chosen, found):
        materials, junctions = figures["materials"], figures["junctions"]
        if junctions and junctions.get("truth_to_mesh"):
            volumes = " ".join(f"{m['volume_error_percent']:+.3f}" for m in materials[1:])
            print(f"{name:24} curves {distance(junctions):15} narrow {distance(junctions.get('narrow')):15} volumes {volumes}")
        differs = [f"{m['name']} {m['topology']}, not {m['expected']}" for m in materials if m["topology"] != m["expected"]]
        if differs or not sound:
            wrong.append(f"{name}: {'; '.join(differs)}{'' if sound else ' DEFECTS'}")
    print(*wrong, f"{len(chosen) - len(wrong)} of {len(chosen)} are right", sep="\n")


if __name__ == "__main__":
    main()
