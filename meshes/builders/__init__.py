"""Mesh builders: sections, extrusion, sweeping along centre lines, structured cells, cell sizes."""
