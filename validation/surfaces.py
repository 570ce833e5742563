#!/usr/bin/env python3
"""Surfaces of `fluvia mesh`, read by programs that are not ours.

usage: validation/surfaces.py FLUVIA FRAMES [OPTIONS OF fluvia mesh ...]

FLUVIA is the program, FRAMES the directory of a run as npz. Writes the surfaces as ply, obj and vtk into a temporary folder
and reads them with trimesh, meshio and PyVista (the VTK library), which have to agree with each other; then prints of
each tenth frame, or those asked for with --frames or --every, a row of a table: triangles, open edges, edges of other than two
triangles, bodies, volume in parts of the particles' (8 r^3 each), the part of the normals that point outwards, and the largest difference
of a vertex' velocity from the nearest particle's, in parts of the highest speed. Exits with 1 if a surface is open or turned
inside out, or its volume out of VOLUMES.

Needs trimesh, meshio, pyvista and numpy from PyPI.
"""
import glob
import json
import os
import subprocess
import sys
import tempfile

import meshio
import numpy as np
import pyvista
import trimesh

# Bodies start on a lattice, 8 r^3 a particle. In the published data, and so in DFSPH and in networks, a particle has the mass of
# 0.8 times that volume at rest: a pool takes 0.8 of what fell into it.
VOLUMES = 0.77, 1.03


def main():
    if len(sys.argv) < 3:
        sys.exit("usage: " + __doc__.split("usage: ")[1].splitlines()[0])
    fluvia, frames, options = sys.argv[1], sys.argv[2], sys.argv[3:]
    record = json.load(open(os.path.join(frames, "run.json")))
    radius = record["particle_radius"]
    if not {"--frames", "--every"} & set(options):
        options += ["--every", "10"]
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for kind in ["ply", "obj", "vtk"]:
            command = [fluvia, "mesh", frames, "-o", f"{folder}/{kind}", "--format", kind, *options]
            subprocess.run(command, check=True)
        print("| frame | particles | triangles | open | not two | bodies | volume | outwards | velocity |")
        print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
        for path in sorted(glob.glob(f"{folder}/ply/*.ply")):
            name = os.path.basename(path)[:-4]
            number = name.removeprefix("surface_")
            mesh = trimesh.load(path, process=False)
            particles = np.load(f"{frames}/fluid_{number}.npz")

            # Three programs, one surface.
            other = trimesh.load(f"{folder}/obj/{name}.obj", process=False, maintain_order=True)
            assert np.array_equal(mesh.faces, other.faces)
            assert np.allclose(mesh.vertices, other.vertices, atol=1e-6)
            for found in [meshio.read(path), meshio.read(f"{folder}/vtk/{name}.vtk")]:
                assert np.array_equal(found.cells_dict["triangle"], mesh.faces)
                assert np.allclose(found.points, mesh.vertices)
            for found in [pyvista.read(path), pyvista.read(f"{folder}/vtk/{name}.vtk").extract_surface(algorithm=None)]:
                assert (found.n_points, found.n_cells) == (len(mesh.vertices), len(mesh.faces))
                assert np.isclose(found.volume, mesh.volume, rtol=1e-3)
            vtk = pyvista.read(f"{folder}/vtk/{name}.vtk")
            normals, velocity = vtk.point_data["normals"], vtk.point_data["velocity"]
            file = meshio.read(path)
            assert np.array_equal(np.stack([file.point_data[k] for k in ["nx", "ny", "nz"]], 1), normals)
            assert np.array_equal(np.stack([file.point_data[k] for k in ["vx", "vy", "vz"]], 1), velocity)

            edges = np.sort(mesh.edges, axis=1)
            _, uses = np.unique(edges, axis=0, return_counts=True)
            volume = mesh.volume / (len(particles["pos"]) * 8 * radius**3)
            outwards = np.mean(np.sum(normals * mesh.vertex_normals, axis=1) > 0)
            _, nearest = trimesh.proximity.cKDTree(particles["pos"]).query(mesh.vertices)
            highest = np.linalg.norm(particles["vel"], axis=1).max()
            difference = np.linalg.norm(velocity - particles["vel"][nearest], axis=1).max() / max(highest, 1e-9)
            open_edges = int(np.sum(uses % 2))
            print(
                f"| {int(number)} | {len(particles['pos'])} | {len(mesh.faces)} | {open_edges} | {int(np.sum(uses != 2))} "
                f"| {mesh.body_count} | {volume:.3f} | {outwards:.4f} | {difference:.2f} |"
            )
            bad += open_edges > 0 or not VOLUMES[0] < volume < VOLUMES[1] or outwards < 0.99
    sys.exit(int(bad > 0))


main()
