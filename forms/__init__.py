"""Forms: enthalpy of the bodies and of contact, as NumPy arrays and UFL; nothing here is distributed."""
