"""Resolver of the files that a mesh file names: materials, textures and buffers beside it.

Only ordinary files are read. Imports trimesh at once, so it is itself imported where it is used.
"""

from pathlib import Path, PurePath

from trimesh.resolvers import FilePathResolver

from qdgrasp_assets.asset_paths import A_FOLDER, SPECIAL, path_problem


class SiblingFileResolver(FilePathResolver):
    """Files that a mesh file refers to; pipes and devices are never opened."""

    def get(self, name: str) -> bytes:
        """Return the content of a file that the mesh names.

        Raises
        ------
        OSError, ValueError
            It is no ordinary file, not there, or elsewhere.
        """
        plain = name.strip()
        for tried in (plain, plain.lstrip("/"), PurePath(plain).name):
            if (why := path_problem(Path(self.parent, tried))) in (A_FOLDER, SPECIAL):
                raise OSError(f"'{name}', which it names, {why}")
        content: bytes = super().get(name)
        return content
