"""Benchmarks: speed beside error, other software measured in the same run."""
