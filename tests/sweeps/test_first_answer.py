"""sweeps/timing/first_answer.py: spectra against others, and the page of answers."""

from __future__ import annotations

import h5py

from sweeps.timing import first_answer
from sweeps.timing.first_answer import Answer


def test_spectra_are_held_against_others(tmp_path):
    path, spectra = tmp_path / "a.h5", {"a": {"mean": [0.5, -1.0], "error": [0.01, 0.01]}}
    with h5py.File(path, "w") as file:
        file["lyapunov/exponents"], file["lyapunov/exponents_error"] = [[0.52, -1.0]], [[0.01, 0.01]]
    assert first_answer.differs("a", path, spectra) == ""
    assert first_answer.differs("b", path, spectra) is None
    spectra["a"]["mean"][0] = 0.6
    assert first_answer.differs("a", path, spectra).startswith("a: ")


def test_page_has_medians_and_refusals(monkeypatch):
    monkeypatch.setattr(first_answer, "version", lambda _: "0.96")
    text = "3.0 s: compile 1.5 s, run 0.5 s, set-up and the rest 1.0 s"
    empty = {"a": Answer(0, 3.0, text), "b": Answer(0, 5.0, text), "c": Answer(2, 1.0, "c.yaml:1: no such key")}
    page = first_answer.page(
        empty, {"a": Answer(0, 2.0, text)}, {"a": "", "b": "b: [1] ± [0], there [2] ± [0]"}, dict.fromkeys("abc", 3)
    )
    assert "| empty | 2 | 4.0 | 4.8 | 5.0 |" in page
    assert "| kept | 1 | 2.0 | 2.0 | 2.0 |" in page
    assert "2 of 3 flows are answered. Of 2 there is an independent integration; 1 agree" in " ".join(page.split())
    assert "- c: c.yaml:1: no such key" in page
    assert "| a | 3 | 3.0 | 1.5 | 0.5 |" in page


def test_a_file_that_is_wrong_has_its_reason(monkeypatch):
    monkeypatch.setattr(first_answer, "version", lambda _: "0.96")
    text = "3.0 s: compile 1.5 s, run 0.5 s, set-up and the rest 1.0 s"
    refusals = {name: Answer(2, 1.0, "sys.py:5: the system depends on t") for name in ("Torus", "d")}
    answers = {"a": Answer(0, 3.0, text), **refusals}
    page = first_answer.page(answers, {"a": answers["a"]}, {"a": ""}, dict.fromkeys(answers, 3))
    assert "- Torus: sys.py:5: the system depends on t; rightly: its rates are functions of t alone" in page
    assert "- d: sys.py:5: the system depends on t\n" in page
