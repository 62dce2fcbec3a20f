"""The check of a release sees which options of XLA act, in an interpreter of its own."""

from __future__ import annotations

import sys

import pytest

from sweeps.checks import release_check


def test_options_are_those_of_the_package(tmp_path):
    options = release_check.options_there(sys.executable, tmp_path)
    assert [key for key, _ in options].count("--xla_backend_extra_options") == 3
    assert {one for _, one in options} == set(release_check._OPPOSITES)


@pytest.mark.slow
def test_all_options_act_and_what_means_nothing_does_not(tmp_path, monkeypatch):
    """An option that is its own opposite changes no code, like one that XLA has dropped."""
    assert release_check.idle_options(sys.executable, tmp_path) == []
    monkeypatch.setitem(release_check._OPPOSITES, "-force-vector-interleave=2", "-force-vector-interleave=2")
    idle = release_check.idle_options(sys.executable, tmp_path)
    assert idle == ["--xla_backend_extra_options=-force-vector-interleave=2"]
