"""One page on a run: what was modelled, what it gave, and how far it can be trusted."""
