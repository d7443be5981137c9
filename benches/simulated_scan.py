#!/usr/bin/env python3
"""Scans simulated with their physics, and how far meshes of them are from the exact objects. Needs numpy and scipy.

    python3 benches/simulated_scan.py                          all objects: the published method, models by marching and dual
    python3 benches/simulated_scan.py --only ring --keep DIR   one object; its scan stays in DIR
    python3 benches/simulated_scan.py --interfacet PATH        another build of the program, to compare two

Phantoms of this project are blurred Gaussians with white noise, which is what its models suppose. Here an object (labels on a grid twice as
fine) is seen by a polychromatic parallel beam: four energies, path lengths through each material, intensities averaged over a detector's
pixel, an unsharp focus, scatter (a hundredth of what arrives, smooth), quanta; then the logarithm without any correction and filtered back
projection (Shepp and Logan). So there is beam hardening (iron's grey value varies by a tenth within a part), shadows and streaks between
dense parts, intensities averaged where path lengths should be, and noise that hangs together. A minute an object on two cores.
"""

import argparse
import json
import subprocess
import tempfile
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import scipy.sparse as sparse
from scipy.ndimage import gaussian_filter1d

ROOT = Path(__file__).resolve().parent.parent
SIZE, FINE, VIEWS = 128, 2, 400
SHIFT = (0.31, -0.17, 0.23)
TURNED = "19,-12,27"
OBJECTS = {
    "ring": ("press-fit-ring", "7.3,11.9,4.1"),
    "bolt": ("bolt-in-plate", TURNED),
    "four": ("four-materials", TURNED),
    "wedge": ("wedge", TURNED),
    "cubes": ("cube-in-cube", TURNED),
    "fillet": ("fillet", TURNED),
}
METHODS = {
    "paper": ["--accuracy", "paper"],
    "full, marching": ["--accuracy", "full"],
    "full, dual": ["--accuracy", "full", "--method", "dual"],
}
# Attenuation per voxel (0.1 mm) at 50, 70, 90 and 120 keV, and the share of each energy in what the detector counts.
ALUMINIUM = np.array([0.0099, 0.0065, 0.0052, 0.0044])
TITANIUM = np.array([0.0243, 0.0108, 0.0063, 0.00383])
IRON = np.array([0.0462, 0.0198, 0.0117, 0.0069])
SPECTRUM = np.array([0.2, 0.35, 0.3, 0.15])
PARTS = {2: [IRON], 3: [ALUMINIUM, IRON], 4: [ALUMINIUM, TITANIUM, IRON]}
# Sigma of the focus on the detector and of the scatter, pixels; quanta of a pixel without object.
UNSHARP, SPREAD, SCATTER, QUANTA = 0.6, 20.0, 0.01, 1.5e6


def run(*command):
    return subprocess.run([str(word) for word in command], check=True, capture_output=True)


def truth_of(volume):
    return volume.with_suffix(".phantom.json")


def header_and_samples(path):
    """A MetaImage's header, without what says of compression, and its samples."""
    data = path.read_bytes()
    end = data.index(b"LOCAL\n") + len(b"LOCAL\n")
    packed, samples = b"CompressedData = True" in data[:end], data[end:]
    lines = [line for line in data[:end].splitlines(keepends=True) if not line.startswith(b"Compressed")]
    return b"".join(lines), np.frombuffer(zlib.decompress(samples) if packed else samples, dtype="<u2")


def line_integrals(labels, materials, seed):
    """What a scanner makes of the detector's counts: views, pixels across, slices."""
    n = SIZE * FINE
    middle = (n - 1) / 2
    y, x = np.mgrid[0:n, 0:n] - middle
    shares = [(labels == m + 1).reshape(n, n * n).T.astype(np.float32) for m in range(len(materials))]
    counts = np.zeros((VIEWS, SIZE, SIZE), np.float32)

    def view(k):
        angle = np.pi * k / VIEWS
        across = (x * np.cos(angle) - y * np.sin(angle) + middle).ravel()
        first = np.floor(across).astype(int)
        rows = np.concatenate([first, first + 1])
        weights = np.concatenate([first + 1 - across, across - first]).astype(np.float32)
        inside = (rows >= 0) & (rows < n)
        columns = np.tile(np.arange(n * n), 2)
        rays = sparse.csr_matrix((weights[inside], (rows[inside], columns[inside])), shape=(n, n * n))
        paths = [rays @ share / FINE for share in shares]
        seen = sum(
            part * np.exp(-sum(mu[energy] * path for mu, path in zip(materials, paths)))
            for energy, part in enumerate(SPECTRUM)
        )
        seen = seen.reshape(SIZE, FINE, SIZE, FINE).mean((1, 3))
        counts[k] = gaussian_filter1d(gaussian_filter1d(seen, UNSHARP, axis=0), UNSHARP, axis=1)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(view, range(VIEWS)))
    counts += SCATTER * gaussian_filter1d(gaussian_filter1d(counts, SPREAD, axis=1), SPREAD, axis=2)
    counts = np.random.default_rng(seed).poisson(counts * QUANTA) / QUANTA
    return -np.log(np.maximum(counts, 1 / QUANTA))


