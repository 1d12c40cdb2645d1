"""Embedding of measured files that are not in the library."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured import fill_unmeasured, unmeasured_cells, unmeasured_share
from manifold.colour import ball_colours
from manifold.io_rgl import read_bsdf
from manifold.metrics import cube_root_error
from manifold.model import diagnostics
from manifold.model.decoding import encoding_pairs
from manifold.model.manifold import Manifold
from manifold.records import Progress


@dataclass(frozen=True)
class Located:
    """Where a file belongs on a manifold.

    Attributes:
        path: the file.
        latent: shape (Q,).
        coordinates: the same, in digits that give the prediction there back.
        colours: colour coordinate of every band (B,), of a blend also its gain (2, B); None where latents carry them.
        relative_error: of the reconstruction there, linear.
        cube_root_error: of its cube roots.
        ball: mean CIEDE2000 of its ball.
        expected_ball: what is to be expected of the ball there; None where the model is not calibrated.
        expected_cube_root: the same of cube roots.
        nearest: the three nearest materials with their distances.
        diagnostics: defects found, as sentences.
    """

    path: Path
    latent: tuple[float, ...]
    coordinates: tuple[str, ...]
    colours: list[Any] | None
    relative_error: float
    cube_root_error: float
    ball: float
    expected_ball: float | None
    expected_cube_root: float | None
    nearest: tuple[tuple[str, float], ...]
    diagnostics: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return vars(self) | {"path": str(self.path)}


def locate(
    model: Path, path: Path, *, library: Path | None = None, on_progress: Progress | None = None
) -> Located:
    """Embed a measured file, with its unmeasured cells filled, in a fitted manifold.

    Raises:
        FileFormatError: it is no RGL file.
        BandMismatchError: its bands are not the library's.
    """
    file = read_bsdf(path)
    cells = unmeasured_cells(file)
    brdf = MeasuredBRDF(fill_unmeasured(file, cells))
    loaded = Manifold.load(model, library)
    loaded.prepare(on_progress)
    found = loaded.embed(brdf)
    predicted, expected = (
        loaded.predict(found.latent, found.colours),
        loaded.expected_error(found.latent, found.colours),
    )
    pairs, ball = encoding_pairs(), ball_colours.ball()
    f, f_star = (each.eval(pairs.wi, pairs.wo) for each in (brdf, predicted))
    difference = ball.difference(brdf.eval(ball.wi, ball.wo), predicted.eval(ball.wi, ball.wo), loaded.bands)
    return Located(
        path=path,
        latent=tuple(float(v) for v in found.latent),
        coordinates=loaded.space.printed(found.latent),
        colours=None if found.colours is None else found.colours.tolist(),
        relative_error=found.relative_error,
        cube_root_error=cube_root_error(f, f_star, pairs.cosines),
        ball=difference,
        expected_ball=None if expected is None else float(expected.ball),
        expected_cube_root=None if expected is None else float(expected.cube_root),
        nearest=tuple(loaded.nearest(found.latent, 3)),
        diagnostics=diagnostics.of_embedding(found.relative_error, difference)
        + diagnostics.of_unmeasured(unmeasured_share(file, cells))
        + loaded.notes,
    )
