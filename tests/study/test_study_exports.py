"""What the room of studies shows: public names, loaded when they are first used."""

import subprocess
import sys

import pytest

import optsc.study
import optsc.study.participants


@pytest.mark.parametrize("package", [optsc.study, optsc.study.participants])
def test_every_public_name_is_there(package):
    assert len(set(package.__all__)) == len(package.__all__)
    for name in package.__all__:
        assert getattr(package, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        package.no_such_name  # noqa: B018


def test_no_public_name_hides_a_module():
    for package in (optsc.study, optsc.study.participants):
        modules = {name.rpartition(".")[2] for name in sys.modules if name.startswith(f"{package.__name__}.")}
        assert modules & set(package.__all__) <= {"participants", "sweep"}


def test_importing_the_room_loads_no_heavy_module():
    heavy = ["pinocchio", "casadi", "pybullet", "trimesh", "scipy", "matplotlib", "pyarrow", "numpy"]
    code = f"import sys, optsc.study; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
