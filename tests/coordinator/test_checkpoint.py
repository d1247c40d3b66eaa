"""Checkpoints on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from coordinator.checkpoint import NAME, CheckpointError, read_checkpoint, write_checkpoint

HEADER = {"step": 12, "scene": {"run": {"steps": 40}, "continuum": {"edges": [1.5, None]}}}


def state(seed: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    return {
        "continuum.position": random.normal(size=(50, 2)) * 1e-9,
        "atomistic.velocity": random.normal(size=(70, 3)),
        "atomistic.history": np.zeros((0, 4, 3)),
        "coupling.step": np.array([12]),
        "coupling.start": np.array([np.nan, -1.25]),
    }


def test_what_is_read_is_what_was_written_to_the_last_bit(tmp_path: Path) -> None:
    write_checkpoint(tmp_path, HEADER, state(1))
    header, found = read_checkpoint(tmp_path)
    assert header == HEADER
    assert found.keys() == state(1).keys()
    for name, array in state(1).items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        assert found[name].tobytes() == array.tobytes()


def test_a_new_checkpoint_replaces_the_old_one_whole(tmp_path: Path) -> None:
    write_checkpoint(tmp_path, HEADER, state(1))
    write_checkpoint(tmp_path, {**HEADER, "step": 13}, {"coupling.step": np.array([13])})
    header, found = read_checkpoint(tmp_path)
    assert header["step"] == 13
    assert list(found) == ["coupling.step"]
    assert [path.name for path in tmp_path.iterdir()] == [NAME]


def test_a_half_written_new_checkpoint_does_not_harm_the_old_one(tmp_path: Path) -> None:
    write_checkpoint(tmp_path, HEADER, state(1))
    whole = (tmp_path / NAME).read_bytes()
    (tmp_path / (NAME + ".new")).write_bytes(whole[: len(whole) // 2])
    assert read_checkpoint(tmp_path)[0] == HEADER
    write_checkpoint(tmp_path, {**HEADER, "step": 14}, state(2))
    assert read_checkpoint(tmp_path)[0]["step"] == 14


def test_no_checkpoint_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no checkpoint to go on from"):
        read_checkpoint(tmp_path)


@pytest.mark.parametrize("part", [0.0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_file_cut_short_is_refused_by_name(tmp_path: Path, part: float) -> None:
    write_checkpoint(tmp_path, HEADER, state(1))
    path = tmp_path / NAME
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(CheckpointError, match=NAME):
        read_checkpoint(tmp_path)


def test_a_damaged_array_is_refused(tmp_path: Path) -> None:
    write_checkpoint(tmp_path, HEADER, state(1))
    path = tmp_path / NAME
    content = bytearray(path.read_bytes())
    place = content.find(state(1)["continuum.position"].tobytes())
    assert place > 0
    content[place + 100] ^= 0x10
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="CRC"):
        read_checkpoint(tmp_path)


@pytest.mark.parametrize("content", [b"no zip at all", b"\x93NUMPY\x01\x00"])
def test_another_kind_of_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / NAME).write_bytes(content)
    with pytest.raises(CheckpointError, match="cannot be read"):
        read_checkpoint(tmp_path)


def test_an_npz_without_header_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / NAME, step=np.array([1]))
    with pytest.raises(CheckpointError, match="cannot be read"):
        read_checkpoint(tmp_path)
