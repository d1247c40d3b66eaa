"""Standard errors of correlated time series."""

import numpy as np
from numpy.typing import NDArray

HISTORY_LENGTH = 32  # windows that tell the standard error of one window's mean
MINIMUM_WINDOWS = 8  # fewer windows than this say too little about their scatter
_MINIMUM_BLOCKS = 8


def block_standard_error(series: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error of the mean of a correlated series.

    Neighbouring entries are merged pairwise again and again (Flyvbjerg and Petersen, J. Chem. Phys. 91, 461,
    1989); the largest of the estimates with at least eight blocks is taken, which errs on the safe side.

    Parameters
    ----------
    series : ndarray, shape (n, ...)
        Entries in order of time.

    Returns
    -------
    ndarray, shape (...)
        Standard error in the unit of the series.

    Raises
    ------
    ValueError
        If there are fewer than two entries.
    """
    if len(series) < 2:
        raise ValueError(f"series has {len(series)} entries; at least 2 are needed for a standard error")
    blocks = np.asarray(series, dtype=np.float64)
    largest = np.std(blocks, axis=0, ddof=1) / np.sqrt(len(blocks))
    while len(blocks) // 2 >= _MINIMUM_BLOCKS:
        even = 2 * (len(blocks) // 2)
        blocks = 0.5 * (blocks[0:even:2] + blocks[1:even:2])
        largest = np.maximum(largest, np.std(blocks, axis=0, ddof=1) / np.sqrt(len(blocks)))
    return np.asarray(largest)


def scatter_about_line(windows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviation of window means about a straight line in time, per component.

    The line takes out a load that changes steadily, so what is left is the noise of one window's mean, with the
    correlations inside the window included. A load that bends within the history makes the figure too large,
    never too small.

    Parameters
    ----------
    windows : ndarray, shape (n, ...)
        Means of consecutive windows, n > 2.

    Returns
    -------
    ndarray, shape (...)
        Standard deviation with n - 2 degrees of freedom, unit of the windows.

    Raises
    ------
    ValueError
        If there are fewer than three windows.
    """
    n = len(windows)
    if n < 3:
        raise ValueError(f"windows has {n} entries; at least 3 are needed for the scatter about a line")
    flat = windows.reshape(n, -1)
    time = np.arange(n) - 0.5 * (n - 1)
    centred = flat - flat.mean(axis=0)
    slope = time @ centred / (time @ time)
    residual = centred - time[:, None] * slope
    return np.sqrt(np.sum(residual**2, axis=0) / (n - 2)).reshape(windows.shape[1:])
