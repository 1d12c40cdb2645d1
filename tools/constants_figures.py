"""The figures of `tools/constants.py`: numbers about left-out materials of the built-in library.

Each figure has a name, a function that prepares what it takes, and one that measures: numbers by name, mostly errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from left_out import read_ma_t12
from scipy.ndimage import gaussian_filter
from surface_twins import lamps_around, matte, photographed, truth

from manifold.brdf.measured import MeasuredBRDF
from manifold.colour.conversion import decode_srgb, encode_srgb
from manifold.colour.saturation import find_plateau
from manifold.core.directions import from_spherical
from manifold.core.errors import ManifoldError
from manifold.core.metrics import Errors
from manifold.core.records import Array
from manifold.estimate import LibraryAtoms, calibrate
from manifold.estimate.attributes import Attributes, Wanted, adjust, find, lab_of
from manifold.estimate.channels import Channels
from manifold.estimate.coat import coat_of
from manifold.estimate.completion import Completion
from manifold.estimate.expected import errors_of
from manifold.estimate.gloss import gloss_units
from manifold.estimate.lamp_plan import determined
from manifold.estimate.lamps import Lamp, lamp_picture
from manifold.estimate.light_probe import doubt_encoding, find_light, given_encoding_notes, given_lamp_notes
from manifold.estimate.outlines import Circle, Photograph, outlines_in
from manifold.estimate.pixels import Camera, blocks_of
from manifold.estimate.sightings import Sighting
from manifold.estimate.suggestions import all_directions, suggest
from manifold.fit.principled import fit_bsdf
from manifold.formats.doubts import with_doubts
from manifold.formats.readings import Readings
from manifold.library.store import Library
from manifold.model.colours import ColourChoice
from manifold.model.comparison import brdf_errors
from manifold.model.manifold import Manifold
from manifold.model.prediction import ClippedBRDF
from manifold.model.settings import KINDS
from manifold.surface.estimate import estimate_surface
from manifold.surface.sparkle import sparkle_of
from manifold.surface.tiling import tile

LIBRARY = Library("built-in")
SIX = LIBRARY.names[1::3][:6]
THREE = LIBRARY.names[2::7]
SIZE, MARGIN = 160, 0.25  # pixels of a simulated photograph; width beside the ball, in radii
LAMPS = np.array([[0.5, 0.4, 0.8], [-0.6, 0.2, 0.7], [0.1, 0.7, 0.6]])
GAINS = (3.0, 2.0, 5.0)


def material(name: str) -> MeasuredBRDF:
    """Return a material of the library."""
    return MeasuredBRDF(LIBRARY.read(name))


def named(errors: Errors[float], name: str) -> dict[str, float]:
    """Return the errors of a material that decide: of the ball, and of cube roots."""
    return {f"{name} ball": errors.ball, f"{name} cube root": errors.cube_root}


# Completions


def atoms() -> tuple[LibraryAtoms, dict[str, LibraryAtoms]]:
    """Return the atoms of the library, and those without each of the six materials."""
    whole = LibraryAtoms.of_library(LIBRARY)
    return whole, {name: whole.without(whole.names.index(name)) for name in SIX}


def observations(name: str) -> Iterator[tuple[str, Readings]]:
    """Yield readings of a material at the geometries of an MA-T12, and at 12 random directions."""
    brdf = material(name)
    yield "MA-T12", read_ma_t12(brdf, name)
    wi, wo = all_directions()
    some = np.random.default_rng(SIX.index(name)).choice(len(wi), 12, replace=False)
    yield "random", Readings(name, "simulated", wi[some], wo[some], None, brdf.eval(wi[some], wo[some]))


def completions(given: tuple[LibraryAtoms, dict[str, LibraryAtoms]]) -> dict[str, float]:
    """Return errors of the six materials, left out and completed from readings."""
    whole, others = given
    found = {}
    for name in SIX:
        for kind, readings in observations(name):
            made = Completion.of(others[name], readings)
            errors = errors_of(whole, whole.names.index(name), made.on_grid, made.on_ball)
            found |= named(errors, f"{name} {kind}")
    return found


def expected(given: tuple[LibraryAtoms, dict[str, LibraryAtoms]]) -> dict[str, float]:
    """Return errors that are expected of a completion, and what is said about it."""
    _, others = given
    kind, readings = next(observations(SIX[0]))
    made = Completion.of(others[SIX[0]], readings)
    said = calibrate(others[SIX[0]], readings).expected(made)
    return named(said, kind) | {"residual": made.residual, "alternatives": float(len(made.alternatives))}


def suggested(given: tuple[LibraryAtoms, dict[str, LibraryAtoms]]) -> dict[str, float]:
    """Return the errors after two suggested readings, and directions of the third."""
    whole, others = given
    found = {}
    for name in SIX[2:4]:
        chosen = suggest(others[name], 2)
        readings = Readings(
            name, "simulated", chosen.wi, chosen.wo, None, material(name).eval(chosen.wi, chosen.wo)
        )
        made = Completion.of(others[name], readings)
        found |= named(errors_of(whole, whole.names.index(name), made.on_grid, made.on_ball), name)
        found[f"{name} third"] = float(np.sum(suggest(others[name], 1, made).angles_deg))
    return found


# Colour and gloss


def colour_and_gloss(_: None) -> dict[str, float]:
    """Return errors of coats with the colour and gloss of the library's materials, and gloss of measured ones."""
    found = {}
    for name in THREE:
        made, _ = coat_of(lab_of(material(name)), gloss_units(material(name), (60.0,)), LIBRARY.bands)
        found |= named(brdf_errors(material(name), made), f"{name} coat")
        for angle, units in gloss_units(material(name), (20.0, 60.0, 85.0)).items():
            found[f"{name} gloss {angle:g}"] = units
    nearest = find(LIBRARY, lab=lab_of(material(SIX[0])), gloss={60.0: 30.0})
    return found | {"nearest": nearest[1].distance}


