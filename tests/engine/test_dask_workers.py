"""What a client of Dask makes of a result that is gone with its worker between the end of the work and its delivery."""

from unittest import mock

import pytest
from distributed.client import FutureState

from jaxnh.engine import dask_workers
from jaxnh.exceptions import Stopped
from jaxnh.jobs.cutting import Piece


class LostOnce:
    """A future of Dask's whose result is lost `losses` times, then delivered; its states are those of Dask itself."""

    def __init__(self, losses: int, slow: bool) -> None:
        self.state, self.losses, self.slow = FutureState("key"), losses, slow
        self.state.finish()

    @property
    def status(self) -> str:
        if self.losses and not self.slow:
            self.state.lose()
        return self.state.status

    def result(self, timeout: float) -> str:
        if self.losses:
            raise TimeoutError
        return "receipt"

    def exception(self, timeout: float) -> None:
        return None

    def made_anew(self) -> None:
        self.losses -= 1
        self.state.finish()


@pytest.mark.parametrize("slow", [False, True], ids=["told before it is asked for", "told while it is asked for"])
def test_result_that_is_lost_with_its_worker(slow, tmp_path):
    """The scheduler has it made anew; the run waits for that, and does not say that the scheduler dropped it."""
    future = LostOnce(2, slow)
    client = mock.Mock(submit=mock.Mock(return_value=future))
    looks = []

    def ended(client, futures):
        if looks:
            future.made_anew()
        looks.append(list(futures))
        return futures

    receipts = []
    with mock.patch("jaxnh.engine.dask_workers._finished", ended):
        dask_workers._run_stage(
            client, tmp_path, mock.Mock(id="0123456789"), [mock.Mock(Piece, number=3)], lambda: None, receipts.append
        )
    assert receipts == ["receipt"]
    assert looks == [[future]] * 3


def test_work_that_is_dropped():
    future = mock.Mock(status="cancelled")
    with pytest.raises(Stopped, match="the Dask scheduler has dropped the work"):
        dask_workers._receipt(future, mock.Mock(Piece, number=3))
