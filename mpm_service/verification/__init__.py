"""Verification cases of the material point solver, usable as a library; `cases` lists them for the command line."""
