"""piezomat from Python: run, open, sweep, and what they return."""
