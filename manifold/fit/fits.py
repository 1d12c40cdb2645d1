"""Implements `manifold fit`: fits files or a prediction, and writes one JSON per material."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from manifold.brdf.interface import BRDF
from manifold.colour.narrow_bands import with_spectra
from manifold.core import disk
from manifold.core.errors import ManifoldError, UsageError
from manifold.core.judged_lights import BALL_COLUMN
from manifold.core.names import printable
from manifold.core.progress import Stages
from manifold.core.records import BsdfFile, plain
from manifold.core.results import placed
from manifold.estimate.inputs import Input
from manifold.estimate.source_files import read_source, source_file
from manifold.estimate.sources import FileSource, LibrarySource, MaterialSource, PlaceSource
from manifold.fit import fit_samples
from manifold.fit.fit_samples import FitSamples
from manifold.fit.principled import FitResult, fit_bsdf
from manifold.formats import registry
from manifold.formats.recognition import is_rgl
from manifold.io_rgl import read_bsdf
from manifold.library.identity import file_sha256, require_material_name
from manifold.library.store import Library
from manifold.many.batch import PREDICTED, BatchCommand, Content, Outcome, appearance
from manifold.model import diagnostics
from manifold.model.diagnostics import DiagnosedPrediction
from manifold.model.manifold import load_model
from manifold.registries import FIT_SUFFIX, FITTERS
from manifold.render import fit_json
from manifold.render.bsdf_evaluation import bsdf_dict
from manifold.render.bsdf_parameters import BsdfFamily, default_principled, diffuse
from manifold.render.fit_json import FitSource
from manifold.render.fitted_brdf import FittedBRDF

Measured = FileSource | LibrarySource
"""A file, or a material of a library."""


@dataclass(frozen=True)
class FitSettings:
    """Settings of a fit.

    Attributes:
        family, method, metric, noise, wide_colours: as in `principled.fit_bsdf`.
        sample: name of the sample, if the file has several.
    """

    family: BsdfFamily | None = None
    method: str = "gauss-newton"
    metric: str = "appearance"
    noise: float = 0.01
    wide_colours: bool = False
    sample: str | None = None

    def fit(
        self,
        target: BRDF | BsdfFile | FitSamples,
        source: FitSource,
        notes: Sequence[str] = (),
    ) -> dict[str, Any]:
        """Fit a material, and return the content of the fit's JSON; its notes begin with `notes`."""
        found = fit_bsdf(
            target, self.family, method=self.method, metric=self.metric, noise=self.noise,
            wide_colours=self.wide_colours,
        )  # fmt: skip
        return document(replace(found, notes=(*notes, *found.notes)), source)

    def matches(self, content: dict[str, Any]) -> bool:
        """Return whether a written fit has these settings and was made by this version of the program."""
        families = [self.family]
        if self.family is None:
            families = [default_principled(known, wide_colours=self.wide_colours) for known in (True, False)]
            families.append(diffuse(wide_colours=self.wide_colours))
        return (
            content["program"] == fit_json.PROGRAM
            and content["bsdf"] in [json.loads(json.dumps(family.to_json())) for family in families if family]
            and (content["method"], content["metric"]) == (self.method, self.metric)
            and content["hyperparameters"] == asdict(FITTERS[self.method]()) | {"noise": self.noise}
        )


def document(result: FitResult, source: FitSource) -> dict[str, Any]:
    """Return a fit as plain values that follow the JSON schema."""
    wavelengths, own = result.bands.wavelengths_nm, result.spectra
    known = asdict(result) | {"errors": result.errors and result.errors.to_json()}
    del known["bands"]
    content = {
        "format": "manifold fit",
        "format_version": fit_json.FORMAT_VERSION,
        "program": fit_json.PROGRAM,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "source": asdict(source),
        "bsdf": known.pop("family"),
        "mitsuba": bsdf_dict(result.family, result.values),
        "mitsuba_spectral": bsdf_dict(result.family, result.values | own, wavelengths) if own else None,
    } | known
    content["spectra"] = {"wavelengths_nm": wavelengths, "values": own} if own else None
    return fit_json.signed(
        json.loads(json.dumps(content, allow_nan=False))
    )  # lists for tuples, as it is read again


def read_family(path: Path) -> BsdfFamily:
    """Read a BSDF family from a JSON file of `type`, `parameters` and `fixed`; see `BsdfFamily.to_json`."""
    return fit_json.family_of(disk.read_json(path, "a JSON description of a BSDF"), str(path))


