"""Describes measured files by a manifold or by the materials of a library, and measures the errors."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.orientation import rotation_of
from manifold.brdf.plausibility import Plausibility
from manifold.brdf.unmeasured_cells import fill_unmeasured, unmeasured_cells, unmeasured_share
from manifold.core.errors import UsageError
from manifold.core.metrics import ERROR_COLUMNS, Errors
from manifold.core.records import Array, BsdfFile, evenly_spaced
from manifold.core.results import Result, derived, entry
from manifold.library.store import Library
from manifold.model import diagnostics
from manifold.model.comparison import brdf_errors
from manifold.model.manifold import Manifold
from manifold.model.materials import MaterialCache, names_without
from manifold.model.prediction import PredictedBRDF
from manifold.model.reconstruction import reconstruct
from manifold.model.settings import SAMPLE_BANDS

_SHOWN_PARTS = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction(Result):
    """A measured material expressed by other materials.

    Attributes:
        materials: number of materials that were available for the description.
        errors: errors of the description.
        plausibility: physical plausibility of the output file, written or refused; None if no file was requested.
        diagnostics: defects found, as sentences.
        refusal: reason why the file was not written; None if it was.
        rotation_rad: azimuth by which an anisotropic specimen was turned relative to the materials, found by trial;
            the description is turned by the same angle.
    """

    brdf: PredictedBRDF
    materials: int = field(metadata=entry())

    @property
    @derived()
    def parts(self) -> list[tuple[str, float]]:
        """Return the materials and analytic lobes with the largest shares of the weights."""
        return self.brdf.parts[:_SHOWN_PARTS]

    errors: Errors[float] = field(
        metadata=entry(
            row="reconstruction error", words=lambda result: result.errors.words, columns=ERROR_COLUMNS
        )
    )

    @property
    @derived(
        row="rotation of the sample",
        words=lambda result: (
            f"{result.rotation_deg:.1f} degrees, undone to find it" if result.rotation_rad else None
        ),
    )
    def rotation_deg(self) -> float:
        """Return the azimuth by which the specimen was turned, in degrees."""
        return float(np.rad2deg(self.rotation_rad))

    plausibility: Plausibility | None = field(
        default=None, metadata=entry(row="largest albedo", words="{.max_albedo:.3f}")
    )
    diagnostics: tuple[str, ...] = field(metadata=entry(row="diagnostics"))
    refusal: str | None = field(default=None, metadata=entry())
    rotation_rad: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Located(Reconstruction):
    """A measured material located on a manifold, and the prediction there in the colours found.

    Attributes: those of `Reconstruction`, and
        latent: latent of the material, shape (Q,).
        coordinates: the latent as text, with the digits that reproduce the prediction.
        colours: colour coordinate of every band (B,), for blends also its gain (2, B); None if latents determine the
            colours.
        expected: expected error; None if the model is not calibrated.
        nearest: the three nearest materials with their distances.
    """

    latent: Array = field(metadata=entry())
    coordinates: tuple[str, ...] = field(metadata=entry())
    colours: Array | None = field(metadata=entry())
    expected: Errors[Array] | None = field(metadata=entry())
    nearest: list[tuple[str, float]] = field(metadata=entry(columns={"nearest": (0, 0)}))


def locate(model: Manifold, file: BsdfFile) -> Located:
    """Locate a measured file, with its unmeasured cells filled, on a fitted manifold.

    Raises:
        BandMismatchError: the file has other bands than the library.
    """
    return locate_brdf(model, *_filled(file), trial_rotations(file))


def locate_brdf(
    model: Manifold, brdf: BRDF, notes: tuple[str, ...] = (), rotations_rad: Sequence[float] = (0.0,)
) -> Located:
    """Locate any BRDF on a fitted manifold; `notes` are added to the diagnostics.

    The BRDF is tried at each of the azimuths `rotations_rad`, and the best is kept.
    """
    trials = [0.0] if model.materials.is_isotropic else rotations_rad
    rotation, embedding = min(
        ((angle, model.embed(_turned(brdf, -angle))) for angle in trials), key=lambda trial: trial[1].residual
    )
    predicted = model.predict(embedding.latent, embedding.colours).turned(rotation)
    errors = brdf_errors(brdf, predicted)
    return Located(
        brdf=predicted,
        materials=len(model.names),
        errors=errors,
        diagnostics=(
            *diagnostics.of_embedding(errors),
            *notes,
            *_of_anisotropy(brdf, predicted),
            *model.notes,
        ),
        latent=embedding.latent,
        coordinates=model.space.printed(embedding.latent),
        colours=embedding.colours,
        expected=model.expected_error(embedding.latent, embedding.colours, embedding.residual),
        nearest=model.nearest(embedding.latent, 3),
        rotation_rad=rotation,
    )


def reconstruct_file(
    library: Library,
    file: BsdfFile,
    without: Collection[str] = (),
    *,
    numbers: int | None = None,
) -> Reconstruction:
    """Describe a measured file by non-negative least squares over the other materials of a library.

    `numbers` limits the number of parameters of the description, see `reconstruct`.
    """
    names = names_without(library, without)
    if not names:
        raise UsageError(
            f"{library.path}: no material is left to reconstruct from; import others, or leave out fewer"
        )
    brdf, notes = _filled(file)
    library.bands.require_same(brdf.bands, file.name)
    materials = MaterialCache(library, names, is_nonnegative=True)
    bands = evenly_spaced(library.bands.count, SAMPLE_BANDS)
    trials = [0.0] if materials.is_isotropic else trial_rotations(file)
    tried = [reconstruct(materials, bands, _turned(brdf, -angle), numbers).turned(angle) for angle in trials]
    of_tried = [brdf_errors(brdf, reconstruction) for reconstruction in tried]
    best = int(np.argmin([errors.cube_root for errors in of_tried]))
    reconstruction = tried[best]
    if brdf.name in names:
        notes += (
            f"{brdf.name} is itself in the library, so the error is near 0; leave it out (--without {brdf.name}) to "
            "see the error of a new material",
        )
    return Reconstruction(
        brdf=reconstruction,
        materials=len(names),
        errors=of_tried[best],
        rotation_rad=trials[best],
        diagnostics=notes + _of_anisotropy(brdf, reconstruction),
    )


def _filled(file: BsdfFile) -> tuple[MeasuredBRDF, tuple[str, ...]]:
    """Return a measured file with its unmeasured cells filled, and diagnostics of these."""
    cells = unmeasured_cells(file)
    brdf, share = MeasuredBRDF(fill_unmeasured(file, cells)), unmeasured_share(file, cells)
    return brdf, diagnostics.of_unmeasured(share)


def trial_rotations(file: BsdfFile) -> list[float]:
    """Return candidate rotations in radians: 0, and those that align the spread of the normals with x or y."""
    if file.is_isotropic:
        return [0.0]
    rotation = rotation_of(file) or 0.0
    across = rotation + 0.5 * np.pi * (1.0 if rotation <= 0.0 else -1.0)
    return list(dict.fromkeys((0.0, rotation - file.rotation_rad, across - file.rotation_rad)))


def _turned(brdf: BRDF, angle_rad: float) -> BRDF:
    return brdf.turned(angle_rad) if angle_rad and isinstance(brdf, MeasuredBRDF) else brdf


def _of_anisotropy(brdf: BRDF, found: BRDF) -> tuple[str, ...]:
    """Return diagnostics of an anisotropic material whose description is isotropic."""
    if brdf.is_isotropic or not found.is_isotropic:
        return ()
    return ("anisotropic, but reconstructed from isotropic materials: the same at all azimuths",)
