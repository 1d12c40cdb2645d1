"""Verifies a budget: renders the scene with replaced materials, and compares it with the reference without noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from manifold.core.records import Array
from manifold.render import backend, images, render
from manifold.study.budget.scene_document import SceneDocument
from manifold.study.budget.scene_survey import Survey
from manifold.study.budget.search import Choice, Difference


class Pictures:
    """Renderings of a scene with replaced materials, which are compared with the reference."""

    def __init__(
        self, document: SceneDocument, files: Mapping[str, Path], survey: Survey, samples: int, seed: int
    ) -> None:
        self._document, self._survey = document, survey
        self._bsdfs = {k: {"type": "measured", "filename": str(path.absolute())} for k, path in files.items()}
        self._samples, self._seed, self._film = samples, seed, survey.film()
        self._reference = self._render({}, seed)

    def _render(self, choice: Choice, seed: int) -> list[Array]:
        """Display values of the whole render, and of its two halves, which share no light path."""
        mi = backend.mitsuba("rgb" if self._survey.bands.is_rgb else "spectral")
        bsdfs = dict(self._bsdfs) | {key: dict(candidate.bsdf) for key, candidate in choice.items()}
        scene = self._document.load(mi, bsdfs, self._film)
        half = (self._samples + 1) // 2
        halves = [
            render.render_scene(mi, scene, render.RenderSettings(max(self._survey.size), half, 2 * seed + k))
            for k in range(2)
        ]
        pictures = [np.mean(halves, axis=0), *halves]
        return [self._survey.display(picture[..., :3]) for picture in pictures]

    def _compare(self, other: list[Array]) -> dict[str, Difference]:
        maps = [images.ciede2000_map(a, b) for a, b in zip(self._reference, other, strict=True)]
        flip = images.flip_map(self._reference[0], other[0])
        found = {}
        for key, lighting in self._survey.lighting.items():
            whole, *halves = (float(one[lighting.mask].mean()) for one in maps)
            found[key] = Difference(without_noise(whole, halves), whole, float(flip[lighting.mask].mean()))
        return found

    def differences(self, choice: Choice) -> dict[str, Difference]:
        """Return the differences of a choice from the reference, with the same seed."""
        return self._compare(self._render(choice, self._seed))

    def beside(self, choice: Choice) -> tuple[Array, Array]:
        """Return pictures for display (H, W, 3): of the reference, and of a choice with the same seed."""
        return self._reference[0], self._render(choice, self._seed)[0]

    def noise(self) -> dict[str, Difference]:
        """Return the differences of the reference from itself with another seed."""
        return self._compare(self._render({}, self._seed + 1))


def without_noise(whole: float, halves: Sequence[float]) -> float:
    """Return the mean difference between renders without the contribution of noise.

    The inputs are the difference with all light paths, and the differences with each half of them. Noise adds a
    term to the squared difference that is inversely proportional to the number of paths: the excess of the halves
    over the whole equals the term in the whole.
    """
    return float(np.sqrt(max(2.0 * whole**2 - float(np.mean(np.square(halves))), 0.0)))
