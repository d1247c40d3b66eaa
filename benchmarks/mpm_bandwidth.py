"""Memory bandwidth of this machine, and how much memory a particle-step must move."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit

from mpm_service import Scheme
from mpm_service.material_points import COLUMNS
from protocol.arrays import FloatArray

#: Bytes of each of the three arrays: twice the largest last-level cache in common use, so that nothing is found there.
ARRAY_BYTES = 256 * 2**20
WORD = 8
#: Bytes an element moves in a copy and a triad. A store first fetches its cache line, and that fetch counts here,
#: unlike in STREAM: the passes over the points fetch what they change, too.
COPY_BYTES, TRIAD_BYTES = 3 * WORD, 4 * WORD


@njit(cache=True, nogil=True)
def copy(a: FloatArray, c: FloatArray, first: int, last: int) -> None:
    """c = a, between two indices."""
    for i in range(first, last):
        c[i] = a[i]


@njit(cache=True, nogil=True)
def triad(a: FloatArray, b: FloatArray, c: FloatArray, first: int, last: int) -> None:
    """c = a + b/3, between two indices."""
    for i in range(first, last):
        c[i] = a[i] + b[i] / 3.0


def measure_bandwidth(threads: Sequence[int], rounds: int, array_bytes: int = ARRAY_BYTES) -> dict[int, float]:
    """Measure the bandwidth of a copy and a triad of arrays larger than the caches.

    Parameters
    ----------
    threads : sequence of int
        Numbers of threads to measure with.
    rounds : int
        Passes of each kind.
    array_bytes : int
        Size of each of three arrays.

    Returns
    -------
    dict of int to float
        Highest bandwidth seen with so many threads [bytes/s]: of a bound the most generous one is taken.
    """
    a, b, c = (np.full(array_bytes // WORD, value) for value in (1.0, 2.0, 0.0))
    kinds: list[tuple[int, Callable[[int, int], None]]] = [
        (COPY_BYTES, lambda first, last: copy(a, c, first, last)),
        (TRIAD_BYTES, lambda first, last: triad(a, b, c, first, last)),
    ]
    for _, sweep in kinds:
        sweep(0, 1)  # compiles
    best = dict.fromkeys(threads, 0.0)
    with ThreadPoolExecutor(max(threads)) as pool:
        for _ in range(rounds):
            for count in threads:
                for moved, sweep in kinds:
                    edges = np.linspace(0, a.size, count + 1).astype(np.int64)
                    began = time.perf_counter()
                    list(pool.map(sweep, edges[:-1], edges[1:]))
                    best[count] = max(best[count], moved * a.size / (time.perf_counter() - began))
    return best


def point_passes(scheme: Scheme) -> tuple[int, int]:
    """Count how often a step reads the point table and how often it writes it.

    A sweep that brings state to the nodes reads the points; one that moves or deforms them reads and writes them.
    USL has one of each kind, MUSL one more that deforms; USF and USAVG deform first and gather a second time, and
    USF moves the points by themselves. Each order of a filter beyond the first reads once more, and in FMPM once
    again where the strain follows at the end of the step.

    Returns
    -------
    reads, writes : int
    """
    reads, writes = {"usl": (2, 1), "musl": (3, 2), "usf": (5, 3), "usavg": (5, 3)}[scheme.integration]
    reads += scheme.passes
    if scheme.transfer == "fmpm" and scheme.integration in ("musl", "usavg"):
        reads += scheme.passes
    return reads, writes


def bytes_per_step(scheme: Scheme) -> int:
    """Bytes that a particle-step moves between memory and processor if the point table fits no cache.

    Only rows of points are counted, in the plane; the nodal tables are a quarter as long and may stay in the cache,
    so a real step moves more.
    """
    reads, writes = point_passes(scheme)
    return (reads + writes) * COLUMNS * WORD
