"""The end of a time limit stops the work, also where Python drops the exception that its signal raises."""

import os
import signal

import pytest

from neurotact.interrupt import deferred, stop_if_asked, terminated_as_interrupted
from neurotact.progress import track


class Dropped:
    """Its end is a callback of Python's, which prints an exception and goes on."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGTERM)


def test_sigterm_is_what_ctrl_c_is():
    with pytest.raises(KeyboardInterrupt), terminated_as_interrupted():
        os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_exception_that_python_drops_is_raised_at_the_next_step():
    with terminated_as_interrupted():
        stop_if_asked()
        Dropped()
        with pytest.raises(KeyboardInterrupt):
            stop_if_asked()


def test_a_second_sigterm_does_not_break_the_tidying_up():
    with terminated_as_interrupted():
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGTERM)


def test_what_sigterm_did_before_it_does_again():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), terminated_as_interrupted():
        os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is before
    stop_if_asked()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_long_work_stops_at_its_next_step_whatever_python_dropped():
    with terminated_as_interrupted(), track("cells", 9) as advance:
        advance(1, "")
        Dropped()
        with pytest.raises(KeyboardInterrupt):
            advance(1, "")


def test_a_sigterm_that_is_ignored_stays_so():
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with terminated_as_interrupted():
            os.kill(os.getpid(), signal.SIGTERM)
            stop_if_asked()
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.fixture
def with_ctrl_c():
    """Ctrl-C acts, also where the tests run in the background, in which shells ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.usefixtures("with_ctrl_c")
def test_a_signal_waits_until_a_step_is_whole(number):
    done = []

    def a_step() -> None:
        with deferred():
            os.kill(os.getpid(), number)
            done.append("first half")
            done.append("second half")
        done.append("after it")

    with terminated_as_interrupted(), pytest.raises(KeyboardInterrupt):
        a_step()
    assert done == ["first half", "second half"]


@pytest.mark.usefixtures("with_ctrl_c")
def test_handlers_are_as_before_a_step_that_is_not_interrupted():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with deferred():
        assert signal.getsignal(signal.SIGINT) is not before[0]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
