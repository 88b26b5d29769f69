"""Arm descriptions as they come: URDF files of others, brought into the form that the whole library reads.

What comes out has absolute mesh paths, no soft limits, locked joints as fixed ones, and base and tool where the user
said. So kinematics, collision model, simulator and pictures read one file, and none of them has to know of the rest.
"""

from __future__ import annotations

import copy
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio

from optsc.errors import DamagedFile, InvalidValue, UnknownName
from optsc.geometry import Pose, rotation
from optsc.geometry.rotation import Array
from optsc.robot.urdf import read_urdf, without

Packages = Mapping[str, str | Path] | Sequence[str | Path]
"""Where packages are: folders by the package's name, or folders that packages lie in."""
TURNING = ("revolute", "continuous")
MOVING = (*TURNING, "prismatic")
_FURTHEST = 6
"""How many folders above a description are searched for its meshes."""


class MissingMesh(NamedTuple):
    """A mesh that was not found: its name in the file, its link, ``visual`` or ``collision``, and where was looked."""

    name: str
    link: str
    kind: str
    searched: tuple[Path, ...]

    def __str__(self) -> str:
        places = ", ".join(map(str, self.searched[:4])) + (" ..." if len(self.searched) > 4 else "")
        return f"the {self.kind} mesh {self.name} of link {self.link} was not found; looked at {places}"


class Description(NamedTuple):
    """A description with its meshes found: the root of its XML, and the meshes that were not."""

    root: Element
    missing: tuple[MissingMesh, ...]


class MeshFinder:
    """Finds the files that mesh names mean.

    A name may be relative to the file, absolute, or begin with ``file://``, ``package://`` or ``model://``. A package
    is looked for in ``packages``, in the folders above the file (by folder name, or by the name in a ``package.xml``),
    and in the folders of the environment variable ``ROS_PACKAGE_PATH``.

    Args:
        folder: of the description.
        packages: where the user says that packages are.

    Raises:
        InvalidValue: a folder in ``packages`` does not exist.
    """

    def __init__(self, folder: Path, packages: Packages = ()) -> None:
        self._folder = folder.resolve()
        named = packages if isinstance(packages, Mapping) else {}
        given = () if isinstance(packages, Mapping) else packages
        self._named = {name: _folder(path) for name, path in named.items()}
        above = (self._folder, *self._folder.parents)[: _FURTHEST + 1]
        environment = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
        self._roots = (*map(_folder, given), *above, *environment)

    def find(self, name: str) -> tuple[Path | None, tuple[Path, ...]]:
        """Return the file that a mesh name means, None where there is none, and where was looked."""
        searched = []
        for path in self._candidates(name):
            if path.is_file():
                return path, ()
            searched.append(path)
        return None, tuple(dict.fromkeys(searched))

    def _candidates(self, name: str) -> Iterator[Path]:
        scheme, _, rest = name.rpartition("://")
        if scheme in ("package", "model"):
            package, _, inside = rest.partition("/")
            if package in self._named:
                yield self._named[package] / inside
            for root in self._roots:
                yield root / package / inside
                yield root / "share" / package / inside
                if root.name == package or _package_name(root) == package:
                    yield root / inside
        else:
            # Some descriptions name meshes relative to a folder above, the root of their package.
            yield self._folder / rest
            if not Path(rest).is_absolute():
                for root in self._roots:
                    yield root / rest


def _folder(path: str | Path) -> Path:
    if not Path(path).is_dir():
        raise InvalidValue("packages", str(path), "folders that exist")
    return Path(path).resolve()


def _package_name(folder: Path) -> str | None:
    try:
        return ElementTree.parse(folder / "package.xml").getroot().findtext("name")
    except (OSError, ElementTree.ParseError):
        return None


def read_description(path: str | Path, packages: Packages = ()) -> Description:
    """Return a description with absolute mesh paths and without soft limits.

    Visual meshes that are not found are left out, as nothing but pictures needs them; collision meshes keep their name
    for whoever needs them to say so. Both are listed in the answer.

    Raises:
        DamagedFile: the file is missing, not XML, a xacro template, or in another format than URDF.
        InvalidValue: a folder in ``packages`` does not exist.
    """
    path = Path(path)
    _refuse_other_formats(path)
    root = without(read_urdf(path), "safety_controller")
    finder = MeshFinder(path.parent, packages)
    missing: list[MissingMesh] = []
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                lost = _resolved(shape, link.get("name", ""), kind, finder)
                missing += lost
                if lost and kind == "visual":
                    link.remove(shape)
    return Description(root, tuple(missing))