def adjusted(model: Manifold) -> dict[str, float]:
    """Return the lightness, chroma and hue that `adjust` reaches for a wanted hue, and the remaining difference."""
    found = {}
    for name in THREE[:1]:
        made = adjust(model, name, Attributes({"hue": Wanted(30.0)}))
        found[f"{name} missed"] = made.difference
        found |= {f"{name} x{k}": float(x) for k, x in enumerate(made.place.latent)}
    return found


# Maps


def fitted_map() -> Manifold:
    """Return the map of the library."""
    return Manifold.fit(LIBRARY, calibrate=False)


def map_of_others() -> Manifold:
    """Return the map of the library without three materials."""
    return Manifold.fit(LIBRARY, names=set(LIBRARY.names) - set(THREE), calibrate=False)


def whole_map(_: None) -> dict[str, float]:
    """Return the coherence of a map, and its expected errors."""
    model = Manifold.fit(LIBRARY)
    coherence = model.coherence
    assert coherence is not None
    found = {
        "detour": coherence.detour,
        "detour p90": coherence.detour_p90,
        "kept": coherence.neighbours_kept,
    }
    for name in THREE:
        said = model.expected_error(0.5 * (model.latent(name) + model.latent(SIX[0])))
        assert said is not None
        found |= named(said, f"{name} expected")
    return found


def left_out_of_map(_: None) -> dict[str, float]:
    """Return errors of three materials, located on a map of the others and predicted there."""
    found = {}
    for name in SIX[::2]:
        model = Manifold.fit(LIBRARY, names=set(LIBRARY.names) - {name}, calibrate=False)
        located = model.embed(material(name))
        found |= named(brdf_errors(material(name), model.predict(located.latent, located.colours)), name)
    return found


def predictions(model: Manifold) -> dict[str, float]:
    """Return lightness of predictions between materials, in several colours, and of a walk."""
    found = {}
    for k, (one, other) in enumerate(zip(SIX[:3], SIX[3:], strict=True)):
        between = 0.5 * (model.latent(one) + model.latent(other))
        for what, brdf in (
            ("between", model.predict(between)),
            (
                "in a colour",
                model.predict(between, model.choose_colour(between, ColourChoice(like=THREE[k])).colours),
            ),
            ("walk", model.predict(f"{one}:{other}:0.4")),
        ):
            values = np.cbrt(np.maximum(brdf.eval(*all_directions()), 0.0))
            found |= {f"{what} {k} mean": float(values.mean()), f"{what} {k} largest": float(values.max())}
    return found


def reconstructed(others: Manifold) -> dict[str, float]:
    """Return errors of a material, reconstructed from the others."""
    found = {}
    for name in THREE[1:2]:
        for numbers in (12, None):
            made = others.reconstruct(material(name), numbers)
            found |= named(brdf_errors(material(name), made), f"{name} {numbers}")
    return found


def published_map(_: None) -> dict[str, float]:
    """Return errors of a material on a map of the published method."""
    found = {}
    for name in THREE[:1]:
        model = Manifold.fit(LIBRARY, KINDS["gplvm"](), names=set(LIBRARY.names) - {name}, calibrate=False)
        located = model.embed(material(name))
        found |= named(brdf_errors(material(name), model.predict(located.latent, located.colours)), name)
    return found


