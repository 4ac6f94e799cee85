"""Contact of bodies with each other and with rigid planes: search, laws from the scene, evaluation, history."""
