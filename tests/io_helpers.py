"""Makers of the files of other programs that the readers' tests share.

No file of SimVascular is in the repository; these are made as the program's sources and
documentation describe them, the centerlines by VTK.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLPolyDataWriter

from pcnde_bridge.data.variables import VARIABLES
from pcnde_bridge.io import VesselResults
from pcnde_bridge.model.prediction import Prediction


def results_of(cases, case, name="vessel"):
    stress = cases.wall_shear_stress
    return VesselResults(
        name,
        *(getattr(cases, field)[case] for field in VARIABLES),
        cases.area_undeformed[case],
        cases.time,
        cases.z,
        wall_shear_stress=None if stress is None else stress[case],
    )


def replaced(vessel, **changes):
    return dataclasses.replace(vessel, **changes)


def at_times(vessel, time):
    """The same periodic vessel at other time points: the same Fourier series."""
    n = vessel.time.size
    phase = 2j * np.pi * np.arange(n // 2 + 1)

    def series(values):
        weight = np.fft.rfft(values, axis=0) / n
        weight[1 : (n + 1) // 2] *= 2
        return np.real(np.exp(np.outer(time, phase)) @ weight)

    return replaced(
        vessel, time=np.asarray(time), **{f: series(v) for f, v in vessel.variables().items()}
    )


def centerline(path, vessel, *, steps=None, suffix=str, branches=None, drop=(), extra=None):
    """Write a centerline as svSlicer does: arrays by time step, two-point lines."""
    n = vessel.z.size
    data, points, lines = vtkPolyData(), vtkPoints(), vtkCellArray()
    # A bent vessel: the distance along it is what counts.
    angle = vessel.z / 10
    bend = np.stack([10 * np.sin(angle), 10 * (1 - np.cos(angle)), 0 * angle], axis=1)
    points.SetData(numpy_to_vtk(bend, deep=True))
    data.SetPoints(points)
    for i in range(n - 1):
        lines.InsertNextCell(2, [i, i + 1])
    data.SetLines(lines)
    arrays = {
        "BranchId": np.zeros(n, dtype=np.int64) if branches is None else branches,
        "BifurcationId": np.full(n, -1),
        "GlobalNodeId": np.arange(n),
        "CenterlineId": np.ones((n, 2), dtype=np.int32),
        "CenterlineSectionArea": vessel.area_undeformed,
        "CenterlineSectionNormal": np.tile([1.0, 0, 0], (n, 1)),
        "MaximumInscribedSphereRadius": np.sqrt(vessel.area_undeformed / np.pi),
        "Path": vessel.z,
    }
    steps = vessel.time if steps is None else steps
    for i, step in enumerate(steps):
        arrays[f"pressure_{suffix(step)}"] = vessel.pressure[i]
        arrays[f"velocity_{suffix(step)}"] = vessel.flow[i]
        arrays[f"area_{suffix(step)}"] = vessel.area[i]
    arrays |= extra or {}
    for name, values in arrays.items():
        if not any(name.startswith(part) for part in drop):
            array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
            array.SetName(name)
            data.GetPointData().AddArray(array)
    writer = vtkXMLPolyDataWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    assert writer.Write()
    return path


def sv1d(folder, vessel, *, pieces=(8, 6, 6), step=0.01, every=5, nodes=None):
    """Write an input file and results: a chain of segments, time in columns."""
    path = folder / "solver.in"
    text = ["# A model", "MODEL results_", ""]
    start = 0
    for i, elements in enumerate(pieces):
        end = start + elements
        length = vessel.z[end] - vessel.z[start]
        ends = (i, i + 1) if nodes is None else nodes[i]
        s_u = vessel.area_undeformed
        text.append(f"NODE {i} 0.0 0.0 {vessel.z[start]}")
        text.append(
            f"SEGMENT Group{i}_Seg0 {i} {length} {elements} {ends[0]} {ends[1]} {s_u[start]} "
            f"{s_u[end]} 0.0 MAT1 NONE 0.0 0 0 NOBOUND NONE"
        )
        for field in VARIABLES:
            table = getattr(vessel, field).T[start : end + 1]
            np.savetxt(folder / f"results_Group{i}_Seg0_{field}.dat", table, fmt="%.17g")
        start = end
    text += [
        f"SOLVEROPTIONS {step} {every} {every * (len(vessel.time) - 1)} 2 INFLOW FLOW 1e-6 1 1"
    ]
    path.write_text("\n".join(text) + "\n")
    return path


def predicted(cases, chosen):
    few = cases.select(chosen)
    arrays = (getattr(few, name) for name in (*VARIABLES, "area_undeformed", "time", "z"))
    return Prediction(*arrays, period=1.0, labels=few.labels)


def edited(path, edit, compressor=None, ascii_=False):
    """Have VTK read a file, change it and write it again."""
    reader, writer = vtkXMLPolyDataReader(), vtkXMLPolyDataWriter()
    reader.SetFileName(str(path))
    reader.Update()
    data = reader.GetOutput()
    edit(data)
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    if compressor:
        getattr(writer, f"SetCompressorTypeTo{compressor}")()
    if ascii_:
        writer.SetDataModeToAscii()
    assert writer.Write()
    return path


def lines(*rows):
    def replace(data):
        cells = vtkCellArray()
        for row in rows:
            cells.InsertNextCell(len(row), [int(i) for i in row])
        data.SetLines(cells)

    return replace


def stored(vessel, order):
    """The vessel with its points stored in another order."""
    fields = {name: getattr(vessel, name)[:, order] for name in VARIABLES}
    fields |= {name: getattr(vessel, name)[order] for name in ("z", "area_undeformed")}
    return replaced(vessel, **fields)
