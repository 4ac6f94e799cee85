"""Laws of a contact point: summands of its enthalpy."""
