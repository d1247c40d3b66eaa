"""Announces the backends of the atomistic role; cheap to import."""

from __future__ import annotations

from protocol.backend import Backend

BACKEND = Backend(
    name="md_service",
    role="atomistic",
    summary="molecular dynamics by LAMMPS, serial or under MPI",
    factory="md_service.service:make_service",
    launcher="md_service.backend:mpi_launcher",
    # Measured on one core of a common server: graphene with springs on half of the atoms.
    seconds_per_unit_step={
        "tersoff": 1.3e-6,
        "airebo": 1.6e-6,
        "airebo-sharp": 1.6e-6,
        "rebo": 1.6e-6,
        "rebo-sharp": 1.6e-6,
        "lcbop": 1.7e-6,
        "lennard-jones": 4e-7,
        "opls-aa": 5e-6,
        "reaxff": 1.2e-4,
        "reaxff-cho": 2.4e-5,
    },
    default=True,
)
LATTICE = Backend(
    name="lattice",
    role="atomistic",
    summary="harmonic lattice in numba, for teaching and fast tests",
    factory="md_service.service:make_lattice",
    seconds_per_unit_step={"harmonic": 1.5e-7, "harmonic-brittle": 1.5e-7},
)
OPENMM = Backend(
    name="openmm",
    role="atomistic",
    summary="OpenMM: Lennard-Jones and OPLS-AA",
    factory="md_service.service:make_openmm",
    seconds_per_unit_step={"lennard-jones": 6e-7, "opls-aa": 1e-5},
)
ASE = Backend(
    name="ase",
    role="atomistic",
    summary="any calculator of ASE",
    factory="md_service.service:make_ase",
    seconds_per_unit_step={"lennard-jones": 4.8e-5, "tersoff": 5e-5},
)


def mpi_launcher(ranks: int) -> list[str]:
    """Return the words that start `ranks` ranks with the MPI of the environment."""
    import shutil
    import sys
    from pathlib import Path

    beside_python = Path(sys.prefix) / "bin" / "mpiexec"
    program = str(beside_python) if beside_python.exists() else shutil.which("mpiexec")
    if program is None:
        raise FileNotFoundError("no mpiexec on the path; it comes with the extra lammps[mpi]")
    return [program, "-n", str(ranks)]
