"""Keys of policies, costs and functions that are not the library's own: they hang on what the code says."""

import importlib.util
import math
import pickle
import subprocess
import sys

import pytest

from optsc.control.policies import make_policy
from optsc.selection import WeightedSum
from optsc.study.conditions import Condition
from optsc.study.fingerprint import canonical_json, fingerprint, plain

POLICY = """
from dataclasses import dataclass
import math

GAIN = {gain}

def shaped(x):
    {note}return {shape}

@dataclass(frozen=True)
class Eager:
    speed: float = 1.0

    def blend(self, moment):
        return {sign}shaped(self.speed) * GAIN * math.pi
"""
DEFAULTS = {"gain": 2.0, "note": "", "shape": "x * x", "sign": ""}


def loaded(folder, name="own_policies", **changes):
    """Return the module of that name, made anew from text."""
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.py"
    path.write_text(POLICY.format(**{**DEFAULTS, **changes}))
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(autouse=True)
def _forgotten():
    yield
    for name in ("own_policies", "other_policies"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("change", [{"sign": "-"}, {"shape": "x + x"}, {"gain": 2.5}, {"gain": "(2.0, [1])"}], ids=str)
def test_policies_of_one_name_differ_in_their_keys_by_what_their_code_says_and_names(tmp_path, change):
    one = fingerprint(loaded(tmp_path / "a").Eager())
    assert fingerprint(loaded(tmp_path / "b", **change).Eager()) != one


def test_the_same_code_has_the_same_key_wherever_it_lies_and_however_often_it_is_loaded(tmp_path):
    one = loaded(tmp_path / "a").Eager()
    again = loaded(tmp_path / "b").Eager()
    assert type(one) is not type(again)
    assert fingerprint(one) == fingerprint(again) == fingerprint(one)
    assert str(tmp_path) not in canonical_json(one)
    assert fingerprint(loaded(tmp_path / "c", name="other_policies").Eager()) != fingerprint(one)


def test_an_edited_policy_has_another_key_in_the_process_that_loads_it_again(tmp_path):
    before = fingerprint(loaded(tmp_path).Eager())
    assert fingerprint(loaded(tmp_path, sign="-  ").Eager()) != before
    assert fingerprint(loaded(tmp_path).Eager()) == before


def test_a_file_that_was_edited_after_it_was_loaded_does_not_speak_for_what_runs(tmp_path):
    module = loaded(tmp_path)
    (tmp_path / "own_policies.py").write_text(POLICY.format(**{**DEFAULTS, "sign": "-"}))
    unloaded = fingerprint(module.Eager())
    assert unloaded != fingerprint(loaded(tmp_path, sign="-").Eager())


def test_the_key_of_own_code_is_the_same_in_another_process(tmp_path):
    mine = fingerprint(loaded(tmp_path).Eager())
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\nimport own_policies\n"
    code += "from optsc.study.fingerprint import fingerprint; print(fingerprint(own_policies.Eager()))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == mine


SCRIPT = """
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from optsc.study.fingerprint import fingerprint
GAIN = 3.0
@dataclass(frozen=True)
class Mine:
    def blend(self, moment):
        return GAIN
def found(_):
    return fingerprint(Mine())
if __name__ == "__main__":
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        print(found(0), *pool.map(found, [0]))
"""


def test_a_policy_of_the_script_that_runs_has_the_same_key_in_its_worker_processes(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=True)
    mine, worker_s = done.stdout.split()
    assert mine == worker_s


TYPED = """
from dataclasses import dataclass
@dataclass(frozen=True)
class Typed:
    gain: float = 1.0
    unit = "m"
    def blend(self, x):
        return {body}
"""


def typed(body):
    space = {"__name__": "__main__"}
    exec(TYPED.format(body=body), space)
    return space["Typed"]()


def test_without_a_source_the_compiled_code_counts():
    one = fingerprint(typed("x * self.gain"))
    assert fingerprint(typed("x * self.gain")) == one
    assert len({one, fingerprint(typed("x + self.gain")), fingerprint(typed("2.0 * self.gain"))}) == 3


def test_what_a_function_closes_over_is_part_of_it():
    def made(gain):
        return lambda x: gain * x

    assert fingerprint(made(1.0)) == fingerprint(made(1.0)) != fingerprint(made(2.0))
    first, second = (lambda x: x + 1), (lambda x: x + 2)
    assert fingerprint(first) != fingerprint(second)


def test_the_source_counts_where_there_is_one_so_that_keys_do_not_hang_on_the_compiler(tmp_path):
    module = loaded(tmp_path)
    before = fingerprint(module.Eager())
    again = loaded(tmp_path / "b", note="# A remark, which the compiler never sees.\n    ")
    assert fingerprint(again.Eager()) != before


def test_the_library_s_own_classes_and_functions_go_in_by_name_alone():
    assert plain(make_policy("manual"))["type"] == "Manual"
    assert "own code" not in canonical_json([make_policy(name) for name in ("manual", "automatic")])
    assert plain([math.sin, fingerprint]) == [
        {"named": "math.sin"},
        {"named": "optsc.study.fingerprint.fingerprint"},
    ]


def test_a_cost_that_was_edited_is_another_condition(tmp_path):
    text = "from dataclasses import dataclass\nfrom optsc.selection import GraspCost\n"
    text += "@dataclass(frozen=True)\nclass Charm(GraspCost):\n    name = 'charm'\n    unit = '-'\n"
    text += "    def values(self, situation):\n        return {sign}situation.similarity\n"
    found = []
    for sign in ("-", "", "-"):
        (tmp_path / "own_policies.py").write_text(text.format(sign=sign))
        spec = importlib.util.spec_from_file_location("own_policies", tmp_path / "own_policies.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules["own_policies"] = module
        spec.loader.exec_module(module)
        found.append(Condition("charm", WeightedSum(((module.Charm(), 1.0),))))
        assert found[-1].key
    assert found[0].key == found[2].key != found[1].key
    # It takes its key along to a process that may not have the source.
    sent = pickle.dumps(found[2])
    module.Charm.values = lambda self, situation: 0.0
    assert pickle.loads(sent).key == found[2].key