def _resolved(shape: Element, link: str, kind: str, finder: MeshFinder) -> list[MissingMesh]:
    """Make the mesh names of a shape absolute; return those that were not found."""
    lost = []
    for mesh in shape.iter("mesh"):
        name = mesh.get("filename", "")
        found, searched = finder.find(name)
        if found is None:
            lost.append(MissingMesh(name, link, kind, searched))
        else:
            mesh.set("filename", str(found.resolve()))
    return lost


def _refuse_other_formats(path: Path) -> None:
    try:
        text = re.sub(r"<!--.*?-->", "", path.read_text("utf-8", "replace"), flags=re.DOTALL)
    except OSError:
        return  # its reader says what is wrong
    # An expanded template still declares the namespace, so only its elements tell.
    if "<xacro:" in text:
        advice = f"is a xacro template: expand it first, `xacro {path.name} > expanded.urdf`"
        raise DamagedFile(path, advice)
    for tag, name in (("<mujoco", "MuJoCo (MJCF)"), ("<sdf", "SDF"), ("<COLLADA", "COLLADA"), ("#usda", "USD")):
        # MuJoCo reads settings of its own in URDF files, so the root has to be something else.
        if tag in text and "<robot" not in text:
            raise DamagedFile(path, f"is a {name} file, not a URDF; convert it to URDF first")


def with_locked(root: Element, locked: Mapping[str, float]) -> Element:
    """Return a copy whose joints ``locked`` stand fixed at values [rad or m]; raise `UnknownName`, `InvalidValue`."""
    root = copy.deepcopy(root)
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    for name, value in locked.items():
        if name not in joints or joints[name].get("type") not in MOVING:
            moving = [n for n, joint in joints.items() if joint.get("type") in MOVING]
            raise UnknownName("joint to lock", name, moving)
        if not np.isfinite(value):
            raise InvalidValue(f"locked[{name!r}]", value, "finite")
        joint = joints[name]
        step = axis_of(joint) * float(value)
        moved = np.eye(4)
        if joint.get("type") in TURNING:
            moved[:3, :3] = rotation.to_matrix(rotation.exp(step))
        else:
            moved[:3, 3] = step
        _set_origin(joint, origin_of(joint) @ moved)
        joint.set("type", "fixed")
        for tag in ("axis", "limit", "dynamics", "mimic", "calibration"):
            for child in joint.findall(tag):
                joint.remove(child)
    return root


def with_base(root: Element, base: Pose) -> Element:
    """Return a copy whose old root link stands at ``base`` (X_WB) on a new root link that is the world frame W."""
    root = copy.deepcopy(root)
    _fix(root, _free_name(root, "world"), root_link(root), base.matrix(), below=False)
    return root


def with_tool(root: Element, tip: str, tool: Pose) -> tuple[Element, str]:
    """Return a copy with a new frame at ``tool`` (X_FT) from link ``tip``, and its name; raise `UnknownName`."""
    root = copy.deepcopy(root)
    links = [link.get("name", "") for link in root.findall("link")]
    if tip not in links:
        raise UnknownName("link", tip, links)
    name = _free_name(root, f"{tip}_tool")
    _fix(root, name, tip, tool.matrix(), below=True)
    return root, name


def root_link(root: Element) -> str:
    """Return the name of the link that no joint moves; raise `InvalidValue` unless there is just one."""
    children = {child.get("link") for joint in root.findall("joint") for child in joint.findall("child")}
    roots = [name for link in root.findall("link") if (name := link.get("name", "")) not in children]
    if len(roots) != 1:
        raise InvalidValue("root links of the description", roots, "exactly one")
    return roots[0]


def axis_of(joint: Element) -> Array:
    """Return the unit axis (3,) of a moving joint in its own frame; raise `InvalidValue` where it has none."""
    element = joint.find("axis")
    text = "1 0 0" if element is None else element.get("xyz", "1 0 0")
    axis = _numbers(text, 3, f"axis of joint {joint.get('name')}")
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise InvalidValue(f"axis of joint {joint.get('name')}", text, "a direction: not all zero")
    return axis / length


