"""Generalized method of cells behind the role `micromechanics`."""
