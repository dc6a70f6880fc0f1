"""The two bodies of a scene, loaded into Bullet out of a folder that is gone afterwards."""

import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from qdgrasp_assets.scene import SceneGripper, SceneObject
from qdgrasp_protocol.errors import AssetError
from qdgrasp_worker.bullet import Bullet

HAND, OBJECT = 1, 2
"""Collision groups: a hand meets objects only, an object meets hands only."""
OBJECT_URDF = """<robot name="object"><link name="object">
<inertial><mass value="{mass!r}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<collision><origin xyz="1e-9 0 0"/><geometry><mesh filename="parts.obj"/></geometry></collision>
</link></robot>
"""
"""Inertia and contacts as in the public code's runs, where the shape lies off the centre of mass.

Bullet takes the inertia from the collision shape, not from here. The nanometre keeps it from unwrapping
a shape that stands alone at no offset: a bare hull of the rubiks cube has 5 % less inertia, other margins,
and another answer to whether a finger touches it in 6 % of poses.
"""


class Hand:
    """A hand on its carrier, with the indices that Bullet gave to its links and joints.

    Raises
    ------
    AssetError
        Bullet cannot load it, or a joint or link that the scene names is not in the URDF.
    """

    def __init__(self, bullet: Bullet, gripper: SceneGripper) -> None:
        self.body = load(bullet, gripper.urdf, gripper.meshes, fixed=True)
        bullet.collide(self.body, HAND, OBJECT)
        links = bullet.links(self.body)
        moving = {link.joint: index for index, link in enumerate(links) if link.moves}
        self.carrier = pick("carrier joint", (joint.name for joint in gripper.carrier), moving)
        self.fingers = pick("joint", (joint.name for joint in gripper.joints), moving)
        named = {link.link: index for index, link in enumerate(links)}
        self.finger_links = frozenset(pick("finger link", gripper.finger_links, named))
        self.shaped_links = bullet.shaped_links(self.body)
        self.others = sorted(set(moving.values()) - {*self.carrier, *self.fingers})


class Target:
    """An object, with its root link at its centre of mass.

    Raises
    ------
    AssetError
        Bullet cannot load it.
    """

    def __init__(self, bullet: Bullet, target: SceneObject) -> None:
        urdf = OBJECT_URDF.format(mass=target.mass)
        self.body = load(bullet, urdf, {"parts.obj": target.collision}, fixed=False)
        bullet.collide(self.body, OBJECT, HAND)
        self.lateral_friction = target.lateral_friction
        self.frictions = target.rolling_friction, target.spinning_friction
        """Its own coefficients of rolling and spinning friction."""
        self.radius = max(math.hypot(*vertex) for vertex in vertices(target.collision))
        """How far any of it is from its centre of mass [m]."""


def vertices(obj: bytes) -> Iterator[list[float]]:
    """The vertices of an OBJ file."""
    for line in obj.decode().splitlines():
        if line.startswith("v "):
            yield [float(word) for word in line.split()[1:4]]


def load(bullet: Bullet, urdf: str, meshes: Mapping[str, bytes], *, fixed: bool) -> int:
    """Load a URDF with its meshes; its index in Bullet."""
    with tempfile.TemporaryDirectory(prefix="qdgrasp-") as name:
        folder = Path(name).resolve()
        for mesh, content in meshes.items():
            path = (folder / mesh).resolve()
            if folder not in path.parents:
                raise AssetError(f"A scene's meshes lie in its own folder, '{mesh}' does not.")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        file = folder / "body.urdf"
        file.write_text(urdf, encoding="utf-8")
        return bullet.load(file, fixed=fixed)


def pick(kind: str, names: Iterable[str], indices: Mapping[str, int]) -> list[int]:
    """The index of each name."""
    chosen = list(names)
    for name in chosen:
        if name not in indices:
            raise AssetError(f"The hand has no {kind} '{name}'. It has: {', '.join(sorted(indices))}.")
    return [indices[name] for name in chosen]
