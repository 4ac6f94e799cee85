"""Meshes: shapes and mesh files, distributed over the ranks, and the search for contact between their surfaces."""