# Photographs


def simulated(name: str, gains: Sequence[float]) -> list[Photograph]:
    """Return 8-bit photographs of a material's ball under three lamps, each of its own gain, clipped."""
    pictures, noise = [], 1.0 + 0.01 * np.random.default_rng(0).standard_normal((SIZE, SIZE, 3))
    for direction, gain in zip(LAMPS, gains, strict=True):
        made = gain * noise * lamp_picture(material(name), Camera(), [Lamp.towards(direction)], SIZE, MARGIN)
        coded = np.round(255.0 * np.clip(made, 0.0, 1.0)) / 255.0
        pictures.append(Photograph(Path("made"), coded.astype(np.float32), made >= 1.0))
    return pictures


PICTURES = {SIX[3]: simulated(SIX[3], GAINS)}
ALIKE = {SIX[3]: simulated(SIX[3], np.ones(3))}


def photographs(_: None) -> dict[str, float]:
    """Return errors of outline, lamps and gains that are found in photographs of a material."""
    found = {}
    for name, pictures in PICTURES.items():
        for count in (1, 3):
            try:
                probe = find_light(pictures[:count])
            except ManifoldError:
                found[f"{name} {count} refused"] = 1.0
                continue
            found[f"{name} {count} refused"] = 0.0
            found[f"{name} {count} radius"] = probe.circle.radius
            for lamp, true in zip(probe.lamps, LAMPS, strict=False):
                off = np.arccos(np.clip(lamp.direction @ true / np.linalg.norm(true), -1.0, 1.0))
                found[f"{name} {count} lamp {true[0]}"] = float(np.rad2deg(off))
    return found


def photographed_materials(given: Mapping[str, tuple[LibraryAtoms, Channels]]) -> dict[str, float]:
    """Return errors of a material, left out and completed from its photographs."""
    found = {}
    for name, (others, channels) in given.items():
        circle = outlines_in(ALIKE[name])[0].circle
        seen = [
            Sighting(blocks_of(picture, circle), Camera(), (Lamp.towards(direction),))
            for picture, direction in zip(ALIKE[name], LAMPS, strict=True)
        ]
        for count, exposure in ((1, None), (3, 1.0)):
            made = Completion.of(others, seen[:count], exposure=exposure, channels=channels)
            found |= named(brdf_errors(material(name), ClippedBRDF(made.brdf)), f"{name} {count}")
    return found


def atoms_of_values() -> dict[str, tuple[LibraryAtoms, Channels]]:
    """Return the atoms without each photographed material, as values, and the camera's channels."""
    whole = LibraryAtoms.of_library(LIBRARY)
    found = {}
    for name in ALIKE:
        others = whole.without(whole.names.index(name)).in_values
        found[name] = others, Channels.of_library(LIBRARY, others.names)
    return found


def planned(given: Mapping[str, tuple[LibraryAtoms, Channels]]) -> dict[str, float]:
    """Return the error that is expected from a picture under a lamp at 30 degrees."""
    others, _ = next(iter(given.values()))
    return {"ball": determined(others, (30.0,), None).ball}


# Encodings and saturation of pictures

CODES: dict[str, Callable[[Array], Array]] = {"linear": lambda values: values, "sRGB": encode_srgb}


def coded(name: str, direction: Array, codes: str, read: str) -> Photograph:
    """Return an 8-bit photograph of a material, whose codes are linear or sRGB, and are read as either."""
    made = lamp_picture(material(name), Camera(), [Lamp.towards(direction)], SIZE, MARGIN)
    made = np.minimum(made / np.quantile(made, 0.995), 1.0)
    stored = np.round(255.0 * CODES[codes](made)) / 255.0
    values = decode_srgb(stored) if read == "sRGB" else stored
    return Photograph(Path("made"), values.astype(np.float32), made >= 1.0, is_encoded=read == "sRGB")


ENCODED = {codes: coded(SIX[3], LAMPS[0], codes, "sRGB") for codes in CODES}


def encodings(_: None) -> dict[str, float]:
    """Return which notes advise another encoding, for given and estimated lamps, and the uncertainty of the latter.

    Given lamps are 4 and 30 degrees off; the second is doubted.
    """
    circle = Circle(0.5 * SIZE, 0.5 * SIZE, 0.5 * SIZE / (1.0 + MARGIN))
    near, far = (Lamp.towards(nearer_to_camera(LAMPS[0], off)) for off in (4.0, 30.0))
    found = {
        f"{codes} read as sRGB, given": float(
            len(given_encoding_notes([picture], [circle], [near], are_given=True))
        )
        for codes, picture in ENCODED.items()
    }
    found["doubted"] = float(len(given_lamp_notes(ENCODED["sRGB"], circle, far)))
    probe, notes = doubt_encoding([ENCODED["linear"]], find_light([ENCODED["linear"]], circle))
    return found | {"found": float(len(notes)), "uncertainty": probe.lamp_deg[0]}


