"""Who may import whom, and which third-party library stays behind which door."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import optsc

ROOT = Path(optsc.__file__).parent

LEVELS = (
    ("errors", "cache", "processes", "real_time"),
    ("checks",),
    ("geometry",),
    ("kernels",),
    ("robot",),
    ("grasps",),
    ("ik", "shaping", "operators", "followers"),
    ("selection",),
    ("control",),
    ("records",),
    ("metrics",),
    ("display",),
    ("session",),
    ("testing",),
    ("collision",),
    ("sim", "people", "sampling"),
    ("perception",),
    ("viewers",),
    ("study",),
    ("demo", "live"),
    ("cli",),
)
LEVEL = {room: i for i, rooms in enumerate(LEVELS) for room in rooms}
FENCES = {
    "pinocchio": {"robot", "collision"},
    "coal": {"collision"},
    "casadi": {"kernels", "collision"},
    "qpsolvers": {"ik"},
    "proxsuite": {"ik"},
    "daqp": {"ik"},
    "ruckig": {"shaping"},
    "pybullet": {"sim"},
    "matplotlib": {"viewers", "study"},
    "mpl_toolkits": {"viewers", "study"},
    "small_gicp": {"perception"},
    "open3d": {"perception"},
    "PIL": {"perception"},
    "h5py": {"sampling"},
    "pandas": {"study"},
    "pyarrow": {"study", "live"},
    "distributed": {"study"},
    "optuna": {"study"},
    "websockets": {"live"},
    "cryptography": {"live"},
}


def imports_of(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert all(alias.name != "*" for alias in node.names), f"{path}: wildcard import"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def sources():
    for path in sorted(ROOT.rglob("*.py")):
        room = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if room not in ("__init__", "__main__"):
            yield room, path


@pytest.mark.parametrize("room", LEVEL)
def test_imports_only_run_downwards(room):
    for where, path in sources():
        if where != room:
            continue
        for name in imports_of(path):
            parts = name.split(".")
            if parts[0] != "optsc" or len(parts) < 2 or parts[1] not in LEVEL or parts[1] == room:
                continue
            other = parts[1]
            assert LEVEL[other] <= LEVEL[room], f"{path} imports {name}, which is above it"
            assert LEVEL[other] < LEVEL[room], f"{path} imports its sibling {name}"


def test_every_room_has_a_level():
    assert {room for room, _ in sources()} <= set(LEVEL)


@pytest.mark.parametrize("library", FENCES)
def test_a_third_party_library_stays_behind_its_fence(library):
    for room, path in sources():
        names = {name.split(".")[0] for name in imports_of(path)}
        assert library not in names or room in FENCES[library], f"{path} imports {library}"


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_importing_the_library_loads_no_heavy_module():
    heavy = sorted({*FENCES, "trimesh", "manifold3d", "scipy"})
    assert run(f"import sys, optsc; print([m for m in {heavy!r} if m in sys.modules])").strip() == "[]"


def test_the_controller_runs_without_pybullet():
    code = (
        "import sys; sys.modules['pybullet'] = None; sys.modules['matplotlib'] = None\n"
        "import optsc\n"
        "robot = optsc.load_robot('panda')\n"
        "controller = optsc.SharedController(robot, optsc.GraspSelector(robot))\n"
        "state = optsc.IdealFollower(robot).reset(robot.home)\n"
        "print(controller.step(None, state).mode.name)"
    )
    assert run(code).strip() == "HOLD"


def test_every_public_name_is_there_and_they_are_sorted():
    assert list(optsc.__all__) == sorted(optsc.__all__)
    assert len(set(optsc.__all__) - set(LEVEL)) <= 40
    for name in optsc.__all__:
        assert getattr(optsc, name) is not None


def test_every_room_can_be_reached_from_the_library_alone():
    rooms = sorted({room for room in LEVEL if room not in ("cli", "cache", "processes")})
    code = f"import optsc; print(all(getattr(optsc, r).__name__ == 'optsc.' + r for r in {rooms!r}))"
    assert run(code).strip() == "True"
    assert {"grasps", "sim", "study"} <= set(optsc.__all__) <= set(dir(optsc))


def test_an_unknown_public_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        optsc.no_such_name  # noqa: B018


def test_no_module_is_longer_than_a_person_reads_in_one_go():
    lengths = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for _, path in sources()}
    assert {path: n for path, n in lengths.items() if n > 400} == {}


@pytest.mark.parametrize("stub", sorted(ROOT.rglob("__init__.pyi")), ids=lambda stub: stub.parent.name)
def test_no_public_name_hides_a_module(stub):
    names = {
        alias.name
        for node in ast.walk(ast.parse(stub.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
    assert names & {path.stem for path in stub.parent.glob("*.py")} == set()


def test_a_class_name_means_one_thing():
    where = {}
    for _, path in sources():
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef):
                where.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in where.items() if len(paths) > 1} == {}
