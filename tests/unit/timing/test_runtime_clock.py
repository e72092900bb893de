import pytest

from telenano.testing import VirtualClock
from telenano.timing.clock import EPOCH_OFFSET_VARIABLE, SystemClock
from telenano.wire.errors import ConfigError


def test_header_time_is_the_monotonic_clock_with_a_constant_offset() -> None:
    clock = SystemClock(epoch_offset_ns=10**18)
    before = clock.monotonic_ns()
    now = clock.now_ns()
    assert before + 10**18 <= now <= clock.monotonic_ns() + 10**18


def test_offset_is_inherited_from_the_supervisor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(EPOCH_OFFSET_VARIABLE, "123456789")
    assert SystemClock().epoch_offset_ns == 123456789
    monkeypatch.setenv(EPOCH_OFFSET_VARIABLE, "-5")
    assert SystemClock().epoch_offset_ns == -5
    # zero given is zero, not "none given"
    assert SystemClock(0).epoch_offset_ns == 0


def test_a_wrong_inherited_offset_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(EPOCH_OFFSET_VARIABLE, "1e9")
    with pytest.raises(ConfigError, match=f"{EPOCH_OFFSET_VARIABLE} is '1e9', must be an integer"):
        SystemClock()


def test_the_epoch_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(EPOCH_OFFSET_VARIABLE, raising=False)
    monkeypatch.setattr("time.time_ns", lambda: 1_700_000_000_000_000_000)
    monkeypatch.setattr("time.monotonic_ns", lambda: 1_000)
    clock = SystemClock()
    # the wall clock is set back by an hour while the process runs
    monkeypatch.setattr("time.time_ns", lambda: 1_699_996_400_000_000_000)
    monkeypatch.setattr("time.monotonic_ns", lambda: 1_500)
    assert clock.now_ns() == 1_700_000_000_000_000_500


def test_virtual_time_passes_only_when_advanced() -> None:
    clock = VirtualClock(start_ns=5, epoch_offset_ns=100)
    assert (clock.monotonic_ns(), clock.now_ns()) == (5, 105)
    clock.advance_ns(0)
    clock.advance_ns(3)
    assert (clock.monotonic_ns(), clock.now_ns(), clock.epoch_offset_ns) == (8, 108, 100)
    with pytest.raises(ValueError, match="duration_ns is -1"):
        clock.advance_ns(-1)
    assert clock.monotonic_ns() == 8
