"""The worker: passes in turn, stale requests stopped in the middle, failures said to their page alone."""

from __future__ import annotations

import threading

import pytest

from jaxnh.exceptions import Stopped
from jaxnh.explorer.worker import Request, Watch, Worker

PATIENCE = 10.0


@pytest.fixture
def worker():
    made = Worker()
    yield made
    made.stop()


def asked(passes, answers, *, failures=None, done=None):
    return Request(
        iter(passes),
        answers.append,
        (failures if failures is not None else []).append,
        lambda label, share: None,
        done.set if done else lambda: None,
    )


def test_first_passes_come_before_better_ones(worker):
    answers, done = [], [threading.Event(), threading.Event()]
    worker.ask("one", asked(["one coarse", "one fine"], answers, done=done[0]))
    worker.ask("other", asked(["other coarse", "other fine"], answers, done=done[1]))
    worker.start()
    assert all(event.wait(PATIENCE) for event in done)
    assert answers == ["one coarse", "other coarse", "one fine", "other fine"]


def test_a_first_pass_is_computed_ahead_and_a_failure_of_it_is_not_told(worker):
    taken, answers, failures, done = [], [], [], threading.Event()

    def passes():
        for k in range(3):
            taken.append(k)
            yield k

    def failing():
        taken.append("failing")
        raise ValueError("ahead")
        yield

    worker.ask_ahead(passes())
    worker.start().ask("page", asked(["page"], answers, failures=failures, done=done))
    assert done.wait(PATIENCE)
    assert (taken, answers, failures) == ([0], ["page"], [])
    done.clear()
    worker.ask_ahead(failing())
    worker.ask("page", asked(["again"], answers, failures=failures, done=done))
    assert done.wait(PATIENCE)
    assert (taken, answers, failures) == ([0, "failing"], ["page", "again"], [])


def test_a_new_request_stops_the_last_one_in_the_middle_of_a_pass(worker):
    watch, begun, stopped, done = Watch(worker), threading.Event(), threading.Event(), threading.Event()

    def endless():
        watch.start("work", 0.0)
        try:
            while True:
                watch.advance(1.0)
                begun.set()
        except Stopped:
            stopped.set()
            raise
        yield "never"

    answers, failures = [], []
    worker.start().ask("page", asked(endless(), answers, failures=failures))
    assert begun.wait(PATIENCE)
    worker.ask("page", asked(["new"], answers, done=done))
    assert stopped.wait(PATIENCE)
    assert done.wait(PATIENCE)
    assert (answers, failures) == (["new"], [])


def test_a_failure_is_said_and_the_next_request_is_computed(worker):
    def failing():
        raise ValueError("no")
        yield

    answers, failures, done = [], [], threading.Event()
    worker.ask("one", asked(failing(), answers, failures=failures))
    worker.ask("other", asked(["fine"], answers, done=done))
    worker.start()
    assert done.wait(PATIENCE)
    assert answers == ["fine"]
    assert [str(error) for error in failures] == ["no"]
