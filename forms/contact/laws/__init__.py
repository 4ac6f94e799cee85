"""Laws of a contact point: penalty, cohesive, Lennard-Jones, viscous."""
