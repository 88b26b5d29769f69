"""Reading, composing and storing URDF files: an arm from one file, a hand from another."""

from __future__ import annotations

import copy
import hashlib
import importlib.util
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

from optsc.cache import cache_directory, write_atomically
from optsc.errors import DamagedFile, UnknownName


def read_urdf(path: str | Path) -> Element:
    """Return the root of a URDF file; raise `DamagedFile` when it is missing or not XML."""
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise DamagedFile(path, f"cannot be read ({error.strerror})") from None
    except ElementTree.ParseError as error:
        raise DamagedFile(path, f"is not XML ({error})") from None
    if root.tag != "robot":
        raise DamagedFile(path, f"is no robot description: its root is <{root.tag}>, not <robot>")
    return root


def package_folder(package: str, *parts: str) -> Path:
    """Return a data folder of an installed package without importing it; raise `UnknownName`."""
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise UnknownName("installed package", package, ())
    return Path(next(iter(found.submodule_search_locations)), *parts)


def example_robot_data(*parts: str) -> Path:
    """Return a path below the ``share`` folder of the example-robot-data wheel, which has no Python module."""
    share = package_folder("cmeel.prefix".partition(".")[0]).parent / "cmeel.prefix" / "share"
    return Path(share, *parts)


def without(root: Element, *tags: str) -> Element:
    """Return a copy without the children of links and joints that carry one of ``tags``."""
    root = copy.deepcopy(root)
    for parent in list(root.iter()):
        for child in [c for c in parent if c.tag in tags]:
            parent.remove(child)
    return root


def _endpoint(joint: Element, which: str) -> str:
    end = joint.find(which)
    return "" if end is None else end.get("link", "")


def subtree(root: Element, link: str) -> list[Element]:
    """Return ``link``, every link below it and the joints between them; raise `UnknownName`."""
    links = {e.get("name", ""): e for e in root.findall("link")}
    if link not in links:
        raise UnknownName("link", link, links)
    members, elements = [link], [links[link]]
    for parent in members:
        for joint in root.findall("joint"):
            child = _endpoint(joint, "child")
            if _endpoint(joint, "parent") == parent and child not in members:
                members.append(child)
                elements += [joint, links[child]]
    return elements


def attach(
    arm: Element,
    flange: str,
    hand: Sequence[Element],
    *,
    xyz: Sequence[float] = (0.0, 0.0, 0.0),
    rpy: Sequence[float] = (0.0, 0.0, 0.0),
) -> Element:
    """Return ``arm`` with the subtree ``hand`` fixed to the link ``flange`` at ``xyz`` [m] and ``rpy`` [rad]."""
    names = [e.get("name", "") for e in arm.findall("link")]
    if flange not in names:
        raise UnknownName("link", flange, names)
    root = copy.deepcopy(arm)
    joint = ElementTree.SubElement(root, "joint", name=f"{flange}_to_{hand[0].get('name')}", type="fixed")
    ElementTree.SubElement(joint, "parent", link=flange)
    ElementTree.SubElement(joint, "child", link=hand[0].get("name", ""))
    ElementTree.SubElement(joint, "origin", xyz=" ".join(map(str, xyz)), rpy=" ".join(map(str, rpy)))
    root.extend(copy.deepcopy(e) for e in hand)
    return root


def store(root: Element, name: str) -> Path:
    """Write a description into the per-user cache under a name that carries its content; return its path."""
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    stem = re.sub(r"[^A-Za-z0-9._-]+", "_", name)
    path = cache_directory("robots") / f"{stem}-{hashlib.sha256(text).hexdigest()[:12]}.urdf"
    if not path.exists():
        write_atomically(path, text)
    return path
