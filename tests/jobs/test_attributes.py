"""Root attributes of a result say how it was made, in types that HDF5 and netCDF keep."""

from __future__ import annotations

import json
import subprocess
import sys

import h5py
import numpy as np
import pytest

from jaxnh.jobs.attributes import UserFileText, root_attributes, steps_in_words
from jaxnh.jobs.cutting import Cutting
from jaxnh.jobs.job import Job, NumericalPlan
from jaxnh.jobs.provenance import Provenance, SecondsSpent, versions
from jaxnh.storage import hdf5 as store
from tests.helpers.paths import ROOT

METHOD = NumericalPlan("processed6", 252, False, 9.7e-11, {"lyapunov": {"parts": 4}})
ORIGIN = Provenance("c" * 64, {"jaxnh": "0.1.0", "jax": "0.10.2"}, {"processor": "x86_64 avx2", "xla_options": ""})
SPENT = SecondsSpent(19.9, 9.7, 1028153.0, "2 x cpu (cpu)")


def attributes(*, axes=("b",), **others):
    return root_attributes(
        Job(METHOD, Cutting(tuple((name, 1, False) for name in axes), 1, (), ()), ORIGIN),
        title="Täst",
        config="sweep: {}\n",
        precision="float64",
        spent=SPENT,
        **{"strobe_period": 2 * np.pi, "command": "python -m jaxnh.sweep a.yaml", **others},
    )


def test_attributes_are_those_of_a_result(tmp_path):
    """Names, order and types of a file that is kept from before there were several axes, and what came later."""
    path = tmp_path / "result.h5"
    store.write(path, attributes(), {})
    with h5py.File(path) as file, h5py.File(ROOT / "results" / "table1.h5") as kept:
        later = {"axes", "processor", "stages", "xla_options"}
        assert [name for name in file.attrs if name not in later] == [name for name in kept.attrs if name not in later]
        for name, value in kept.attrs.items():
            assert file.attrs.get_id(name).dtype == kept.attrs.get_id(name).dtype, name
            assert np.shape(file.attrs[name]) == np.shape(value)
        assert json.loads(file.attrs["versions"]) == {"jax": "0.10.2"}
        assert file.attrs["jaxnh_version"] == "0.1.0"
        assert file.attrs["axes"] == "b"
        assert file.attrs["strobe_period"] == 2 * np.pi
        assert file.attrs["history"].endswith("+00:00 python -m jaxnh.sweep a.yaml")


def test_several_axes_and_periods(tmp_path):
    """A period for each value of a shared axis, as a list, in whatever shape it comes."""
    path = tmp_path / "result.h5"
    periods = np.linspace(5, 7, 9000)
    store.write(path, attributes(axes=("b", "omega"), strobe_period=periods[:, None]), {})
    with store.open_result(path) as tree:
        assert tree.attrs["axes"].split() == ["b", "omega"]
        np.testing.assert_array_equal(tree.attrs["strobe_period"], periods)
    store.verify(path)


def test_what_is_there_only_for_some():
    assert not {"section", "system_file"} & set(attributes())
    assert attributes(section="y1 = 0, up")["section"] == "y1 = 0, up"
    found = attributes(user_file=UserFileText("own.py", "def system(): ...", "d" * 64))
    assert [found[f"system_file{part}"] for part in ("_path", "", "_sha256")] == [
        "own.py",
        "def system(): ...",
        "d" * 64,
    ]
    assert json.loads(attributes()["auto_settings"]) == {"lyapunov": {"parts": 4}}
    assert attributes(command="")["history"].endswith("+00:00 a call from Python")


def test_steps_are_of_a_period_or_of_a_time():
    steps = METHOD.steps
    assert steps_in_words(attributes()) == f"{steps} steps a period"
    assert steps_in_words({**attributes(), "step_classes": "2*5 0*1 3*2"}) == f"32 to {steps} steps a period"
    assert steps_in_words(attributes(section="y = 0, up")) == f"{steps} steps in a time of 6.283"
    several = attributes(section="y = 0, up", strobe_period=np.array([1.0, 2.0]))
    assert steps_in_words(several) == f"{steps} steps in a unit of time"


def test_versions():
    """The package's own first, then the libraries."""
    found = versions()
    assert list(found) == ["jaxnh", "jax", "jaxlib", "diffrax", "equinox", "numpy", "h5py"]
    assert found["numpy"] == np.__version__


@pytest.mark.parametrize(
    "module", ["storage.hdf5", "storage.merge", "storage.tiles", "storage.atomic", "jobs.attributes", "jobs.assembly"]
)
def test_storage_and_jobs_need_nothing_else_of_the_package_but_its_exceptions(module):
    """Whatever is imported with it, in a process of its own."""
    code = (
        f"import sys, jaxnh.{module}; print(*(name for name in sys.modules if name.split('.')[0] in ('jaxnh', 'jax')))"
    )
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    allowed = ("jaxnh.storage", "jaxnh.jobs", "jaxnh.exceptions")
    assert [name for name in found.split() if name != "jaxnh" and not name.startswith(allowed)] == []