def origin_of(element: Element) -> Array:
    """Return the pose (4, 4) that an element's ``<origin>`` gives; raise `InvalidValue`."""
    origin, X = element.find("origin"), np.eye(4)
    if origin is not None:
        where = f"origin of {element.tag} {element.get('name', '')}".rstrip()
        X[:3, 3] = _numbers(origin.get("xyz", "0 0 0"), 3, where)
        X[:3, :3] = pinocchio.rpy.rpyToMatrix(_numbers(origin.get("rpy", "0 0 0"), 3, where))
    return X


def _set_origin(element: Element, X: Array) -> None:
    for old in element.findall("origin"):
        element.remove(old)
    # The decimals of a double, so that a description that is written and read again is the same.
    xyz, rpy = X[:3, 3].tolist(), pinocchio.rpy.matrixToRpy(X[:3, :3]).tolist()
    ElementTree.SubElement(element, "origin", xyz=" ".join(map(repr, xyz)), rpy=" ".join(map(repr, rpy)))


def _fix(root: Element, new: str, link: str, X: Array, *, below: bool) -> None:
    """Add the link ``new``, fixed to ``link``: below it at X, or above it so that ``link`` is at X."""
    ElementTree.SubElement(root, "link", name=new)
    joint = ElementTree.SubElement(root, "joint", name=_free_name(root, f"{new}_joint"), type="fixed")
    ElementTree.SubElement(joint, "parent", link=link if below else new)
    ElementTree.SubElement(joint, "child", link=new if below else link)
    _set_origin(joint, X)


def _free_name(root: Element, wanted: str) -> str:
    taken = {element.get("name") for element in (*root.findall("link"), *root.findall("joint"))}
    name, k = wanted, 2
    while name in taken:
        name, k = f"{wanted}_{k}", k + 1
    return name


def _numbers(text: str, count: int, field: str) -> Array:
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.array([])
    if len(values) != count or not np.all(np.isfinite(values)):
        raise InvalidValue(field, text, f"{count} finite numbers")
    return values


def chain_to(root: Element, tip: str) -> list[Element]:
    """Return the joints from the root link to a link or joint ``tip``, outermost last; empty for the root itself."""
    above = {child.get("link"): joint for joint in root.findall("joint") for child in joint.findall("child")}
    chain: list[Element] = []
    named = {joint.get("name"): joint for joint in root.findall("joint")}
    links = {link.get("name") for link in root.findall("link")}
    joint = above.get(tip) if tip in links else named.get(tip)
    while joint is not None and joint not in chain:
        chain.append(joint)
        parent = joint.find("parent")
        joint = None if parent is None else above.get(parent.get("link"))
    return chain[::-1]


def check_chain(chain: Sequence[Element], given: Sequence[str] = ()) -> None:
    """Raise `InvalidValue` for joints that an arm cannot have, saying what to do.

    Args:
        chain: the joints between root and tool, see `chain_to`.
        given: which limits the caller gives, so that the file's do not matter.
    """
    for joint in chain:
        name, kind = f"joint {joint.get('name')}", joint.get("type")
        if kind == "fixed":
            continue
        if kind not in MOVING:
            raise InvalidValue(f"type of {name}", kind, "revolute, continuous or prismatic; or lock it by locked=")
        mimic = joint.find("mimic")
        if mimic is not None:
            valid = "an arm whose joints move independently; lock this one by locked="
            raise InvalidValue(f"{name} of the arm", f"<mimic joint={mimic.get('joint')!r}>", valid)
        axis_of(joint)
        limit = joint.find("limit")
        for attribute, needed in (("velocity", "velocity"), ("lower", "lower"), ("upper", "upper")):
            if needed in given or (attribute != "velocity" and kind == "continuous"):
                continue
            text = None if limit is None else limit.get(attribute, "0" if attribute != "velocity" else None)
            value = None if text is None else _numbers(text, 1, f"{attribute} limit of {name}")[0]
            if value is None or (attribute == "velocity" and value <= 0.0):
                what = "none" if value is None else value
                unit = "m/s" if kind == "prismatic" else "rad/s"
                valid = f"above 0 {unit} in the file, or limits={{'velocity': [...]}}"
                if attribute != "velocity":
                    valid = f"in the file, or limits={{'{attribute}': [...]}}"
                raise InvalidValue(f"{attribute} limit of {name}", what, valid)
