"""Contact surfaces across ranks: global and local search, self-contact, load balance."""
