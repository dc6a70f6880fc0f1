"""Layers of an image: solid ones hide what is behind them, translucent ones let it through."""

from dataclasses import dataclass, field

import numpy as np

from qdgrasp_coordinator.analysis.rays import FAR, Camera, Floats, Hits, Places

FINE = 2
"""Rays for each pixel of the final image, along each side."""


@dataclass
class Image:
    """What has been seen so far at each point of a camera's image."""

    camera: Camera
    colour: Floats = field(init=False)
    """(n, 3), white where nothing is."""
    depth: Floats = field(init=False)
    """(n,) [m]: of the solid things."""
    veils: list[tuple[Places, Floats, Floats]] = field(default_factory=list)
    """Translucent layers: pixels (m,), depth (m,), colour and opacity (m, 4)."""

    def __post_init__(self) -> None:
        points = self.camera.rows * self.camera.columns
        self.colour = np.ones((points, 3), dtype=np.float32)
        self.depth = np.full(points, 2 * FAR, dtype=np.float32)

    def add_solid(self, hits: Hits, colour: Floats) -> None:
        """Paint the hits (m,) that nothing solid hides in a colour (m, 3)."""
        free = hits.depth < self.depth[hits.pixels]
        seen = hits.pixels[free]
        self.colour[seen], self.depth[seen] = colour[free], hits.depth[free]

    def add_veil(self, hits: Hits, colour: Floats, opacity: Floats) -> None:
        """Lay a translucent layer of colour (m, 3) and opacity (m,) over what is behind it."""
        self.veils.append((hits.pixels, hits.depth, np.column_stack([colour, opacity]).astype(np.float32)))

    def finished(self) -> Floats:
        """The image (rows / FINE, columns / FINE, 3) in [0, 1], its layers laid from back to front."""
        colour = self.colour.copy()
        for pixels, paint in self._from_back_to_front():
            opacity = paint[:, 3:]
            colour[pixels] = colour[pixels] * (1 - opacity) + paint[:, :3] * opacity
        fine = colour.reshape(self.camera.rows // FINE, FINE, self.camera.columns // FINE, FINE, 3)
        averaged: Floats = np.clip(fine.mean(axis=(1, 3)), 0, 1)
        return averaged

    def _from_back_to_front(self) -> list[tuple[Places, Floats]]:
        """The visible veils, so that no pixel occurs twice in a step."""
        if not self.veils:
            return []
        pixels, depth, paint = (np.concatenate(parts) for parts in zip(*self.veils, strict=True))
        seen = np.flatnonzero(depth < self.depth[pixels])
        order = seen[np.lexsort((-depth[seen], pixels[seen]))]
        pixels, paint = pixels[order], paint[order]
        start = np.flatnonzero(np.r_[True, pixels[1:] != pixels[:-1]])
        turn = np.arange(len(pixels)) - np.repeat(start, np.diff(np.r_[start, len(pixels)]))
        return [(pixels[turn == k], paint[turn == k]) for k in range(int(turn.max(initial=-1)) + 1)]
