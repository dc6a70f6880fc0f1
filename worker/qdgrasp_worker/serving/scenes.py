"""Scenes between the bus and the simulator: looked for once, and kept until the simulator has them."""

from collections import OrderedDict

from qdgrasp_worker.serving.errands import Errands, Fetched

MOST = 8
"""So many scenes are kept here; the one that came first goes first, and is looked for again if need be."""


class Scenes:
    """Bundles by digest, on their way."""

    def __init__(self, errands: Errands) -> None:
        self._errands = errands
        self._bundles: OrderedDict[str, bytes] = OrderedDict()
        self._sought: set[str] = set()

    def has(self, job: str, digest: str) -> bool:
        """Whether a scene is here; where it is not, it is being looked for now."""
        if digest not in self._bundles and digest not in self._sought:
            self._sought.add(digest)
            self._errands.fetch(job, digest)
        return digest in self._bundles

    def came(self, fetched: Fetched) -> None:
        """Take what came of looking for a scene; what was not found is looked for again when it is needed."""
        self._sought.discard(fetched.scene)
        if isinstance(fetched.bundle, bytes):
            self._bundles[fetched.scene] = fetched.bundle
            if len(self._bundles) > MOST:
                self._bundles.popitem(last=False)

    def take(self, digest: str) -> bytes:
        """A scene that is here, for the simulator."""
        return self._bundles.pop(digest)
