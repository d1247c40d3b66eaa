# %% [markdown]
# # A beam under a harmonic force
#
# A simply supported beam, ten times as long as high, is pulled up at mid-span with `P0 sin(omega t)` (Sec 2.5,
# Fig 2.6). The unit of time is such that `omega = pi/2` is half the beam's first frequency.

# %% The ten lines: beam, law, grid, supports, load, run
import matplotlib.pyplot as plt
import numpy as np

from mpm_service import (
    Constant,
    Damping,
    EdgeCondition,
    Grid,
    IsotropicElastic,
    MaterialPointSolver,
    Scheme,
    Sine,
    Traction,
    fill_rectangle,
)
from mpm_service.verification.beam_theory import Beam, bernoulli_deflection, elastic_deflection

length, height, cells = 10.0, 1.0, 8  # m, m, cells through the height
cell, strip, omega = height / cells, 0.5, 0.5 * np.pi  # m, m, 1/s
young = 12e3 * (length / np.pi) ** 4 * np.pi**2  # Pa, makes the first frequency of the beam pi per second
material = IsotropicElastic(young, poisson=0.3, density=1e3, assumption="plane_stress")
grid = Grid((-3 * cell, -3 * cell), cell, (10 * cells + 6, cells + 6))
supports = [EdgeCondition(end, 1, displacements=Constant(0.0)) for end in ("left", "right")]
region = ((0.5 * (length - strip), height), (0.5 * (length + strip), height))
force = Traction("top", (0.0, 1.0 / strip), Sine(1.0, omega), region=region)  # 1 N per metre of thickness
flip = Scheme(transfer="flip")  # FMPM, the default, damps bending


def deflection(force_scaling=0.0, samples=200, duration=8.0):
    """Mid-span deflection over time; `force_scaling` is c of Eq 45."""
    step = 0.6 * cell / material.pressure_wave_speed
    beam = fill_rectangle((0.0, 0.0), (length, height), cell)
    damping = Damping(force_scaling=force_scaling)
    solver = MaterialPointSolver(grid, beam, material, 1.0, step, supports, damping=damping, loads=[force], scheme=flip)
    middle = np.abs(beam.position[:, 0] - 0.5 * length) < 0.5 * cell
    time, moved = np.zeros((2, samples))
    for k in range(samples):
        solver.advance(int(duration / step * (k + 1) / samples) - solver.step)
        time[k], moved[k] = solver.time, solver.points.displacement[middle, 1].mean()
    return time, moved, beam.position[middle]


# %% Theory: exact (plane stress elasticity) and Euler-Bernoulli (Eq 49)
theory = Beam(length, height, material.young, 0.3, material.density, force=1.0, angular_frequency=omega, strip=strip)
figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
scale = material.young * height
for c in (0.0, 0.25, 0.6):
    time, moved, place = deflection(c)
    axes.plot(time, scale * moved, label=f"material points, c = {c:g}")
    if c == 0.0:
        exact = elastic_deflection(theory, place, time)
        error = np.abs(moved - exact).max() / np.abs(exact).max()
        print(f"largest error without scaling: {100 * error:.2f} % of the largest deflection")
axes.plot(time, scale * exact, color="0.6", linewidth=4, alpha=0.5, zorder=0, label="exact")
axes.plot(time, scale * bernoulli_deflection(theory, time), "--", color="0.4", linewidth=1, label="Euler-Bernoulli")
axes.set(
    xlabel="time (s)",
    ylabel="deflection w E H / P0",
    title="Beam under a harmonic force; scaling the forces by 1 - c (Eq 45) slows it",
)
axes.legend(frameon=False, fontsize=8, ncols=2)
figure.savefig("beam.png", dpi=130)
