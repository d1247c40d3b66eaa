"""Atomistic solver of scalebridge: LAMMPS driven through anchors, usable as a plain library.

Importing the package is cheap; LAMMPS itself is loaded by the first engine that is made.
"""
