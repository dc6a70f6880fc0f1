"""The own shape of recorded rows: that of their run, whatever they were merged with."""

from qdgrasp_assets.scene import Scene
from qdgrasp_coordinator.folders.folder import RunFolder
from qdgrasp_coordinator.folders.provenance import Provenance
from qdgrasp_coordinator.keeping.reduction import trimmed
from qdgrasp_coordinator.runs.preparation import scene_shape
from qdgrasp_coordinator.searches.search import method
from qdgrasp_protocol.errors import FolderError
from qdgrasp_protocol.rows import Rows


def own_shape(rows: Rows, folder: RunFolder, found_by: Provenance, scene: Scene) -> Rows:
    """Rows of a folder in the shape that a worker evaluates them in.

    Raises
    ------
    FolderError
        They are of a version with other genes.
    """
    prior = method(found_by.spec.method).prior
    shape, genes = scene_shape(scene, prior), rows.dtype["genome"].shape[0]
    if genes < shape.genes:
        raise FolderError(
            f"{folder.path} has rows of {genes} genes where this version of qdgrasp has {shape.genes} for "
            f"the prior '{prior}': use the version that recorded them."
        )
    return trimmed(rows, shape)