def fit(source: Path | MaterialSource, target: Path, settings: FitSettings | None = None) -> Outcome[Any]:
    """Fit a file or another material and write the JSON; an up-to-date fit of the same file is kept.

    If measured data cannot be fitted, the outcome states the reason. For a point on a map, the source of the outcome
    is the prediction.
    """
    disk.require_writable(target)
    settings = settings or FitSettings()
    if isinstance(source, PlaceSource):
        return _fit_prediction(source, target, settings)
    measured = FileSource(source) if isinstance(source, Path) else source
    name = settings.sample or measured.name
    try:
        require_material_name(name)
        content, was_there = _fitted(name, measured, target, settings)
        return Outcome(name, target, measured, content, was_there)
    except ManifoldError as error:
        return Outcome(printable(name), target, measured, failure=str(error))
    except OSError as error:
        failure = f"{measured} cannot be read ({error.strerror})"
        return Outcome(printable(name), target, measured, failure=failure)


def fits(settings: FitSettings, *, with_pictures: bool = False) -> BatchCommand[Input]:
    """Return the batch command that fits many materials, one JSON each; up-to-date fits are kept.

    With pictures, each fit of a whole BRDF is drawn beside its material into NAME.fit.png.
    """
    columns = placed(FitResult.columns(), PREDICTED, before=BALL_COLUMN)
    return BatchCommand(
        "fits", partial(_fit_input, settings=settings, with_pictures=with_pictures),
        plain(settings) | {"pictures": with_pictures}, FIT_SUFFIX, columns=columns, under=BALL_COLUMN,
        has_balls=True, beside=_picture_of,
    )  # fmt: skip


def _fit_prediction(place: PlaceSource, path: Path, settings: FitSettings) -> Outcome[DiagnosedPrediction]:
    stages = Stages({"reading materials": 3, "fitting": 7})
    loaded = load_model(place.model, place.library)
    stages.begin("reading materials")
    loaded.prepare()
    predicted = diagnostics.predict_and_diagnose(loaded, place.place, place.colour)
    source = FitSource(
        name=path.name.removesuffix(".json").removesuffix(".fit"),
        latent=None if predicted.latent is None else tuple(predicted.latent.tolist()),
        walk=predicted.walk,
        model=place.model.name,
        model_sha256=file_sha256(place.model),
        colour=predicted.colour,
    )
    stages.begin("fitting")
    content = settings.fit(predicted.brdf, source, predicted.diagnostics)
    fit_json.write_document(path, content)
    return Outcome(source.name, path, predicted, content)


def _fit_input(source: Input, target: Path, *, settings: FitSettings, with_pictures: bool) -> Content:
    if isinstance(source.source, PlaceSource):
        content = _fit_prediction(source.source, target, settings).content or {}
    else:
        settings = replace(settings, sample=source.sample)
        content, _ = _fitted(source.name, source.source, target, settings)
    picture = target.with_suffix(".png")
    drawn: dict[str, str] = {}
    if with_pictures:
        from manifold.pictures.fit_comparison import picture_of_fit

        with source_file(source.source) as file:
            if is_rgl(file):
                picture_of_fit(target, file, picture)
                drawn = {"picture": picture.name}
    return content | drawn | appearance(target, FittedBRDF(content))


def _picture_of(path: Path, content: Content) -> list[Path]:
    return [path.parent / content["picture"]] if "picture" in content else []


def _fitted(name: str, source: Measured, target: Path, settings: FitSettings) -> tuple[dict[str, Any], bool]:
    """Return the content of a fit's JSON, which is written, and whether an earlier run had written it."""
    if isinstance(source, LibrarySource):
        info = Library(source.library).attributes(source.name)
        origin = FitSource(name=name, file=info.source_file, sha256=info.sha256)
    else:
        origin = FitSource(name=name, file=source.path.name, sha256=file_sha256(source.path))
    there = _earlier(target, origin, settings)
    if there is not None:
        return there, True
    content = _fit(source, origin, settings)
    fit_json.write_document(target, content)
    return content, False


def _fit(measured: Measured, source: FitSource, settings: FitSettings) -> dict[str, Any]:
    """Fit a material or an instrument's file, and return the content; notes report ambiguous and omitted data."""
    if isinstance(measured, LibrarySource):
        return settings.fit(read_source(measured), source)
    path = measured.path
    known = registry.identify(path)
    if known is None:
        if settings.sample is not None:
            raise UsageError(f"{path} holds one material, found a sample {settings.sample}; leave it out")
        return settings.fit(read_bsdf(path), source)
    readings = with_spectra(registry.read_readings(path, settings.sample, fit_samples.MAX_PAIRS))
    notes = readings.notes
    if readings.gloss:
        notes += ("fits do not use gloss; `manifold complete` does, and its file can be fitted",)
    return settings.fit(fit_samples.from_readings(readings), source, notes)


def _earlier(target: Path, source: FitSource, settings: FitSettings) -> dict[str, Any] | None:
    """Return the fit that an earlier run wrote for the same file and settings, or None."""
    if not target.is_file():
        return None
    try:
        content = fit_json.read(target)
    except ManifoldError:
        return None  # not a fit, or of another version: it is written anew
    known = content["source"]
    is_same = (known["name"], known["sha256"]) == (source.name, source.sha256) and settings.matches(content)
    return content if is_same and fit_json.is_untouched(content) else None
