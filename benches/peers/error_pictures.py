#!/usr/bin/env python3
"""Pictures of error as colour on the mesh, for docs/accuracy.md: published method, models, and surface nets side by side.

    python3 benches/peers/error_pictures.py --out docs/images

Each phantom (112 voxels, noise 1 %, as in the tables) is made, extracted and compared with the truth by `interfacet compare
--error-ply`; the meshes are drawn by VTK, cut open, with one scale: blue, half a voxel behind the truth, to red, half a
voxel in front. Needs what accuracy.py needs.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import accuracy
from common import must_run, our_program, python_with

# Scene, cutting plane (normal, and share of the size along it), direction of the eye.
SCENES = {
    "press-fit-ring": ((0.35, -0.94, 0.0), 0.5, (0.9, -2.2, 1.1)),
    "cube-in-cube": ((0.5, -0.86, 0.0), 0.42, (1.2, -2.0, 1.1)),
}
TOOLS = {"published method": ["--accuracy", "paper"], "models (--accuracy full)": ["--accuracy", "full"], "Otsu, surface nets, smoothed": None}
# Voxels of full colour, pixels of a panel.
FULL = 0.5
PANEL = (430, 400)
# Pixels of the strips for titles and the scale.
TITLE, SCALE = 30, 58


def read_error_ply(path):
    """Positions, triangles, errors of a mesh of `interfacet compare --error-ply`."""
    import numpy as np

    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    count = {line.split()[1]: int(line.split()[2]) for line in data[:end].decode().splitlines() if line.startswith("element")}
    vertex = np.dtype([("p", "<f8", 3), ("error", "<f4"), ("colour", "u1", 3)])
    face = np.dtype([("n", "u1"), ("v", "<i4", 3), ("pair", "u1", 2)])
    vertices = np.frombuffer(data, vertex, count["vertex"], end)
    faces = np.frombuffer(data, face, count["face"], end + vertices.nbytes)
    return vertices["p"].copy(), faces["v"].astype("i8"), vertices["error"].copy()


def colours():
    import vtk

    table = vtk.vtkColorTransferFunction()
    table.AddRGBPoint(-FULL, 0.10, 0.25, 0.75)
    table.AddRGBPoint(-0.2 * FULL, 0.60, 0.75, 0.95)
    table.AddRGBPoint(0.0, 0.96, 0.96, 0.96)
    table.AddRGBPoint(0.2 * FULL, 0.98, 0.72, 0.62)
    table.AddRGBPoint(FULL, 0.75, 0.08, 0.10)
    return table


def actor(mesh, plane, size):
    """The mesh behind the plane, coloured by its error in voxels."""
    import numpy as np
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

    p, t, error = mesh
    points, cells, poly = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
    points.SetData(numpy_to_vtk(p, deep=True))
    cells.SetData(3, numpy_to_vtkIdTypeArray(t.ravel(), deep=True))
    poly.SetPoints(points)
    poly.SetPolys(cells)
    poly.GetPointData().SetScalars(numpy_to_vtk(error, deep=True))
    cut = vtk.vtkPlane()
    normal, share = plane
    cut.SetNormal([-n for n in normal])
    middle = np.full(3, size / 2) + (share - 0.5) * size * np.array(normal)
    cut.SetOrigin(middle)
    clip = vtk.vtkClipPolyData()
    clip.SetInputData(poly)
    clip.SetClipFunction(cut)
    mapper = vtk.vtkPolyDataMapper()
    mapper.SetInputConnection(clip.GetOutputPort())
    mapper.SetLookupTable(colours())
    mapper.InterpolateScalarsBeforeMappingOff()
    out = vtk.vtkActor()
    out.SetMapper(mapper)
    out.GetProperty().SetAmbient(0.35)
    out.GetProperty().SetDiffuse(0.7)
    out.GetProperty().SetInterpolationToFlat()
    return out


def draw(meshes, plane, eye, size, out):
    """All meshes side by side, with a scale below."""
    import vtk
    from PIL import Image
    from vtk.util.numpy_support import vtk_to_numpy

    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(4)
    window.SetSize(PANEL[0] * len(meshes), PANEL[1] + TITLE + SCALE)
    share, top = SCALE / (PANEL[1] + TITLE + SCALE), 1 - TITLE / (PANEL[1] + TITLE + SCALE)
    for k, (title, mesh) in enumerate(meshes.items()):
        view = vtk.vtkRenderer()
        view.SetViewport(k / len(meshes), share, (k + 1) / len(meshes), top)
        view.SetBackground(1, 1, 1)
        view.AddActor(actor(mesh, plane, size))
        text = vtk.vtkTextActor()
        text.SetInput(title)
        text.SetPosition(12, 4)
        text.GetTextProperty().SetFontSize(17)
        text.GetTextProperty().SetColor(0.15, 0.16, 0.19)
        strip = vtk.vtkRenderer()
        strip.SetViewport(k / len(meshes), top, (k + 1) / len(meshes), 1)
        strip.SetBackground(1, 1, 1)
        strip.AddViewProp(text)
        window.AddRenderer(strip)
        camera = view.GetActiveCamera()
        camera.SetFocalPoint(size / 2, size / 2, size / 2)
        camera.SetPosition([size / 2 + size * e for e in eye])
        camera.SetViewUp(0, 0, 1)
        view.ResetCamera()
        camera.Zoom(1.3)
        window.AddRenderer(view)
    view = vtk.vtkRenderer()
    view.SetViewport(0, 0, 1, share)
    view.SetBackground(1, 1, 1)
    bar = vtk.vtkScalarBarActor()
    bar.SetLookupTable(colours())
    bar.SetOrientationToHorizontal()
    bar.SetNumberOfLabels(5)
    bar.SetVerticalTitleSeparation(6)
    bar.SetLabelFormat("{:+.2f}" if vtk.vtkVersion.GetVTKVersion() >= "9.6" else "%+.2f")
    bar.SetTitle("error in voxels (blue: behind the true surface, red: in front)")
    bar.SetPosition(0.25, 0.02)
    bar.SetWidth(0.5)
    bar.SetHeight(0.95)
    bar.UnconstrainedFontSizeOn()
    for style, points in ((bar.GetTitleTextProperty(), 15), (bar.GetLabelTextProperty(), 15)):
        style.SetFontSize(points)
        style.SetColor(0.15, 0.16, 0.19)
        style.ItalicOff()
        style.BoldOff()
        style.ShadowOff()
    view.AddViewProp(bar)
    window.AddRenderer(view)
    window.Render()
    image = vtk.vtkWindowToImageFilter()
    image.SetInput(window)
    image.ReadFrontBufferOff()
    image.Update()
    pixels = image.GetOutput()
    width, height, _ = pixels.GetDimensions()
    values = vtk_to_numpy(pixels.GetPointData().GetScalars()).reshape(height, width, 3)[::-1]
    # 256 colours tell the same in half of the bytes.
    Image.fromarray(values).quantize(256, method=Image.Quantize.MEDIANCUT, kmeans=4, dither=Image.Dither.FLOYDSTEINBERG).save(out, optimize=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder for the pictures")
    parser.add_argument("--size", type=int, default=112)
    parser.add_argument("--python", default=None, help="a Python with vtk, numpy and pillow")
    parser.add_argument("--interfacet", default=None, help="the interfacet binary, if already built")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.inside:
        python = python_with([*accuracy.PACKAGES, "pillow"], options.python, "accuracy-venv")
        program = our_program(options.interfacet)
        command = [python, __file__, *sys.argv[1:], "--inside", "--interfacet", program]
        raise SystemExit(subprocess.run(list(map(str, command))).returncode)
    program = Path(options.interfacet).resolve()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        work = Path(work)
        for scene, (normal, share, eye) in SCENES.items():
            volume, truth = work / f"{scene}.mha", work / f"{scene}.phantom.json"
            must_run([program, "phantom", scene, "--size", options.size, "--fill", 0.85, "--seed", 1, "--rotate=7.3,11.9,4.1",
                      "--noise", 1, "--uncompressed", "--out", volume])
            meshes = {}
            for title, extra in TOOLS.items():
                mesh = work / "mesh.ply"
                if extra is None:
                    accuracy.peer(volume, truth, mesh, True)
                else:
                    must_run([program, "extract", volume, "--out", work / title.split()[0], "-q", *extra])
                    mesh = work / title.split()[0] / "assembly.ply"
                must_run([program, "compare", mesh, "--truth", truth, "--error-ply", work / "error.ply"])
                meshes[title] = read_error_ply(work / "error.ply")
            for title in TOOLS:
                subprocess.run(["rm", "-rf", work / title.split()[0]], check=True)
            draw(meshes, (normal, share), eye, options.size, options.out / f"error_{scene.replace('-', '_')}.png")


if __name__ == "__main__":
    main()