def reconstructed(integrals):
    """Filtered back projection: slices, rows, columns."""
    padded = 4 * SIZE
    k = np.minimum(np.arange(padded), padded - np.arange(padded))
    ramp = np.where(k == 0, 0.25, np.where(k % 2 == 1, -1 / (np.pi * np.maximum(k, 1)) ** 2, 0))
    response = 2 * np.fft.rfft(ramp).real * np.sinc(np.fft.rfftfreq(padded))
    spectrum = np.fft.rfft(integrals, n=padded, axis=1) * response[None, :, None]
    filtered = np.fft.irfft(spectrum, n=padded, axis=1)[:, :SIZE].astype(np.float32)
    middle = (SIZE - 1) / 2
    y, x = np.mgrid[0:SIZE, 0:SIZE] - middle

    def some(views):
        out = np.zeros((SIZE * SIZE, SIZE), np.float32)
        for k in views:
            angle = np.pi * k / VIEWS
            across = (x * np.cos(angle) - y * np.sin(angle) + middle).ravel()
            first = np.clip(np.floor(across).astype(int), 0, SIZE - 2)
            ahead = (across - first).astype(np.float32)
            inside = ((ahead >= 0) & (ahead <= 1)).astype(np.float32)
            row = filtered[k]
            out += ((1 - ahead) * inside)[:, None] * row[first] + (ahead * inside)[:, None] * row[first + 1]
        return out

    with ThreadPoolExecutor(2) as pool:
        both = sum(pool.map(some, [range(0, VIEWS, 2), range(1, VIEWS, 2)]))
    return (both * np.pi / (2 * VIEWS)).reshape(SIZE, SIZE, SIZE).transpose(2, 0, 1)


def scan(program, scene, rotation, seed, volume):
    """Writes the scan of an object to `volume`, and its truth beside it."""
    common = [program, "phantom", scene, "--fill", 0.75, f"--rotate={rotation}"]
    fine = volume.with_name(volume.stem + "_labels.mha")
    run(*common, "--out", volume, "--size", SIZE)
    doubled = ",".join(str(s * FINE) for s in SHIFT)
    sharp = ["--size", SIZE * FINE, "--spacing", 1 / FINE, f"--shift={doubled}", "--binary", "--noise", 0]
    radius = ["--fillet", 3 * FINE] if scene == "fillet" else []
    run(*common, "--out", fine, *sharp, *radius)
    header, _ = header_and_samples(volume)
    # So far a phantom: stopped on the way, nothing must stand under the scan's name.
    volume.unlink()
    _, greys = header_and_samples(fine)
    levels, labels = np.unique(greys, return_inverse=True)
    image = reconstructed(line_integrals(labels.reshape([SIZE * FINE] * 3), PARTS[len(levels)], seed))
    low, high = np.percentile(image, 0.01), image.max()
    samples = np.clip((image - low) / (high - low) * 60000, 0, 65535).astype("<u2")
    fine.write_bytes(header + samples.tobytes())
    fine.rename(volume)
    truth_of(fine).unlink()


def figures(program, volume, options):
    """What `compare` says of the mesh, or None."""
    with tempfile.TemporaryDirectory() as scratch:
        out, report = Path(scratch) / "result", Path(scratch) / "figures.json"
        if subprocess.run([program, "extract", volume, "--out", out, "--quiet", *options], capture_output=True).returncode:
            return None
        run(program, "compare", out / "assembly.ply", "--truth", truth_of(volume), "--json", report)
        return json.loads(report.read_text())


def worst(measured, of):
    """The largest of some figures, which are looked for in each of `measured`; there may be none."""
    found = []
    for each in measured:
        try:
            found.append(of(each)["voxels"])
        except (KeyError, TypeError):
            pass
    return found and [max(f[key] for f in found) for key in ("rms", "p99", "max")]


def cell(values):
    return " / ".join(f"{value:.3f}" for value in values) if values else "-"


def row(name, method, found):
    if found is None:
        return f"| {name} | {method} | no mesh |"
    sides = [pair[side] for pair in found["pairs"] for side in ("mesh_to_truth", "truth_to_mesh")]
    junctions = found["junctions"] or {}
    curves = [junctions.get(side) for side in ("mesh_to_truth", "truth_to_mesh")]
    cells = [
        cell(worst(sides, lambda s: s["close"]["clear"])),
        cell(worst(sides, lambda s: s["close"]["near_junction"])),
        cell(worst(curves, lambda s: s)),
        cell(worst(found["edges"], lambda e: e["right"]["off_ends"])),
        f"{max(abs(m['volume_error_percent']) for m in found['materials'][1:] if m['volume_error_percent'] is not None):.2f}",
        "right" if all(m["topology"] == m["expected"] for m in found["materials"]) else "wrong",
    ]
    told = [c["all"] for c in found["coverage"] if c["pair"] is None]
    cells.append(f"{told[0]['within_1']:.0f} / {told[0]['within_2']:.0f}" if told else "-")
    return f"| {name} | {method} | {' | '.join(cells)} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--interfacet", default=ROOT / "target/release/interfacet")
    parser.add_argument("--only", default="", help="objects with this in their name")
    parser.add_argument("--method", default="", help="methods with this in their name")
    parser.add_argument("--seed", type=int, default=5, help="of the quanta")
    parser.add_argument("--keep", type=Path, help="folder for the scans; those that are there are not made again")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        print("| object | method | clear interfaces RMS / 99 % / max | within 3 of a junction | junction curves | right-angled edges | volume % | topology | within sigma, two |")
        print("|---|---|---|---|---|---|---|---|---|")
        for name, (scene, rotation) in OBJECTS.items():
            if options.only not in name:
                continue
            volume = folder / f"{name}.mha"
            if not volume.exists():
                scan(options.interfacet, scene, rotation, options.seed, volume)
            for method, arguments in METHODS.items():
                if options.method in method:
                    print(row(name, method, figures(options.interfacet, volume, arguments)), flush=True)


if __name__ == "__main__":
    main()
