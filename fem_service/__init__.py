"""Finite elements for laminates behind the role `structure`."""
