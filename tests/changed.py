"""Scenes that differ from others in their hand."""

from typing import Any

from msgspec.structs import replace

from qdgrasp_assets.scene import Scene


def with_gripper(scene: Scene, **changes: Any) -> Scene:
    """A scene whose gripper has other values."""
    return replace(scene, gripper=replace(scene.gripper, **changes))
