"""What a mesh file names: materials, textures and buffers beside it, where they are ordinary files."""

from pathlib import Path, PurePath

from trimesh.resolvers import FilePathResolver

from qdgrasp_assets.files import A_FOLDER, SPECIAL, amiss


class Beside(FilePathResolver):
    """The files beside a mesh; a pipe that it names is not waited for, and a device not read."""

    def get(self, name: str) -> bytes:
        """What a file holds.

        Raises
        ------
        OSError, ValueError
            It is no ordinary file, not there, or elsewhere.
        """
        plain = name.strip()
        for tried in (plain, plain.lstrip("/"), PurePath(plain).name):
            if (why := amiss(Path(self.parent, tried))) in (A_FOLDER, SPECIAL):
                raise OSError(f"'{name}', which it names, {why}")
        content: bytes = super().get(name)
        return content
