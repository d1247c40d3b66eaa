"""The exchange in one dimension: momentum, energy, limits, waves against theory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coordinator.exchange_model import Model, State, advance, at_rest, shaken
from coordinator.handshake import Scheme
from coordinator.overlap_theory import exact_stiffness, scatter
from coordinator.weight_profile import WeightProfile

POWER = WeightProfile("power", 0.05, 8.0)


def model(profile: WeightProfile, number: float, steps_per_exchange: int = 10, cells: int = 4) -> Model:
    """Return a model of statically exact springs with an exchange number, without damper."""
    stiffness = exact_stiffness(profile)
    return Model(
        profile, stiffness, 2.0 * number * (profile.at_border / stiffness) ** 0.5, steps_per_exchange, cells=cells
    )


def mean_energies(one: Model, steps: int) -> tuple[float, float]:
    """Return means of the energy over the first and the last tenth of a shaken run; infinite where it blew up."""
    total = advance(one, shaken(one), steps).sum(axis=1)
    if len(total) < steps:
        return float(total[0]), float("inf")
    return float(total[: steps // 10].mean()), float(total[-steps // 10 :].mean())


@pytest.mark.parametrize(
    "profile", [WeightProfile("constant", 0.2), WeightProfile("linear", 0.05), POWER], ids=lambda p: p.kind
)
@pytest.mark.parametrize("steps_per_exchange", [5, 20])
def test_energy_neither_grows_nor_falls_below_the_limit_without_dampers(
    profile: WeightProfile, steps_per_exchange: int
) -> None:
    first, last = mean_energies(model(profile, 0.3, steps_per_exchange), 20000)
    assert last == pytest.approx(first, rel=0.01)


def test_energy_blows_up_beyond_the_limit() -> None:
    assert mean_energies(model(WeightProfile("constant", 0.2), 1.05), 2000)[1] == float("inf")
    assert mean_energies(model(WeightProfile("constant", 0.2), 0.9), 2000)[1] < 10.0


@pytest.mark.parametrize("number", [0.3, 0.6, 0.85])
def test_dampers_only_take_energy_below_the_limit(number: float) -> None:
    # Half of the square of the number is the dampers'.
    stiffness = exact_stiffness(POWER)
    step = 2.0 * number * (0.5 / stiffness) ** 0.5
    one = Model(POWER, stiffness, step, 10, damping=number**2 / step / 1.42, cells=3)
    first, last = mean_energies(one, 5000)
    assert last < 0.8 * first


@pytest.mark.parametrize("scheme", ["serial", "parallel"])
@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_what_the_continuum_gains_in_momentum_the_atoms_lose(scheme: Scheme, damping: float) -> None:
    """Bars that start in uniform motion and have not felt their held ends yet keep their momentum."""
    one = replace(model(POWER, 0.2), scheme=scheme, damping=damping, continuum_length=9.0, atoms_length=9.0)
    state = at_rest(one)
    node = one.nodes
    state.node_velocity[:] = np.where(node > -1.0, 1.0, 0.0)
    state.atom_velocity[:] = np.where(one.places < 2.0, 1.0, 0.0)
    mass = np.zeros(len(node))
    weight = one.element_weights() / one.cells
    mass[:-1] += 0.5 * weight
    mass[1:] += 0.5 * weight

    def momentum(now: State) -> float:
        # The reaction in hand has left the atoms and not yet reached the continuum.
        there = float(now.reaction.sum()) * one.coupling_step
        return float(mass @ now.node_velocity + now.atom_velocity.sum() / one.atoms) + there

    start = momentum(state)
    advance(one, state, round(1.0 / one.coupling_step))
    assert momentum(state) == pytest.approx(start, rel=1e-12)


def test_the_parallel_exchange_is_stable_below_its_limit_only() -> None:
    profile = WeightProfile("constant", 0.2)
    stiffness, cells = exact_stiffness(profile), 3

    def run(number: float) -> float:
        step = number / (2.0 * stiffness / profile.weight + 4.0 * cells**2) ** 0.5
        one = Model(profile, stiffness, step, 10, cells=cells, scheme="parallel")
        return mean_energies(one, 10000)[1]

    assert run(0.6) < 1.3
    assert run(1.1) == float("inf")


def test_sub_steps_of_the_continuum_are_stable_with_an_impulse_and_grow_with_an_even_force() -> None:
    one = replace(model(POWER, 0.2, cells=12), continuum_steps=5)
    first, last = mean_energies(one, 5000)
    assert last == pytest.approx(first, rel=0.02)
    assert mean_energies(replace(one, impulse=False), 5000)[1] > 10.0 * first


@pytest.mark.parametrize(
    ("profile", "stiffness", "cells"),
    [
        (POWER, None, 8),
        (WeightProfile("constant", 0.3), None, 8),
        (WeightProfile("power", 0.05, 8.0, 0.01), 300.0, 8),
        (WeightProfile("power", 0.05, 8.0, 0.01), 300.0, 4),
    ],
    ids=["power", "constant", "carried by mass", "carried by mass, coarse"],
)
def test_a_wave_packet_is_reflected_as_theory_says(profile: WeightProfile, stiffness: float | None, cells: int) -> None:
    """Peak of the packet that comes back into the continuum, for a packet of many waves."""
    wavelength, length = 10.0, 110.0
    springs = exact_stiffness(profile) if stiffness is None else stiffness
    step = 0.4 * (profile.at_border / springs) ** 0.5
    one = Model(profile, springs, step, 5, cells=cells, atoms=24, continuum_length=length, atoms_length=length)
    state = at_rest(one)
    x = one.nodes
    centre, spread = -0.5 * length, 2.0 * wavelength

    def packet(place: np.ndarray) -> np.ndarray:
        return np.exp(-(((place - centre) / spread) ** 2)) * np.cos(2.0 * np.pi * (place - centre) / wavelength)

    state.node[:] = np.where(x < 0.0, packet(x), 0.0)
    # The velocity lives half a step before the displacement.
    state.node_velocity[:] = np.where(x < 0.0, (packet(x) - packet(x + one.coupling_step)) / one.coupling_step, 0.0)
    state.node[0] = state.node_velocity[0] = 0.0
    advance(one, state, round(length / one.coupling_step))  # its middle has come back to where it began
    reflected = float(np.abs(state.node[x < -0.2 * length]).max())
    transmitted = float(np.abs(state.atom[one.places > 0.2 * length]).max())
    theory = scatter(profile, springs, wavelength, cells=cells)
    assert reflected == pytest.approx(theory.reflected, abs=0.01)
    assert transmitted == pytest.approx(theory.transmitted, abs=0.02)
