# %% [markdown]
# # A step of stress along a bar of graphene
#
# A bar of 100 m is pulled at its left end with 100 MPa from time zero on (Sec 2.6, Fig 2.9). The front must run
# with `sqrt(E / rho)` = 21.4 km/s. Run as a script, or cell by cell in an editor that knows `# %%`.

# %% The ten lines: bar, law, grid, load, run
import matplotlib.pyplot as plt
import numpy as np

from mpm_service import Grid, IsotropicElastic, MaterialPointSolver, Traction, fill_rectangle

length, cell, pull = 100.0, 0.5, 100e6  # m, m, Pa
graphene = IsotropicElastic(young=1.03e12, poisson=0.0, density=2250.0, assumption="plane_stress")
bar = fill_rectangle((0.0, 0.0), (length, 2 * cell), cell)
grid = Grid(origin=(-3 * cell, -3 * cell), cell_size=cell, cells=(206, 8))
step = 0.4 * cell / graphene.pressure_wave_speed  # s, Courant number 0.4
solver = MaterialPointSolver(grid, bar, graphene, 1.0, step, loads=(Traction("left", (-pull, 0.0)),))

lower_row = solver.points.reference_position[:, 1] < 0.5 * cell
place = solver.points.reference_position[lower_row, 0]
profiles = []
for _ in range(3):
    solver.advance(125)
    profiles.append((solver.time, solver.points.stress[lower_row, 0]))

# %% Stress along the bar at three times
speed = np.sqrt(graphene.young / graphene.density)
figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for time, stress in profiles:
    (line,) = axes.plot(place, 1e-6 * stress, label=f"{1e3 * time:.2f} ms")
    axes.axvline(speed * time, color=line.get_color(), linestyle=":", linewidth=1.0)
axes.set(
    xlabel="place along the bar (m)",
    ylabel="axial stress (MPa)",
    title="Stress step in graphene; dotted: where sqrt(E/rho) puts the front",
)
axes.legend(frameon=False)
figure.savefig("bar.png", dpi=130)

# %% Speed of the front, where the stress is half the traction
time, stress = profiles[-1]
front = np.interp(-0.5 * pull, -stress[::-1][: place.size // 2][::-1], place[place.size // 2 :])
print(f"front {front / time / 1e3:.2f} km/s, sqrt(E/rho) {speed / 1e3:.2f} km/s")
print(f"largest stress {stress.max() / 1e6:.1f} MPa, lowest {stress.min() / 1e6:.1f} MPa")
