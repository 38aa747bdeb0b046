"""What is read of a damaged recording: what is whole, with a word about the damage, or nothing; never nonsense."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard

from tests.errors import raises
from tests.recording import small_run
from toolee_robot.errors import UserError
from toolee_robot.recording.history import RunHistory
from toolee_robot.recording.reading import read_history


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A sound recording."""
    return small_run.write(tmp_path_factory.mktemp("run") / "run.mcap").read_bytes()


def _read(path: Path, data: bytes) -> RunHistory | None:
    """What is read of a file; None if it is refused by the one error for this."""
    path.write_bytes(data)
    try:
        return read_history(path)
    except UserError as error:
        if error.code != "user.recording_unreadable":
            raise
        return None


def _values(history: RunHistory) -> tuple[object, ...]:
    decisions = [(d.stamp, d.name, d.reason) for _, d in history.decisions]
    return history.metadata, history.attachments, decisions, [q.tolist() for _, q in history.joints]


def test_a_flipped_bit_is_noticed_wherever_it_is(whole: bytes, tmp_path: Path) -> None:
    sound = _read(tmp_path / "run.mcap", whole)
    assert sound is not None
    assert (sound.complete, sound.damage) == (True, "")
    rng = np.random.default_rng(0)
    noticed = 0
    for bit in rng.integers(0, 8 * len(whole), 200).tolist():
        data = bytearray(whole)
        data[bit // 8] ^= 1 << bit % 8
        history = _read(tmp_path / "run.mcap", bytes(data))
        if history is None or not history.complete:
            noticed += 1
        else:
            assert _values(history) == _values(sound), "only the index may be damaged unnoticed"
    assert noticed > 180


def test_a_damaged_attachment_is_said_and_not_used(whole: bytes, tmp_path: Path) -> None:
    """The station is not taken from it: the nail would stand elsewhere."""
    at = whole.index(b"nail_xy") + 12
    history = _read(tmp_path / "run.mcap", whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    assert history is not None
    assert not history.complete
    assert "a checksum is wrong" in history.damage
    with raises(UserError, says="the recording holds no station"):
        history.station()


def test_it_is_read_up_to_where_it_was_cut(whole: bytes, tmp_path: Path) -> None:
    for share in (0.0, 0.00001, 0.01, 0.5, 0.9, 0.99, 0.9999):
        history = _read(tmp_path / "run.mcap", whole[: int(share * len(whole))])
        assert history is None or (not history.complete and not history.damage)
    zeros = _read(tmp_path / "run.mcap", whole[:-4000] + bytes(100_000))
    assert zeros is not None
    assert not zeros.complete
    assert len(zeros.joints) == 252, "a tail of zeros, as a power cut leaves it"


def test_a_chunk_that_unpacks_to_a_gigabyte_is_refused(tmp_path: Path) -> None:
    packed = zstandard.compress(bytes(2**27))
    for said in (2**30, 1000):
        content = struct.pack("<QQQI", 0, 0, said, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(packed))
        record = b"\x06" + struct.pack("<Q", len(content) + len(packed)) + content + packed
        assert _read(tmp_path / "run.mcap", b"\x89MCAP0\r\n" + record) is None


def test_no_recording_is_refused(tmp_path: Path) -> None:
    assert _read(tmp_path / "text.mcap", b"this is no recording, whatever its name says") is None
    with raises(UserError, code="user.recording_unreadable"):
        read_history(tmp_path / "nothing.mcap")
