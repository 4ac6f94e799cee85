"""piezomat: electromechanics of piezoelectric fibers in adhesive contact."""

__version__ = "0.1.0"
