"""Loads alone: total forces, moments, areas, work; dashpots against the theory of waves."""

from collections.abc import Callable

import numpy as np
import pytest

from mpm_service import EdgeCondition, Grid, IsotropicElastic, MaterialPointSolver, Scheme, fill_rectangle, fill_region
from mpm_service.load_set import LoadSet
from mpm_service.loads import AbsorbingEdge, BodyForce, Load, Traction, face_places
from mpm_service.material_points import columns
from mpm_service.time_functions import Constant, Ramp, Sine

DT = 0.05


def integral_of_hat(t: np.ndarray) -> np.ndarray:
    t = np.clip(t, -1.0, 1.0)
    return t - 0.5 * t * np.abs(t)


def averaged_hat(t: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Hat function around 0 averaged over t - half ... t + half."""
    wide = np.where(half > 0.0, half, 1.0)
    mean = (integral_of_hat(t + wide) - integral_of_hat(t - wide)) / (2.0 * wide)
    return np.where(half > 0.0, mean, np.maximum(1.0 - np.abs(t), 0.0))


class Block:
    """A box of points on a lattice of unit cells, with linear functions and tables of its own."""

    def __init__(self, size: tuple[int, ...], points_per_cell: int = 2, cells: int = 14) -> None:
        self.dimension = len(size)
        self.lower, self.upper = np.zeros(self.dimension), np.array(size, dtype=np.float64)
        axes = [(np.arange(n * points_per_cell) + 0.5) / points_per_cell for n in size]
        mesh = np.meshgrid(*reversed(axes), indexing="ij")
        self.reference = np.stack([m.ravel() for m in reversed(mesh)], axis=1)
        self.count = self.reference.shape[0]
        self.half = np.full(self.count, 0.5 / points_per_cell)
        self.weight = np.ones(self.count)
        self.origin, self.cells = -4.0, cells
        self.columns = columns(self.dimension)
        self.rows = np.zeros((self.count, self.columns.width))
        rng = np.random.default_rng(0)
        self.row_of = rng.permutation(self.count)
        self.rows[self.row_of, : self.dimension] = self.reference
        self.rows[:, self.columns.mass] = 1.0 + rng.random(self.count)
        nodes = (cells + 1) ** self.dimension
        self.momentum = np.zeros((nodes, 1 + 2 * self.dimension))
        self.momentum[:, 0] = 1.0
        lattice = np.meshgrid(*[self.origin + np.arange(cells + 1.0)] * self.dimension, indexing="ij")
        self.places = np.stack([m.ravel() for m in reversed(lattice)], axis=1)
        self.everywhere = (np.arange(nodes),)

    def deform(self, gradient: np.ndarray, shift: np.ndarray) -> None:
        """Homogeneous deformation x = F X + shift."""
        d = self.dimension
        self.rows[self.row_of, :d] = self.reference @ gradient.T + shift
        self.rows[:, 2 * d : 2 * d + d * d] = (gradient - np.eye(d)).ravel()

    def stencils_at(
        self, position: np.ndarray, half: np.ndarray, reference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Averages of hat functions over boxes, as differences of the integral of the hat function."""
        m, d = position.shape
        xi = position - self.origin
        low = np.floor(xi - half).astype(np.int64)
        node = np.zeros((m, 3**d), dtype=np.int64)
        weight = np.ones((m, 3**d))
        for corner in range(3**d):
            for b in range(d):
                up = corner // 3**b % 3
                node[:, corner] += (low[:, b] + up) * (self.cells + 1) ** b
                weight[:, corner] *= averaged_hat(xi[:, b] - low[:, b] - up, half[:, b])
        return node, weight, np.full(m, 3**d, dtype=np.int64)

    def linear(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.stencils_at(position, np.zeros_like(position), position)

    def scatter_points(self, rows: np.ndarray, force: np.ndarray) -> None:
        node, weight, _ = self.linear(self.rows[rows, : self.dimension])
        for a in range(self.dimension):
            np.add.at(self.momentum[:, 1 + self.dimension + a], node, weight * force[:, a : a + 1])

    def load(
        self, *loads: Load, thickness: float = 1.0, time_step: float = DT, interpolation: str = "ugimp"
    ) -> LoadSet:
        return LoadSet(
            loads, self.reference, self.half, self.weight, self.lower, self.upper, thickness, time_step, interpolation
        )

    def apply(self, loads: LoadSet, step: int = 0, alive: int | None = None) -> np.ndarray:
        self.momentum[:, 1 + self.dimension :] = 0.0
        loads.apply(
            step,
            self.rows,
            self.row_of,
            self.count if alive is None else alive,
            self.momentum,
            self.everywhere,
            self.stencils_at,
            self.scatter_points,
        )
        return self.momentum[:, 1 + self.dimension :]

    def work(self, loads: LoadSet, velocity: np.ndarray, time_step: float = DT) -> np.ndarray:
        return time_step * loads.power(velocity, self.momentum, self.everywhere, self.read_points)

    def read_points(self, rows: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        node, weight, _ = self.linear(self.rows[rows, : self.dimension])
        return np.einsum("ik,ika->ia", weight, velocity[node])


def moments(places: np.ndarray, force: np.ndarray) -> np.ndarray:
    """First moments sum x_a f_b of nodal forces, (d, d)."""
    return places.T @ force


F_PLANE = np.array([[1.2, 0.3], [-0.4, 0.9]])
F_SPACE = np.array([[1.1, 0.2, -0.1], [0.3, 0.9, 0.15], [-0.2, 0.1, 1.2]])
QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
QUARTER_ABOUT_Z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
FACES_OF = [((3, 2), f) for f in ("left", "right", "bottom", "top")] + [
    ((2, 3, 2), f) for f in ("left", "right", "bottom", "top", "back", "front")
]


def normal_of(face: str, dimension: int) -> np.ndarray:
    index = ("left", "right", "bottom", "top", "back", "front").index(face)
    normal = np.zeros(dimension)
    normal[index // 2] = 1.0 if index % 2 else -1.0
    return normal


def face_of(size: tuple[int, ...], face: str) -> tuple[np.ndarray, float]:
    """Centre of a face and its area."""
    normal = normal_of(face, len(size))
    sides = np.array(size, dtype=float)
    return 0.5 * (1.0 + normal) * sides, float(np.prod(sides[normal == 0.0]))


@pytest.mark.parametrize(("size", "face"), FACES_OF)
@pytest.mark.parametrize("turned", [False, True])
def test_dead_load_acts_on_a_stretched_and_turned_face(size: tuple[int, ...], face: str, turned: bool) -> None:
    """Domains that follow the deformation end at the face itself: force and moment in closed form."""
    block = Block(size)
    d = block.dimension
    shift = np.array([3.37, 1.21, -0.6][:d])
    gradient = np.diag([1.2, 0.9, 1.1][:d])
    if turned:
        gradient = (QUARTER if d == 2 else QUARTER_ABOUT_Z) @ gradient
    block.deform(gradient, shift)
    thickness = 0.3 if d == 2 else 1.0
    vector = np.array([2.0, -5.0, 3.0][:d])
    loads = block.load(Traction(face, vector), thickness=thickness, interpolation="cpgimp")  # type: ignore[arg-type]
    force = block.apply(loads)
    centre, area = face_of(size, face)
    total = vector * area * thickness
    np.testing.assert_allclose(force.sum(axis=0), total, rtol=1e-12)
    np.testing.assert_allclose(
        moments(block.places, force), np.outer(gradient @ centre + shift, total), rtol=1e-11, atol=1e-12
    )


@pytest.mark.parametrize(("size", "face"), FACES_OF)
def test_dead_load_ends_at_the_sides_of_domains_that_keep_their_size(size: tuple[int, ...], face: str) -> None:
    block = Block(size)
    d = block.dimension
    gradient, shift = (F_PLANE, np.array([3.37, 1.21])) if d == 2 else (F_SPACE, np.array([2.37, 1.21, -0.6]))
    block.deform(gradient, shift)
    vector = np.array([2.0, -5.0, 3.0][:d])
    force = block.apply(block.load(Traction(face, vector)))  # type: ignore[arg-type]
    centre, area = face_of(size, face)
    normal = normal_of(face, d)
    np.testing.assert_allclose(force.sum(axis=0), vector * area, rtol=1e-12)
    # The outermost points lie half a domain inside of the face and move with F; their domains do not turn.
    place = gradient @ (centre - 0.25 * normal) + shift + 0.25 * normal
    np.testing.assert_allclose(moments(block.places, force), np.outer(place, vector * area), rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize(
    ("size", "gradient"), [((3, 2), F_PLANE), ((2, 3, 2), F_SPACE), ((2, 3, 2), QUARTER_ABOUT_Z @ F_SPACE)]
)
def test_pressure_follows_nanson_and_closes_over_the_body(size: tuple[int, ...], gradient: np.ndarray) -> None:
    block = Block(size)
    d = block.dimension
    block.deform(gradient, np.array([3.1, 1.7, 0.4][:d]))
    pressure = 4.0
    total = np.zeros(d)
    for _, face in [pair for pair in FACES_OF if len(pair[0]) == d]:
        normal = normal_of(face, d)
        loads = block.load(Traction(face, -pressure * normal, follower=True))  # type: ignore[arg-type]
        force = block.apply(loads)
        nanson = np.linalg.det(gradient) * np.linalg.inv(gradient).T @ normal * face_of(size, face)[1]
        np.testing.assert_allclose(force.sum(axis=0), -pressure * nanson, rtol=1e-12, atol=1e-13)
        total += force.sum(axis=0)
    np.testing.assert_allclose(total, 0.0, atol=1e-11 * pressure)


@pytest.mark.parametrize("size", [(3, 2), (2, 3, 2)])
@pytest.mark.parametrize("turned", [False, True])
def test_pressure_on_all_faces_has_the_virial_of_the_volume(size: tuple[int, ...], turned: bool) -> None:
    """Over a closed surface sum x (x) f = -p V I, by the divergence theorem."""
    block = Block(size)
    d = block.dimension
    gradient = np.diag([1.2, 0.9, 1.1][:d])
    if turned:
        gradient = (QUARTER if d == 2 else QUARTER_ABOUT_Z) @ gradient
    block.deform(gradient, np.array([3.1, 1.7, 0.4][:d]))
    loads = [
        Traction(face, -4.0 * normal_of(face, d), follower=True)  # type: ignore[arg-type]
        for s, face in FACES_OF
        if len(s) == d
    ]
    force = block.apply(block.load(*loads, interpolation="cpgimp"))
    volume = np.linalg.det(gradient) * np.prod(size)
    np.testing.assert_allclose(moments(block.places, force), -4.0 * volume * np.eye(d), atol=1e-11 * volume)


def averaged_gradient(block: Block, half: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes (n, 9), weights and gradients (n, 9, 2) of GIMP by differences of the integral of the hat function."""

    xi = block.rows[:, :2] - block.origin
    low = np.rint(xi).astype(int) - 1
    parts = []
    for a in range(2):
        t = xi[:, a, None] - (low[:, a, None] + np.arange(3))
        value = averaged_hat(t, np.float64(half))
        slope = (np.maximum(1 - np.abs(t + half), 0) - np.maximum(1 - np.abs(t - half), 0)) / (2 * half)
        parts.append((value, slope))
    node = (low[:, 0, None, None] + np.arange(3)[None, None, :]) + (block.cells + 1) * (
        low[:, 1, None, None] + np.arange(3)[None, :, None]
    )
    (sx, gx), (sy, gy) = parts
    weight = sy[:, :, None] * sx[:, None, :]
    gradient = np.stack([sy[:, :, None] * gx[:, None, :], gy[:, :, None] * sx[:, None, :]], axis=-1)
    return node.reshape(-1, 9), weight.reshape(-1, 9), gradient.reshape(-1, 9, 2)


@pytest.mark.parametrize("shift", [0.0, 1e-7, 2e-4, 0.03, 0.31, -0.2])
def test_tractions_balance_a_uniform_stress_on_every_node(shift: float) -> None:
    """Also on nodes that only a sliver of a domain reaches, relative to the force on that node."""
    block = Block((4, 3))
    block.deform(np.eye(2), np.array([1.0 + shift, 2.0 - 0.7 * shift]))
    node, weight, gradient = averaged_gradient(block, 0.25)
    block.momentum[:, 0] = 0.0
    np.add.at(block.momentum[:, 0], node, weight)
    stress = np.array([[2.0, 0.6], [0.6, -1.1]])
    parts = -0.25 * gradient @ stress
    internal = np.zeros((block.places.shape[0], 2))
    size = np.zeros(block.places.shape[0])
    np.add.at(internal, node, parts)
    np.add.at(size, node, np.abs(parts).sum(axis=-1))
    loads = [
        Traction(face, stress @ normal_of(face, 2))  # type: ignore[arg-type]
        for face in ("left", "right", "bottom", "top")
    ]
    force = block.apply(block.load(*loads))
    left = np.abs(force + internal).max(axis=1)
    assert left.max() < 1e-14
    reached = block.momentum[:, 0] > 1e-20
    assert shift != 2e-4 or size[reached].min() < 1e-3
    assert np.all(left[reached] < 1e-7 * size[reached])


def test_region_cuts_the_loaded_part_exactly() -> None:
    block = Block((6, 2))
    region = ((1.6, 1.0), (2.93, 2.5))
    force = block.apply(block.load(Traction("top", (0.0, -3.0), region=region)))
    np.testing.assert_allclose(force.sum(axis=0), [0.0, -3.0 * 1.33], rtol=1e-12)
    assert moments(block.places, force)[0, 1] == pytest.approx(-3.0 * 1.33 * 0.5 * (1.6 + 2.93), rel=1e-12)
    slab = Block((4, 3, 2))
    patch = ((0.7, 0.2, 1.0), (1.9, 2.25, 3.0))
    force = slab.apply(slab.load(Traction("front", (0.0, 0.0, 2.0), region=patch)))
    assert force[:, 2].sum() == pytest.approx(2.0 * 1.2 * 2.05, rel=1e-12)


def test_time_function_scales_and_weights_do_not() -> None:
    block = Block((3, 2))
    block.weight[:] = 0.1
    loads = block.load(Traction("right", (2.0, 0.0), Sine(3.0, 0.7)))
    for step in (0, 1, 40):
        force = block.apply(loads, step)
        assert force[:, 0].sum() == pytest.approx(2.0 * 2.0 * 3.0 * np.sin(0.7 * DT * step), rel=1e-12)


def test_lost_points_take_their_part_of_the_load_with_them() -> None:
    block = Block((3, 2))
    loads = block.load(Traction("right", (2.0, 0.0)))
    gone = np.flatnonzero(block.reference[:, 0] > 2.5)[1]
    last = np.flatnonzero(block.row_of == block.count - 1)[0]
    block.row_of[[gone, last]] = block.row_of[[last, gone]]
    block.rows[block.row_of, :2] = block.reference
    block.rows[block.row_of[gone], :2] = np.nan
    force = block.apply(loads, alive=block.count - 1)
    assert force[:, 0].sum() == pytest.approx(2.0 * 1.5, rel=1e-12)


def test_nodes_without_material_hand_their_share_to_the_others() -> None:
    block = Block((3, 2))
    block.deform(np.eye(2), np.array([0.3, 0.0]))
    block.momentum[block.places[:, 0] > 3.5, 0] = 0.0
    force = block.apply(block.load(Traction("right", (5.0, 0.0))))
    assert np.all(force[block.places[:, 0] > 3.5] == 0.0)
    assert force[:, 0].sum() == pytest.approx(10.0, rel=1e-12)


def test_a_split_point_keeps_the_place_of_its_face() -> None:
    """After a split the id belongs to one piece; the face stays where it was."""
    block = Block((3, 2))
    block.deform(QUARTER, np.array([4.0, 1.0]))
    loads = block.load(Traction("right", (2.0, -1.0)))
    expected = moments(block.places, block.apply(loads))
    moved = block.reference - 0.125
    block.rows[block.row_of, :2] = moved @ QUARTER.T + [4.0, 1.0]
    loads.set_points(moved)
    np.testing.assert_allclose(moments(block.places, block.apply(loads)), expected, rtol=1e-12)
    loads.set_points(moved[:-1])
    with pytest.raises(ValueError, match="set_points"):
        block.apply(loads)


def test_work_is_force_times_displacement() -> None:
    """A nodal velocity v = a + L x moves each place by dt v, so the work of a load is in closed form."""
    block = Block((3, 2))
    block.deform(np.eye(2), np.array([1.3, 0.7]))
    rng = np.random.default_rng(1)
    constant, slope = rng.normal(size=2), rng.normal(size=(2, 2))
    velocity = constant + block.places @ slope.T
    loads = block.load(
        Traction("top", (1.0, -2.0)),
        BodyForce((0.5, -9.81), Constant(2.0)),
        BodyForce(lambda x, t: np.stack([3.0 + 0.0 * x[:, 0], 2.0 * x[:, 0]], axis=1)),
    )
    block.apply(loads)
    work = block.work(loads, velocity)
    centre = np.array([1.5 + 1.3, 2.0 + 0.7])
    assert work[0] == pytest.approx(DT * 3.0 * np.array([1.0, -2.0]) @ (constant + slope @ centre), rel=1e-12)
    nodal = DT * 2.0 * (block.momentum[:, 0, None] * velocity).sum(axis=0) @ np.array([0.5, -9.81])
    assert work[1] == pytest.approx(nodal, rel=1e-12)
    x = block.rows[:, :2]
    mass = block.rows[:, block.columns.mass, None]
    body = mass * np.stack([np.full(block.count, 3.0), 2.0 * x[:, 0]], axis=1)
    assert work[2] == pytest.approx(DT * (body * (constant + x @ slope.T)).sum(), rel=1e-12)


def test_body_forces() -> None:
    block = Block((3, 2))
    mass = block.rows[:, block.columns.mass]
    node, weight, _ = block.linear(block.rows[:, :2])
    block.momentum[:, 0] = 0.0
    np.add.at(block.momentum[:, 0], node, weight * mass[:, None])
    force = block.apply(block.load(BodyForce((0.5, -9.81), Ramp(4 * DT))), step=3).copy()
    np.testing.assert_allclose(force, 0.75 * block.momentum[:, :1] * np.array([0.5, -9.81]), rtol=1e-12)
    # A field that is the same everywhere puts the same force on every node.
    field = BodyForce(lambda x, t: np.full_like(x, 1.0) * [0.5 * t, -9.81 * t])
    np.testing.assert_allclose(block.apply(block.load(field), step=15), 0.75 * force / 0.75, rtol=1e-11, atol=1e-12)
    turning = BodyForce(lambda x, t: np.stack([-x[:, 1], x[:, 0]], axis=1))
    x = block.rows[:, :2]
    total = (mass[:, None] * np.stack([-x[:, 1], x[:, 0]], axis=1)).sum(axis=0)
    np.testing.assert_allclose(block.apply(block.load(turning)).sum(axis=0), total, rtol=1e-12)


# ---- absorbing edges -----------------------------------------------------------------------------------


def test_dashpot_force_is_that_of_the_interpolated_velocity() -> None:
    """For a small step: traction -Z v at the moved face, with the weight of the points as a factor."""
    block = Block((3, 2))
    block.deform(np.eye(2), np.array([0.4, 0.3]))
    block.weight[:] = 0.25
    velocity = np.array([2.0, -1.0]) + block.places @ np.array([[0.3, -0.1], [0.2, 0.4]]).T
    block.momentum[:, 1:3] = block.momentum[:, :1] * velocity
    edge = AbsorbingEdge("right", 2.0, 3.0, 1.5)
    np.testing.assert_allclose(edge.impedance(2), [6.0, 3.0])
    dt = 1e-9
    loads = block.load(edge, thickness=0.5, time_step=dt)
    force = block.apply(loads)
    centre = np.array([3.4, 1.3])
    at_centre = np.array([2.0, -1.0]) + np.array([[0.3, -0.1], [0.2, 0.4]]) @ centre
    np.testing.assert_allclose(force.sum(axis=0), -0.25 * 0.5 * 2.0 * np.array([6.0, 3.0]) * at_centre, rtol=1e-7)
    assert block.work(loads, velocity, dt)[0] == pytest.approx(dt * (force * velocity).sum(), rel=1e-10)
    assert block.work(loads, velocity, dt)[0] < 0.0


def test_dashpots_of_two_edges_share_a_corner() -> None:
    """One node with dashpots of both edges decays by the sum of both coefficients, in closed form."""
    block = Block((1, 1), points_per_cell=1)
    block.momentum[:, 0] = 0.2
    block.momentum[:, 1:3] = 0.2 * np.array([1.0, -2.0])
    edges = AbsorbingEdge("right", 1.0, 3.0, 2.0), AbsorbingEdge("top", 1.0, 3.0, 2.0)
    loads = block.load(*edges)
    for _ in range(2):  # the second time the scratch tables hold what the first has left
        force = block.apply(loads).copy()
    after = block.momentum[:, 1:3] / 0.2 + DT * force / 0.2
    corner = np.flatnonzero(np.all(block.places == 1.0, axis=1))[0]
    end = np.flatnonzero(np.all(block.places == [1.0, 0.0], axis=1))[0]
    # Each edge's unit length gives half of its coefficient to either end.
    np.testing.assert_allclose(after[corner], np.array([1.0, -2.0]) * np.exp(-DT / 0.2 * 0.5 * 5.0), rtol=1e-12)
    np.testing.assert_allclose(after[end], np.array([1.0, -2.0]) * np.exp(-DT / 0.2 * 0.5 * np.array([3.0, 2.0])))
    velocity = 0.5 * (after + block.momentum[:, 1:3] / 0.2)
    work = block.work(loads, velocity)
    assert work.sum() == pytest.approx(DT * (force * velocity).sum(), rel=1e-12)
    assert np.all(work < 0.0)


def test_dashpots_are_stable_on_nearly_empty_nodes_and_keep_a_steady_drift() -> None:
    block = Block((1, 1), points_per_cell=1)
    block.momentum[:, 0] = 1e-6
    loads = block.load(AbsorbingEdge("right", 1.0, 4.0, 2.0))
    pull = 3.0
    node = np.flatnonzero(np.all(block.places == [1.0, 1.0], axis=1))[0]
    for _ in range(5):
        block.momentum[:, 3:] = 0.0
        block.momentum[node, 3] = pull
        loads.apply(
            0, block.rows, block.row_of, block.count, block.momentum, block.everywhere, block.stencils_at,
            block.scatter_points,
        )  # fmt: skip
        block.momentum[:, 1:3] += DT * block.momentum[:, 3:]
    # Half of the edge's dashpot sits on the node: it drifts with force over coefficient.
    assert block.momentum[node, 1] / 1e-6 == pytest.approx(pull / (0.5 * 4.0), rel=1e-9)


@pytest.mark.parametrize("component", [0, 1])
def test_wave_leaves_through_an_absorbing_edge(component: int) -> None:
    """A strip of linear cells with lumped masses: less than 1 % of a pressure or shear wave comes back."""
    cells, cells_per_wave, density, speed = 120, 20, 1.7, 2.3
    block = Block((cells, 1), cells=cells + 8)
    place = block.places
    column = np.rint(place[:, 0]).astype(int)
    inside = (column >= 0) & (column <= cells) & (place[:, 1] >= 0.0) & (place[:, 1] <= 1.0)
    mass = np.where(inside, 0.5 * density, 0.0)
    mass[inside & ((column == 0) | (column == cells))] *= 0.5
    block.momentum[:] = 0.0
    block.momentum[:, 0] = mass
    edge = AbsorbingEdge("right", density, speed if component == 0 else 0.7 * speed, speed)
    if component == 1:
        edge = AbsorbingEdge("right", density, 1.4 * speed, speed)
    dt = 0.4 / speed
    loads = block.load(edge, time_step=dt)
    rows = [np.flatnonzero(inside & (place[:, 1] == y)) for y in (0.0, 1.0)]
    x = np.arange(cells + 1.0)
    length = 4 * cells_per_wave
    start = 20.0

    def wave(s: np.ndarray) -> np.ndarray:
        window = np.where((s > start) & (s < start + length), np.sin(np.pi * (s - start) / length) ** 2, 0.0)
        return window * np.sin(2 * np.pi * s / cells_per_wave)

    u = wave(x)
    # Velocities are half a step behind displacements.
    block.momentum[rows[0], 1 + component] = mass[rows[0]] * (wave(x) - wave(x + speed * dt)) / dt
    block.momentum[rows[1], 1 + component] = block.momentum[rows[0], 1 + component]
    energy = (block.momentum[inside, 1:3] ** 2 / mass[inside, None]).sum()
    taken = 0.0
    steps = round((cells + 60.0) / 0.4)
    for step in range(steps):
        stress = density * speed**2 * np.diff(u)
        force = np.zeros(cells + 1)
        force[:-1] += 0.5 * stress
        force[1:] -= 0.5 * stress
        block.momentum[:, 3:] = 0.0
        for row in rows:
            block.momentum[row, 3 + component] = force
        loads.apply(
            step, block.rows, block.row_of, block.count, block.momentum, block.everywhere, block.stencils_at,
            block.scatter_points,
        )  # fmt: skip
        block.momentum[:, 1:3] += dt * block.momentum[:, 3:]
        velocity = np.divide(block.momentum[:, 1:3], mass[:, None], where=mass[:, None] > 0, out=np.zeros_like(place))
        taken += block.work(loads, velocity, dt)[0]
        u = u + dt * velocity[rows[0], component]
    assert np.abs(u).max() < 0.01
    # Kinetic and strain energy of a running wave are equal, and all of it has been taken.
    assert taken == pytest.approx(-energy, rel=0.03)


def test_oblique_waves_reflect_as_documented() -> None:
    """Plane waves in a half space whose surface has the tractions of the dashpots, solved for the reflections."""
    poisson, shear, density = 0.3, 2.0, 1.3
    lame = 2.0 * shear * poisson / (1.0 - 2.0 * poisson)

    class Solid:
        density = 1.3
        shear_modulus = shear
        pressure_wave_speed = float(np.sqrt((lame + 2.0 * shear) / 1.3))

    edge = AbsorbingEdge.of("top", Solid())
    impedance = edge.impedance(2)
    speeds = {"p": Solid.pressure_wave_speed, "s": float(np.sqrt(shear / density))}
    text = " ".join((AbsorbingEdge.__doc__ or "").split())

    def residual(kind: str, way: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
        gradient = 1j / speeds[kind] * np.outer(amplitude, way)
        stress = lame * np.trace(gradient) * np.eye(2) + shear * (gradient + gradient.T)
        return stress[:, 1] + impedance * (-1j * amplitude)

    found: dict[str, list[float]] = {"p": [], "s": []}
    for degrees in (15, 30, 45, 60, 75):
        sine = np.sin(np.radians(degrees))
        slow = sine * speeds["s"] / speeds["p"]
        incident = np.array([sine, np.sqrt(1 - sine**2)])
        back = incident * [1.0, -1.0]
        sideways = np.array([slow, -np.sqrt(1 - slow**2)])
        across = np.array([np.sqrt(1 - slow**2), slow])
        system = np.column_stack([residual("p", back, back), residual("s", sideways, across)])
        p, s = np.abs(np.linalg.solve(system, -residual("p", incident, incident)))
        found["p"].append(p)
        found["s"].append(s)
    for kind, digits in (("pressure", found["p"]), ("shear", found["s"])):
        listed = text.split(f"{kind} waves of ")[1].split(" and shear")[0].split(". ")[0].rstrip(".")
        np.testing.assert_allclose([float(v) for v in listed.split(", ")], digits, atol=5e-3)


# ---- with the solver ----------------------------------------------------------------------------------


LAW = IsotropicElastic(1e9, 0.3, 1000.0, "plane_strain")


@pytest.mark.parametrize("interpolation", ["ugimp", "linear", "cpgimp", "bspline"])
def test_momentum_is_force_times_time_while_the_body_crosses_cells(interpolation: str) -> None:
    body = fill_rectangle((0.0, 0.0), (6.0, 4.0), 1.0)
    dt = 0.3 / LAW.pressure_wave_speed
    start = np.tile([0.05 / dt, 0.03 / dt], (body.count, 1))
    loads = [
        Traction("right", (2e4, -1e4)),
        Traction("top", (0.0, -3e4), Ramp(60 * dt), region=((1.3, 4.0), (3.7, 4.0))),
    ]
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0), 1.0, (18, 14)),
        body,
        LAW,
        0.5,
        dt,
        scheme=Scheme(interpolation=interpolation),  # type: ignore[arg-type]
        loads=loads,
        initial_velocity=start,
    )
    solver.advance(60)
    assert solver.points.displacement[:, 0].mean() > 2.9
    mass = solver.points.mass[:, None]
    gain = (mass * (solver.points.velocity - start)).sum(axis=0)
    # Forces act over each step with their value at its start, so the ramp's impulse is a sum.
    ramp = -3e4 * 2.4 * 0.5 * dt * (np.arange(60) / 60).sum()
    constant = np.array([2e4, -1e4]) * 4.0 * 0.5 * 60 * dt
    np.testing.assert_allclose(gain, constant + np.array([0.0, ramp]), rtol=1e-9)


def test_traction_in_space() -> None:
    law = IsotropicElastic(1e9, 0.3, 1000.0, "three_dimensional")  # type: ignore[arg-type]
    body = fill_region((0.0, 0.0, 0.0), (3.0, 2.0, 2.0), 1.0, lambda x: np.ones(len(x), dtype=bool))
    dt = 0.3 / law.pressure_wave_speed
    solver = MaterialPointSolver(
        Grid((-3.0, -3.0, -3.0), 1.0, (9, 8, 8)), body, law, 1.0, dt, loads=[Traction("front", (1e3, 0.0, -2e3))]
    )
    solver.advance(20)
    momentum = (solver.points.mass[:, None] * solver.points.velocity).sum(axis=0)
    np.testing.assert_allclose(momentum, np.array([1e3, 0.0, -2e3]) * 6.0 * 20 * dt, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("field", [False, True])
def test_free_fall(field: bool) -> None:
    body = fill_rectangle((0.0, 0.0), (6.0, 4.0), 1.0)
    dt = 0.4 / LAW.pressure_wave_speed
    gravity = np.array([0.0, -9.81])
    load = BodyForce(lambda x, t: np.tile(gravity, (len(x), 1))) if field else BodyForce(gravity)
    solver = MaterialPointSolver(Grid((-3.0, -3.0), 1.0, (12, 10)), body, LAW, 1.0, dt, loads=[load])
    solver.advance(50)
    np.testing.assert_allclose(solver.points.velocity, np.tile(gravity * 50 * dt, (body.count, 1)), atol=1e-12)
    # Nothing but the load gives the body its kinetic energy.
    work = 0.5 * 24.0 * 1000.0 * (9.81 * 50 * dt) ** 2
    assert solver.energies().load_work == pytest.approx(work, rel=1e-9)


def test_wave_leaves_a_strip_of_material_points() -> None:
    """Less than 1 % of the amplitude of a wave of 48 cells comes back, in the default scheme."""
    length, wave = 160, 48
    body = fill_rectangle((0.0, 0.0), (float(length), 2.0), 1.0)
    sides = [EdgeCondition(edge, 1, (0.0,), (0.0,)) for edge in ("bottom", "top")]  # type: ignore[arg-type]
    x = body.position[:, 0] - 0.5 * length
    velocity = np.zeros((body.count, 2))
    window = np.where(np.abs(x) < 1.5 * wave, np.cos(np.pi * x / (3.0 * wave)) ** 2, 0.0)
    velocity[:, 0] = 1e-3 * window * np.cos(2.0 * np.pi * x / wave)
    solver = MaterialPointSolver(
        Grid((-4.0, -4.0), 1.0, (length + 8, 10)),
        body,
        LAW,
        1.0,
        0.4 / LAW.pressure_wave_speed,
        sides,
        loads=[AbsorbingEdge.of("left", LAW), AbsorbingEdge.of("right", LAW)],
        initial_velocity=velocity,
    )
    start = solver.energies().kinetic
    solver.advance(round(1.3 * length / 0.4))
    end = solver.energies()
    assert np.sqrt((end.kinetic + end.strain) / start) < 0.01
    assert -start < end.load_work < -0.95 * start


# ---- bad input -----------------------------------------------------------------------------------------


def plane(**change: object) -> Callable[[], object]:
    return lambda: Block((2, 2)).load(Traction(**({"face": "top", "vector": (0.0, 1.0)} | change)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: BodyForce((1.0,)), r"BodyForce.acceleration = \(1.0,\)"),
        (lambda: Block((2, 2)).load(BodyForce((1.0, 0.0, 0.0))), r"loads\[0\].acceleration"),
        (plane(face="up"), "Traction.face = 'up'"),
        (plane(vector=(0.0, np.nan)), "Traction.vector"),
        (plane(face="front", vector=(0.0, 1.0)), "three numbers are needed on face 'front'"),
        (plane(vector=(0.0, 1.0, 0.0)), r"loads\[0\].vector"),
        (plane(vector=(1.0, 1.0), follower=True), "a follower is normal to its face"),
        (plane(region=((0.0, 0.0), (1.0,))), r"Traction.region\[1\]"),
        (plane(region=((1.0, 0.0), (0.0, 1.0))), "lower <= upper"),
        (plane(region=((5.0, 2.0), (6.0, 2.0))), r"loads\[0\]: no material point has a face on the body's top face"),
        (plane(region=((0.0, 0.0), (1.0, 1.5))), "no material point has a face"),
        (lambda: AbsorbingEdge("top", -1.0, 1.0, 1.0), "AbsorbingEdge.density = -1.0"),
        (lambda: AbsorbingEdge("up", 1.0, 1.0, 1.0), "AbsorbingEdge.face = 'up'"),  # type: ignore[arg-type]
        (lambda: Block((2, 2)).load(AbsorbingEdge("front", 1.0, 1.0, 1.0)), r"loads\[0\].face = 'front'"),
    ],
)
def test_bad_loads_are_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_a_field_of_the_wrong_shape_is_named() -> None:
    block = Block((2, 2))
    with pytest.raises(ValueError, match=r"a field must return finite values of shape \(16, 2\)"):
        block.apply(block.load(BodyForce(lambda x, t: x[:, 0])))


def test_face_places_tile_the_face() -> None:
    block = Block((3, 4), points_per_cell=3)
    places = face_places("loads[0]", "left", block.reference, block.half, block.lower, block.upper, 0.25)
    assert places.ids.size == 12
    assert np.all(places.reference[:, 0] == 0.0)
    low, high = places.reference - places.half, places.reference + places.half
    order = np.argsort(low[:, 1])
    np.testing.assert_allclose(low[order, 1], np.arange(12) / 3.0, atol=1e-14)
    np.testing.assert_allclose(high[order, 1], np.arange(1, 13) / 3.0, rtol=1e-14)
    np.testing.assert_allclose(places.area, 0.25 / 3.0, rtol=1e-14)
