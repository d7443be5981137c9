#!/usr/bin/env python3
"""Compares interfacet with VTK on one machine: time and peak memory, both sides in turn.

    python3 benches/peers/run.py                # everything, about ten minutes
    python3 benches/peers/run.py --rounds 3 --threads 2 --jobs isosurface
    python3 benches/peers/run.py --size 250 350 116

Needs cargo and, once, the network: VTK and NumPy are installed from PyPI into a virtual environment
(target/peers/venv, or --python for one that has them). Every measurement is a process of its own that
reads the same files, does its job in memory `--runs` times, and prints a line for each; rounds alternate
between the two sides, so that a change of the machine's load meets both. Ratios are of medians.
"""

import argparse
import os
import statistics
import subprocess
import sys
from pathlib import Path

from common import ROOT, our_bench, python_with

# Our job, the peer's filter, and the wanted ratio of times (None: for comparison only).
PAIRS = [
    ("label-to-mesh", "surface-nets", 0.6),
    ("label-to-mesh", "discrete-flying-edges", None),
    ("pipeline", "surface-nets-smoothed", 0.75),
    ("isosurface", "flying-edges", 1.0),
]
LEVEL = 7800.0  # as in benches/peers.rs


def peer(filter_name, directory, runs, threads):
    """Runs one VTK filter; in a process of its own."""
    import resource
    import time

    import numpy
    import vtk
    from vtk.util import numpy_support

    tools = vtk.vtkSMPTools
    # The first that this build of VTK has; PyPI's has only this one and Sequential.
    for backend in ("STDThread", "TBB"):
        if tools.SetBackend(backend) and tools.GetBackend() == backend:
            break
    tools.Initialize(threads)

    size = [int(n) for n in (directory / "size.txt").read_text().split()]
    grey = filter_name == "flying-edges"
    values = numpy.fromfile(
        directory / ("grey.raw" if grey else "labels.raw"), dtype="<u2" if grey else numpy.uint8
    )
    image = vtk.vtkImageData()
    image.SetDimensions(size)
    image.GetPointData().SetScalars(numpy_support.numpy_to_vtk(values, deep=False))
    labels = [] if grey else [int(v) for v in numpy.unique(values[:: max(1, values.size // 10**6)]) if v != 0]

    for _ in range(runs):
        if filter_name.startswith("surface-nets"):
            surface = vtk.vtkSurfaceNets3D()
            surface.SetOutputMeshTypeToTriangles()
            surface.SetBackgroundLabel(0)
            surface.SetSmoothing(filter_name.endswith("smoothed"))
        else:
            surface = vtk.vtkFlyingEdges3D() if grey else vtk.vtkDiscreteFlyingEdges3D()
            # Only points and triangles, as ours.
            surface.ComputeNormalsOff()
            surface.ComputeGradientsOff()
            if grey:
                surface.ComputeScalarsOff()
                surface.InterpolateAttributesOff()
        for i, value in enumerate([LEVEL] if grey else labels):
            surface.SetValue(i, value)
        surface.SetInputData(image)
        start, before = time.perf_counter(), time.process_time()
        surface.Update()
        seconds, processor = time.perf_counter() - start, time.process_time() - before
        mesh = surface.GetOutput()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        print(
            f"who=vtk-{vtk.vtkVersion.GetVTKVersion()} job={filter_name} threads={threads} "
            f"seconds={seconds:.4f} cpu={processor:.2f} triangles={mesh.GetNumberOfPolys()} vertices={mesh.GetNumberOfPoints()} "
            f"peak={peak} backend={tools.GetBackend()}",
            flush=True,
        )
        del surface, mesh


def measure(command, threads):
    """The runs that a process reports."""
    environment = dict(os.environ, RAYON_NUM_THREADS=str(threads))
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment)
    lines = [line for line in done.stdout.splitlines() if line.startswith("who=")]
    for line in lines:
        print("   ", line, file=sys.stderr, flush=True)
    return [dict(word.split("=", 1) for word in line.split()) for line in lines]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3, help="processes of each side (default 3)")
    parser.add_argument("--runs", type=int, default=3, help="runs in each process (default 3)")
    parser.add_argument("--threads", type=int, nargs="+", default=None, help="default: 1 and all")
    parser.add_argument("--jobs", nargs="+", default=None, help="only these of our jobs")
    parser.add_argument("--size", type=int, nargs=3, default=None, help="voxels (default 500 700 231)")
    parser.add_argument("--data", type=Path, default=None, help="where the volume is kept (default target/peers)")
    parser.add_argument("--python", default=None, help="a Python with vtk and numpy")
    parser.add_argument("--program", default=None, help="our bench binary, if already built")
    parser.add_argument("--no-ply", action="store_true", help="leave out reading and writing of PLY")
    parser.add_argument("--peer", nargs=2, metavar=("FILTER", "THREADS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    size = [str(n) for n in options.size or (500, 700, 231)]
    data = options.data or ROOT / "target" / "peers" / "x".join(size)
    if options.peer:
        peer(options.peer[0], data, options.runs, int(options.peer[1]))
        return

    python = python_with(["vtk", "numpy"], options.python)
    program = our_bench(options.program, "peers")
    if not (data / "size.txt").exists():
        subprocess.run([program, "write", data, *size], check=True)
    threads = options.threads or sorted({1, os.cpu_count()})
    rows = []
    for count in threads:
        for job, filter_name, wanted in PAIRS:
            if options.jobs and job not in options.jobs:
                continue
            ours, theirs = [], []
            for _ in range(options.rounds):
                ours += measure([program, job, data, str(options.runs)], count)
                command = [python, __file__, "--peer", filter_name, str(count), "--runs", str(options.runs)]
                theirs += measure([*command, "--data", data], count)
            rows.append((count, job, ours, filter_name, theirs, wanted))

    version, backend = theirs[0]["who"], theirs[0]["backend"]
    print(f"\n{' x '.join(size)} voxels; {version}, SMP backend {backend}; medians of "
          f"{options.rounds * options.runs} runs, both sides in turn; wall clock, in memory\n")
    side = "s | cpu s | triangles | peak MiB"
    print(f"| threads | ours | {side} | peer | {side} | ratio | ratio of cpu | wanted |")
    print("|---" * 14 + "|")
    for count, job, ours, filter_name, theirs, wanted in rows:
        def medians(key):
            return [statistics.median(float(run[key]) for run in side) for side in (ours, theirs)]

        seconds, processor = medians("seconds"), medians("cpu")
        cells = [
            (f"{s:.3f}", f"{c:.2f}", side[0]["triangles"], f"{max(int(run['peak']) for run in side) / 2**20:.0f}")
            for s, c, side in zip(seconds, processor, (ours, theirs))
        ]
        ratios = [f"{a / b:.2f}" for a, b in (seconds, processor)]
        columns = [str(count), job, *cells[0], filter_name, *cells[1], *ratios]
        print("|", " | ".join([*columns, "" if wanted is None else f"{wanted}"]), "|")

    if not options.no_ply and (ROOT / "benches" / "ply.rs").exists():
        subprocess.run(["cargo", "bench", "--bench", "ply"], cwd=ROOT, check=True)


if __name__ == "__main__":
    main()
