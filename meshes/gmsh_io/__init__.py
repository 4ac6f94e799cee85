"""Meshes in and out of gmsh: its model, mesh files, arrays."""
