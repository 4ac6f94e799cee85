"""How fine a mesh a scene needs: accuracy against time on a series of meshes."""
