"""Scenes between the bus and the simulator: looked for once, and kept until the simulator has them."""

from qdgrasp_worker.serving.errands import Errands, Fetched


class Scenes:
    """Bundles by digest, on their way."""

    def __init__(self, errands: Errands) -> None:
        self._errands = errands
        self._bundles: dict[str, bytes | None] = {}

    def has(self, job: str, digest: str) -> bool:
        """Whether a scene is here; where it is not, it is being looked for now."""
        if digest not in self._bundles:
            self._bundles[digest] = None
            self._errands.fetch(job, digest)
        return self._bundles[digest] is not None

    def came(self, fetched: Fetched) -> None:
        """Take what came of looking for a scene; what was not found is looked for again when it is needed."""
        if isinstance(fetched.bundle, bytes):
            self._bundles[fetched.scene] = fetched.bundle
        else:
            self._bundles.pop(fetched.scene, None)

    def take(self, digest: str) -> bytes:
        """A scene that is here, for the simulator."""
        bundle = self._bundles.pop(digest)
        if bundle is None:
            raise KeyError(digest)
        return bundle
