"""Latent spaces fitted to the materials of a library."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from manifold.brdf.measured import MeasuredBRDF
from manifold.directions import from_spherical
from manifold.errors import UsageError
from manifold.latent.decoder import EncodingPairs
from manifold.latent.per_band import MonochromeGPLVM
from manifold.mapping import mapping_named
from manifold.metrics import RusinkiewiczGrid
from manifold.model import gram
from manifold.model.blend_fitting import BlendSamples, BlendTables, evaluate, fit_landmarks
from manifold.model.curve_space import CurveSpace
from manifold.model.decoding import decoder_at, integrating_sphere
from manifold.model.latent_space import LatentSpace
from manifold.model.material_space import MaterialSpace
from manifold.model.materials import MaterialCache
from manifold.model.settings import MOST_LAID_OUT, Settings
from manifold.records import Indices, evenly_spaced
from manifold.system import progress
from manifold.system.names import counted

_LIT_DEG = np.array([0.0, 45.0])
# Measured materials reach a little above 1; reflectance factors taken for f are pi times as large.
_MOST_ALBEDO = 1.5

Statistics = dict[str, float]
"""Objective at start and end of a fit."""
Fitted = tuple[LatentSpace, Statistics, BlendSamples | None]
"""A space, its statistics, and of a map by landmarks the samples that it was fitted to."""


def fit_space(materials: MaterialCache, settings: Settings) -> Fitted:
    """Fit the kind of space that the settings ask for to all materials of a cache.

    Raises:
        UsageError: fewer than two materials, or more dimensions than materials less one.
        LibraryError: a material cannot be read.
    """
    count, most = len(materials.names), len(materials.names) - 1
    if count < 2:
        raise UsageError(
            f"{materials.library.path.name}: found {counted(count, 'material')}, "
            "expected at least 2; import more"
        )
    if not 1 <= settings.latent_dim <= most:
        raise UsageError(
            f"{settings.latent_dim} latent dimensions for {count} materials, "
            f"expected {'1' if most == 1 else f'1 to {most}'}; choose fewer or import more"
        )
    if count > MOST_LAID_OUT and settings.kind != "blend":
        raise UsageError(
            f"{count} materials for kind {settings.kind}, expected at most {MOST_LAID_OUT}; use kind blend, or leave "
            "materials out"
        )
    if settings.kind != "blend":
        for material in materials.filled():
            _warn_if_bright(material)
    return _FITS[settings.kind](materials, settings)


class BrightMaterialWarning(UserWarning):
    """The directional albedo of a measured material is far above 1: its unit or its measurement is wrong."""


def _warn_if_bright(material: MeasuredBRDF) -> MeasuredBRDF:
    wi = from_spherical(np.deg2rad(_LIT_DEG), 0.0)
    some = evenly_spaced(material.bands.count, 3).tolist()
    most = float(material.select_bands(some).albedo(wi).max())
    if most > _MOST_ALBEDO:
        warnings.warn(
            f"{material.name} has a directional albedo of {most:.3g}, expected at most 1: check its unit, 1/sr, or "
            "exclude it; it is fitted unchanged",
            BrightMaterialWarning,
            stacklevel=4,
        )
    return material


def _fit_materials(materials: MaterialCache, s: Settings) -> Fitted:
    from manifold.gplvm import GPLVM  # imports scikit-learn, most of a second that predictions need not spend

    matrix = _gram(materials, s, None)
    fitted = GPLVM(
        s.latent_dim, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, optimizer=s.optimizer, prior=s.prior
    ).fit_gram(matrix.S, matrix.n_outputs)  # fmt: skip
    space = MaterialSpace(fitted.embedding_, matrix.S, matrix.n_outputs, s.covariance())
    return (
        space,
        {"objective_start": float(fitted.objective_start_), "objective": float(fitted.objective_)},
        None,
    )


def _fit_curves(materials: MaterialCache, s: Settings) -> Fitted:
    n_bands = materials.library.bands.count
    bands = evenly_spaced(n_bands, s.sample_bands)
    matrix = _gram(materials, s, bands)
    fitted = MonochromeGPLVM(
        s.latent_dim, mu=s.mu, length_scale=s.length_scale, kernel=s.kernel, prior=s.prior
    ).fit_gram(matrix.S, len(materials.names), matrix.n_outputs)  # fmt: skip
    unknown = np.zeros((len(materials.names), 0))  # decoding needs the samples' colours alone
    space = CurveSpace(fitted.structure_, fitted.colour_[:, :, 0], bands, unknown, unknown, s.covariance())
    # The colours of all bands, those of the samples too, by the decoded error, which is that of predictions.
    pairs = EncodingPairs.default(materials.is_isotropic)
    encoder = space.encoder(decoder_at(pairs, space, materials, s), replace(s, criterion="decoded"))
    sphere, measure = integrating_sphere()
    colours = np.empty((len(materials.names), n_bands))
    reflectances = np.empty_like(colours)
    for n, material in progress.each(enumerate(materials.filled()), "colours"):
        f = material.eval(pairs.wi, pairs.wo).T
        colours[n] = encoder.encode_colours(space.X[n], f)[:, 0]
        reflectances[n] = measure @ material.eval(sphere.wi, sphere.wo)
    statistics = {"objective_start": float(fitted.objective_start_), "objective": float(fitted.objective_)}
    return replace(space, own_colours=colours, reflectances=reflectances), statistics, None


def _fit_blends(materials: MaterialCache, s: Settings) -> Fitted:
    bands, samples = evenly_spaced(materials.library.bands.count, s.sample_bands), None
    count = s.landmarks_of(len(materials.names))
    if count < len(materials.names):
        read = map(_warn_if_bright, materials.stream())
        appearance, samples = evaluate(read, bands, materials.is_isotropic)
        space, layout = fit_landmarks(appearance, samples, count, s.latent_dim, s.covariance())
    else:
        brdfs = [_warn_if_bright(material) for material in materials.filled()]
        space, layout = BlendTables.of(brdfs, bands).fit(s.latent_dim, s.covariance())
    return space, {"objective_start": layout.objective_start, "objective": layout.objective}, samples


_FITS = {"blend": _fit_blends, "material": _fit_materials, "monochrome": _fit_curves}


def _gram(materials: MaterialCache, s: Settings, bands: Indices | None) -> gram.Gram:
    """The Gram matrix of whole materials, or of the given bands as samples, from the library's cache."""
    library, mapping = materials.library, mapping_named(s.mapping)
    grid = RusinkiewiczGrid.named(s.grid).suited_to(materials.is_isotropic)
    chosen = None if bands is None else bands.tolist()
    key = gram.cache_key(library.content_hash, materials.names, mapping, grid, chosen)
    cached = library.cache_get(key)
    size = len(materials.names) * (1 if bands is None else len(bands))
    if cached is not None and cached["S"].shape == (size, size):
        return gram.Gram(cached["S"], int(cached["n_outputs"][0]))
    brdfs = materials.filled()
    if chosen is not None:
        brdfs = [brdf.select_bands(chosen) for brdf in brdfs]
    matrix = gram.gram_matrix(brdfs, mapping, grid, per_band=chosen is not None)
    library.cache_put(key, {"S": matrix.S, "n_outputs": np.array([matrix.n_outputs])})
    return matrix
