"""Contact kernel: facets, gaps, integrals, and the laws of the interface."""