def nearer_to_camera(direction: Array, degrees: float) -> Array:
    """Return a direction turned towards the camera."""
    across = np.hypot(*direction[:2])
    angle = np.arctan2(across, direction[2]) - np.deg2rad(degrees)
    return np.append(np.sin(angle) * direction[:2] / across, np.cos(angle))


def saturated_channels() -> dict[str, tuple[Array, Array]]:
    """Return channels as files store them, with the pixels that are saturated: none, few and many of them."""
    made = {}
    noise = 1.0 + 0.01 * np.random.default_rng(0).standard_normal((SIZE, SIZE))
    for name in (*SIX[:2], "even"):
        values = (
            np.hypot(*np.mgrid[-1 : 1 : SIZE * 1j, -1 : 1 : SIZE * 1j]) < 0.7
            if name == "even"
            else lamp_picture(material(name), Camera(), [Lamp.towards(LAMPS[1])], SIZE, MARGIN)[..., 1]
        ).astype(float)
        for share in (1.0,) if name == "even" else (1.0, 0.99, 0.9):
            level = float(np.quantile(values, share))
            clipped = np.minimum(values / level, 1.0)
            for kind, channel in {
                "14 bits": np.rint(16383 * clipped).astype(np.uint16),
                "8 bits": np.rint(255.0 * encode_srgb(0.8 * clipped * noise)).astype(np.uint8),
                "floats": (0.35 * gaussian_filter(clipped, 0.8) * noise).astype(np.float32),
            }.items():
                made[f"{name} {share:g} {kind}"] = channel, values > level
    return made


def plateaus(channels: Mapping[str, tuple[Array, Array]]) -> dict[str, float]:
    """Return shares of saturated pixels that are missed, and numbers of others that are taken for saturated."""
    found = {}
    for name, (channel, is_saturated) in channels.items():
        plateau = find_plateau(channel)
        pixels = np.zeros(channel.shape, bool) if plateau is None else plateau.pixels
        if is_saturated.any():
            found[f"{name} missed"] = float(np.mean(~pixels[is_saturated]))
        found[f"{name} too many"] = float(np.count_nonzero(pixels & ~is_saturated))
    return found


# Tables


def tables() -> dict[str, Readings]:
    """Return tables of the library's materials: correct ones, and with values and angles that are not what they say."""
    angles = np.meshgrid(
        np.deg2rad([20.0, 40.0, 60.0]),
        np.deg2rad(np.arange(0.0, 80.0, 10.0)),
        np.deg2rad(np.arange(0.0, 360.0, 30.0)),
    )
    theta_i, theta_o, phi = (each.ravel() for each in angles)
    wi, wo = from_spherical(theta_i, np.pi), from_spherical(theta_o, phi)
    turned = from_spherical(theta_o, phi + np.pi)
    small = from_spherical(np.deg2rad(theta_i), np.pi), from_spherical(np.deg2rad(theta_o), phi)
    made = {}
    for name in SIX:
        f = material(name).eval(wi, wo)
        noise = 0.02 * np.median(f) * np.random.default_rng(1).standard_normal(f.shape)
        for kind, (a, b, values) in {
            "correct": (wi, wo, f),
            "noisy": (wi, wo, f + noise),
            "less a baseline": (wi, wo, f - np.median(f)),
            "logarithms": (wi, wo, -np.log10(np.maximum(f, 1e-6))),
            "factors": (wi, wo, np.pi * f),
            "percent": (wi, wo, 100.0 * np.pi * f),
            "radians as degrees": (*small, f),
            "turned azimuths": (wi, turned, f),
        }.items():
            made[f"{name} {kind}"] = Readings(name, "made", a, b, None, values)
    return made


def doubts(readings: Mapping[str, Readings]) -> dict[str, float]:
    """Return numbers of notes on each table."""
    return {name: float(len(with_doubts(one).notes)) for name, one in readings.items()}


# Fits and surfaces


def fits(_: None) -> dict[str, float]:
    """Return errors of `principled` fitted to three materials, and how many parameters are determined."""
    found = {}
    for name in THREE:
        result = fit_bsdf(material(name))
        found |= named(brdf_errors(material(name), result.brdf), name)
        found[f"{name} determined"] = float(sum(s.state == "determined" for s in result.statements))
        found[f"{name} minima"] = float(sum(m.as_good for m in result.minima))
    return found


def surfaces(_: None) -> dict[str, float]:
    """Return errors of slopes and albedos of a simulated sample, and how its texture tiles."""
    rng = np.random.default_rng(0)
    _, slope = truth(rng)
    pictures, albedo = photographed(rng, slope)
    values = pictures.values.copy()
    for j in range(1, 5):  # glints, each under one lamp
        rows, columns = rng.integers(2, [s - 2 for s in values.shape[1:3]], (40, 2)).T
        values[j, rows, columns] *= 3.0
    values[:, 100:106, 60:66] *= 0.3  # dust
    surface = estimate_surface(replace(pictures, values=values))
    sparkle, textures = sparkle_of(surface), tile(surface, 256)
    return {
        "slope": _off(surface.slope[..., 1], slope[..., 1]),
        "across": _off(surface.relief[..., 0], slope[..., 0]),
        "albedo": _off(np.log(surface.albedo), np.log(np.broadcast_to(albedo, surface.albedo.shape))),
        "slope std": float(surface.slope_std[1]),
        "glints": sparkle.density,
        "flakes": 0.0 if sparkle.flakes is None else sparkle.flakes.roughness,
        "texture": float(np.log(textures.albedo).std()),
        "texture edge": float(np.abs(np.log(textures.albedo[0] / textures.albedo[-1])).mean()),
        "notes": float(len(textures.notes)),
    }  # fmt: skip


def matte_surfaces(_: None) -> dict[str, float]:
    """Return errors of slopes and albedos of matte reliefs under three, four and nine lamps, with noise and glints."""
    found = {}
    for count, noise in ((3, 0.02), (4, 0.02), (9, 0.0), (9, 0.05)):
        rng = np.random.default_rng(0)
        _, slope = truth(rng, (100, 100))
        pictures = matte(rng, slope, lamps_around(count, 40.0), noise=noise)
        values = pictures.values.copy()
        if count > 4:
            rows, columns = rng.integers(0, 100, (2, 100))
            values[1, rows, columns] *= 4.0  # glints under one lamp
            values[2, :8, :8] *= 0.1  # a shadow
        surface = estimate_surface(replace(pictures, values=values))
        found |= {
            f"{count} lamps, noise {noise:g}, slope": _off(surface.slope, slope),
            f"{count} lamps, noise {noise:g}, stated": float(surface.slope_std.mean()),
            f"{count} lamps, noise {noise:g}, albedo": float(np.log(surface.albedo).std()),
        }
    return found


def _off(found: Array, true: Array) -> float:
    return float(np.sqrt(np.mean((found - true) ** 2)) / np.std(true))


def nothing() -> None:
    """Prepare nothing."""


def all_figures() -> list[tuple[str, str, Callable[[], Any], Callable[[Any], dict[str, float]]]]:
    """Return the figures: name, the modules whose constants it serves, preparation, measurement."""
    return [
        ("completions", "estimate", atoms, completions),
        ("expected", "estimate.expected estimate.completion estimate.mixtures", atoms, expected),
        ("suggested", "estimate.suggestions estimate.evidence estimate.residual", atoms, suggested),
        (
            "colours",
            "estimate.attributes estimate.coat estimate.gloss model.decoding",
            nothing,
            colour_and_gloss,
        ),
        ("adjusted", "estimate.attributes model.blend_space", fitted_map, adjusted),
        ("map", "model", nothing, whole_map),
        ("left out", "model", nothing, left_out_of_map),
        ("predictions", "model", fitted_map, predictions),
        (
            "reconstructed",
            "model.reconstruction model.estimator model.decoding",
            map_of_others,
            reconstructed,
        ),
        ("published", "model", nothing, published_map),
        ("light", "estimate.light_probe estimate.outlines estimate.lamps", nothing, photographs),
        ("encodings", "estimate.light_probe", nothing, encodings),
        ("plateaus", "colour.saturation", saturated_channels, plateaus),
        ("doubts", "formats.doubts formats.light_side formats.values", tables, doubts),
        ("photographed", "estimate", atoms_of_values, photographed_materials),
        ("planned", "estimate.lamp_plan", atoms_of_values, planned),
        ("fits", "fit", nothing, fits),
        ("surfaces", "surface", nothing, surfaces),
        ("matte", "surface.lambertian surface.estimate", nothing, matte_surfaces),
    ]
