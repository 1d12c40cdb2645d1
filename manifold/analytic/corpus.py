"""The built-in corpus: 51 analytic materials, measured by the virtual goniometer into RGL files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from manifold.analytic.base import Sheen
from manifold.analytic.diffuse import RoughDiffuse
from manifold.analytic.ggx import GGX, GGXMixture
from manifold.analytic.layers import Immersed, Layered, MixedBRDF, Retroreflection
from manifold.analytic.microfacet import Plastic, RoughConductor, RoughDielectric, ThinFilm
from manifold.brdf import goniometer
from manifold.brdf.interface import BRDF
from manifold.brdf.measured import MeasuredBRDF
from manifold.brdf.unmeasured_cells import find_rim
from manifold.colour.conversion import file_to_srgb, luminance
from manifold.colour.reflectances import diffuse_reflectance, metal_ior
from manifold.core import progress
from manifold.core.directions import from_spherical
from manifold.core.errors import FileAccessError
from manifold.core.records import Array, Bands, BsdfFile, Indices
from manifold.io_rgl import rgl_wavelengths_nm, write_bsdf

Recipe = Callable[[Bands], BRDF]
Lobes = Sequence[tuple[float, float]]
"""Pairs (share of the area, roughness alpha): a core and its haze."""

_VARNISH = np.array(1.5)  # index of refraction of paints, papers and coats


def _pigment(spectrum: str, bands: Bands, scale: float = 1.0) -> Array:
    """Return a reflectance per band, kept below that of a perfect white."""
    return np.clip(scale * diffuse_reflectance(spectrum, np.array(bands.wavelengths_nm)), 0.0, 0.97)


def _tinted_metal(ggx: GGX | GGXMixture, colour: Array, bands: Bands) -> RoughConductor:
    """Return a reflector whose real refractive index gives the wanted reflectance at normal incidence."""
    root = np.sqrt(np.clip(colour, 0.02, 0.95))
    return RoughConductor(ggx, (1.0 + root) / (1.0 - root), np.zeros_like(root), bands)


def _felt(spectrum: str, fuzz: float, width: float, rough: float, glint: float, scale: float = 1.0) -> Recipe:
    """Return a recipe of cloth.

    The matt fibres, some of which are retro-reflective, lie under fuzz that brightens the rim.
    """

    def recipe(bands: Bands) -> BRDF:
        colour = _pigment(spectrum, bands, scale)
        glints = Retroreflection(_tinted_metal(GGX.isotropic(0.6), colour, bands))
        shine = RoughDielectric(GGX.isotropic(0.45), np.array(1.55), bands)
        fibres = MixedBRDF([(1.0 - glint, RoughDiffuse(colour, rough, bands)), (glint, glints)])
        return Layered(Sheen(width, fuzz * np.sqrt(colour), bands), Layered(shine, fibres))

    return recipe


def _matte(spectrum: str, lobes: Lobes, rough: float, back: float, eta: float, scale: float = 1.0) -> Recipe:
    """Return a recipe of paper, wall paint or card.

    The rough pigment is partly retro-reflective and has a specular surface.
    """

    def recipe(bands: Bands) -> BRDF:
        colour = _pigment(spectrum, bands, scale)
        beads = Retroreflection(_tinted_metal(GGX.isotropic(0.35), colour, bands))
        pigment = MixedBRDF([(1.0 - back, RoughDiffuse(colour, rough, bands)), (back, beads)])
        return Layered(RoughDielectric(GGXMixture(lobes), np.array(eta), bands), pigment)

    return recipe


def _varnished(
    spectrum: str, lobes: Lobes, depth: float, inner: float, eta: float = 1.5, scale: float = 1.0
) -> Recipe:
    """Return a recipe of satin or glossy paint: pigment under varnish, with a share `depth` of a soft lobe."""

    def recipe(bands: Bands) -> BRDF:
        colour, ggx = _pigment(spectrum, bands, scale), GGXMixture(lobes)
        soft = _tinted_metal(GGX.isotropic(inner), colour**0.7, bands)
        below = Layered(RoughDielectric(ggx, np.array(eta), bands), Immersed(soft, eta, np.sqrt(colour)))
        return MixedBRDF([(1.0 - depth, Plastic(ggx, np.array(eta), colour, bands)), (depth, below)])

    return recipe


def _lacquered(reflectors: BRDF, share: float, coat: Lobes, tint: Array, pigment: Array) -> BRDF:
    """Return a mixture of reflectors and pigment under a coat that refracts and absorbs."""
    bands, ggx = reflectors.bands, GGXMixture(coat)
    seen = Layered(RoughDielectric(ggx, _VARNISH, bands), Immersed(reflectors, float(_VARNISH), tint))
    return MixedBRDF([(share, seen), (1.0 - share, Plastic(ggx, _VARNISH, pigment, bands))])


def _metallic(
    spectrum: str,
    flakes: Lobes,
    coat: Lobes,
    share: float,
    depth: float,
    scale: float = 1.0,
    film_nm: float = 0.0,
) -> Recipe:
    """Return a recipe of vinyl film with metal powder under a tinted coat.

    A film on the powder makes its hue change.
    """

    def recipe(bands: Bands) -> BRDF:
        colour, ggx = _pigment(spectrum, bands, scale), GGXMixture(flakes)
        metal: RoughConductor | ThinFilm = _tinted_metal(ggx, colour ** (1.0 - depth), bands)
        if film_nm > 0.0:
            metal = ThinFilm(ggx, np.array(1.8), film_nm, metal.eta, metal.k, bands)
        return _lacquered(metal, share, coat, np.clip(colour, 0.05, 1.0) ** (0.5 * depth), 0.6 * colour)

    return recipe


def _chrome(spectrum: str | None, lobes: Lobes, depth: float = 0.0, haze: float = 0.0) -> Recipe:
    """Return a recipe of chrome vinyl: chromium with haze around the reflection, bare or under a pigmented coat.

    The pigment covers a share `haze`. Real films have 0.01 to 0.04 1/sr far from the mirror direction.
    """

    def recipe(bands: Bands) -> BRDF:
        eta, k = metal_ior("Cr", np.array(bands.wavelengths_nm))
        chromium = RoughConductor(GGXMixture(lobes), eta, k, bands)
        if spectrum is None:
            return chromium
        coat = RoughDielectric(GGX.isotropic(lobes[0][1]), _VARNISH, bands)
        colour = np.clip(_pigment(spectrum, bands, 1.4), 0.05, 1.0)
        metal = Immersed(chromium, float(_VARNISH), colour**depth)
        return Layered(coat, MixedBRDF([(1.0 - haze, metal), (haze, RoughDiffuse(colour, 0.5, bands))]))

    return recipe


def _flake(spectrum: str, flakes: Lobes, coat: Lobes, share: float, depth: float) -> Recipe:
    """Return a recipe of car paint: aluminium flakes and pigment under a glossy coat of the pigment's tint."""

    def recipe(bands: Bands) -> BRDF:
        eta, k = metal_ior("Al", np.array(bands.wavelengths_nm))
        colour = _pigment(spectrum, bands)
        aluminium = RoughConductor(GGXMixture(flakes), eta, k, bands)
        return _lacquered(aluminium, share, coat, np.clip(colour, 0.05, 1.0) ** depth, 0.8 * colour)

    return recipe


def _iridescent(
    thickness_nm: float, spread: float, flakes: Lobes, share: float, base: str, coat: Lobes
) -> Recipe:
    """Return a recipe of interference pigment.

    Thin films lie on absorbing platelets among dark pigment; their thickness varies by `spread`.
    """

    def recipe(bands: Bands) -> BRDF:
        eta, k = metal_ior("Cr", np.array(bands.wavelengths_nm))
        ggx, film = GGXMixture(flakes), np.array(1.6)
        films = [
            (1.0 / 3.0, ThinFilm(ggx, film, thickness_nm * (1.0 + d * spread), eta, k, bands))
            for d in (-1.0, 0.0, 1.0)
        ]
        return _lacquered(MixedBRDF(films), share, coat, np.ones(1), 0.5 * _pigment(base, bands))

    return recipe


def _metal(name: str, ggx: GGX | GGXMixture, oxide: float = 0.0, thickness_nm: float = 60.0) -> Recipe:
    """Return a recipe of bare metal, of which a share is covered by a thin transparent oxide."""

    def recipe(bands: Bands) -> BRDF:
        eta, k = metal_ior(name, np.array(bands.wavelengths_nm))
        bare = RoughConductor(ggx, eta, k, bands)
        if oxide == 0.0:
            return bare
        return MixedBRDF(
            [(1.0 - oxide, bare), (oxide, ThinFilm(ggx, np.array(1.76), thickness_nm, eta, k, bands))]
        )

    return recipe


def isotropic_recipes() -> dict[str, Recipe]:
    """Return the functions that make the 51 isotropic materials, by name; names begin with the family."""
    white = "ohta/white 9.5 (.05 D)"
    recipes = {
        "felt_green": _felt("ohta/green", 0.55, 0.22, 0.9, 0.10),
        "felt_orange": _felt("ohta/orange", 0.40, 0.35, 0.6, 0.20),
        "felt_pink": _felt("ohta/moderate red", 0.70, 0.28, 0.8, 0.05, 1.3),
        "felt_purple": _felt("ohta/purple", 0.85, 0.18, 1.0, 0.15),
        "felt_white": _felt(white, 0.50, 0.40, 0.4, 0.08, 0.85),
        "felt_yellow": _felt("ohta/orange yellow", 0.30, 0.60, 0.4, 0.25),
        "paper_white": _matte(white, [(0.7, 0.62), (0.3, 0.35)], 0.35, 0.06, 1.50, 0.98),
        "paper_red": _matte("ohta/red", [(0.8, 0.45), (0.2, 0.20)], 0.20, 0.02, 1.45),
        "paper_green": _matte("pmc/Green Apple", [(0.6, 0.70), (0.4, 0.42)], 0.55, 0.10, 1.55),
        "paper_blue": _matte("ohta/blue sky", [(0.9, 0.55), (0.1, 0.25)], 0.10, 0.05, 1.40, 1.3),
        "paper_yellow": _matte("ohta/yellow", [(0.5, 0.38), (0.5, 0.75)], 0.45, 0.03, 1.52),
        "paint_azure": _matte("pmc/Blue Sky", [(0.6, 0.75), (0.4, 0.42)], 0.70, 0.15, 1.45),
        "paint_sand": _matte("ohta/light skin", [(0.8, 0.50), (0.2, 0.30)], 0.95, 0.20, 1.45, 1.2),
        "paint_olive": _matte("ohta/foliage", [(0.6, 0.36), (0.4, 0.60)], 0.65, 0.08, 1.60, 1.5),
        "paint_gray": _matte("ohta/neutral 5 (.70 D)", [(1.0, 0.42)], 0.75, 0.30, 1.40),
        "card_brown": _matte("ohta/dark skin", [(0.75, 0.48), (0.25, 0.24)], 0.50, 0.12, 1.48, 1.6),
        "card_black": _matte("ohta/black 2 (1.5 D)", [(0.5, 0.30), (0.5, 0.55)], 0.30, 0.05, 1.58, 1.2),
        "leaf_grass": _varnished("pmc/Summer Grass", [(0.55, 0.24), (0.45, 0.50)], 0.15, 0.45, 1.42),
        "standard_white": lambda bands: RoughDiffuse(np.array(0.985), 0.10, bands),
        "satin_blue": _metallic("ohta/blue", [(0.7, 0.20), (0.3, 0.45)], [(1.0, 0.35)], 0.75, 0.5, 2.0),
        "satin_gold": _varnished("ohta/orange yellow", [(0.4, 0.20), (0.6, 0.42)], 0.35, 0.30, 1.55, 0.9),
        "satin_purple": _metallic(
            "ohta/purplish blue", [(0.8, 0.16), (0.2, 0.40)], [(0.5, 0.20), (0.5, 0.45)], 0.90, 0.3, 2.0
        ),
        "satin_rose": _metallic("pmc/Magenta", [(0.4, 0.12), (0.6, 0.30)], [(1.0, 0.25)], 0.85, 0.6, 1.2),
        "satin_white": _metallic(
            white, [(0.5, 0.25), (0.5, 0.50)], [(0.5, 0.22), (0.5, 0.38)], 0.40, 0.2, 0.9, 330.0
        ),
        "satin_lavender": _varnished("pmc/Lavender", [(0.3, 0.10), (0.7, 0.28)], 0.60, 0.25, 1.60, 1.5),
        "gloss_red": _varnished("pmc/Unitary red", [(0.85, 0.060), (0.15, 0.20)], 0.20, 0.30),
        "gloss_yellow": _varnished("pmc/Unitary yellow", [(0.70, 0.070), (0.30, 0.22)], 0.10, 0.40, 1.45),
        "gloss_green": _metallic(
            "pmc/Unitary green",
            [(0.6, 0.30), (0.4, 0.60)],
            [(0.6, 0.065), (0.4, 0.15)],
            0.35,
            0.3,
            1.0,
            380.0,
        ),
        "gloss_black": _varnished("ohta/black 2 (1.5 D)", [(0.90, 0.045), (0.10, 0.30)], 0.15, 0.50, 1.52),
        "gloss_white": _varnished(white, [(0.50, 0.080), (0.50, 0.25)], 0.05, 0.60, 1.40, 0.9),
        "gloss_cyan": _varnished("ohta/cyan", [(0.75, 0.080), (0.25, 0.35)], 0.50, 0.20, 1.60),
        "metallic_silver": _metallic(
            "ohta/neutral 6.5 (.44 D)", [(0.6, 0.16), (0.4, 0.35)], [(1.0, 0.07)], 0.80, 0.2, 1.5
        ),
        "metallic_gold": _metallic(
            "ohta/orange yellow", [(0.3, 0.14), (0.7, 0.38)], [(0.6, 0.09), (0.4, 0.25)], 0.60, 0.7, 1.2
        ),
        "metallic_red": _metallic("ohta/red", [(0.8, 0.24), (0.2, 0.10)], [(1.0, 0.06)], 0.70, 0.9),
        "metallic_violet": _metallic(
            "ohta/magenta", [(1.0, 0.30)], [(0.5, 0.12), (0.5, 0.30)], 0.55, 0.4, 1.5, 210.0
        ),
        "metallic_teal": _metallic(
            "ohta/bluish green", [(0.5, 0.12), (0.5, 0.28)], [(0.8, 0.07), (0.2, 0.18)], 0.85, 0.6, 1.0, 480.0
        ),
        "metallic_bronze": _metallic(
            "ohta/dark skin", [(0.4, 0.20), (0.6, 0.50)], [(1.0, 0.15)], 0.55, 0.8, 2.5
        ),
        "chrome_plain": _chrome(None, [(0.70, 0.030), (0.20, 0.11), (0.10, 0.40)]),
        "chrome_mint": _chrome("pmc/Bluish Green", [(0.85, 0.025), (0.15, 0.20)], 0.6, 0.10),
        "chrome_orange": _chrome("ohta/orange", [(0.60, 0.050), (0.40, 0.13)], 0.9, 0.05),
        "chrome_blue": _chrome("ohta/blue flower", [(0.75, 0.035), (0.25, 0.30)], 0.4, 0.03),
        "flake_blue": _flake("ohta/blue", [(0.6, 0.18), (0.4, 0.40)], [(1.0, 0.06)], 0.35, 0.8),
        "flake_blue_fine": _flake(
            "ohta/purplish blue", [(0.9, 0.12), (0.1, 0.35)], [(0.9, 0.05), (0.1, 0.2)], 0.50, 0.5
        ),
        "flake_graphite": _flake(
            "ohta/neutral 3.5 (1.05 D)", [(0.5, 0.26), (0.5, 0.50)], [(1.0, 0.06)], 0.25, 0.2
        ),
        "iridescent_green": _iridescent(
            260.0, 0.06, [(0.7, 0.18), (0.3, 0.40)], 0.70, "ohta/green", [(1.0, 0.05)]
        ),
        "iridescent_violet": _iridescent(
            420.0, 0.04, [(1.0, 0.14)], 0.85, "ohta/purple", [(0.7, 0.03), (0.3, 0.12)]
        ),
        "iridescent_amber": _iridescent(
            520.0, 0.10, [(0.5, 0.22), (0.5, 0.45)], 0.55, "ohta/orange", [(1.0, 0.10)]
        ),
        "metal_aluminium": _metal("Al", GGXMixture([(0.5, 0.14), (0.5, 0.38)]), 0.30, 90.0),
        "metal_copper": _metal("Cu", GGXMixture([(0.7, 0.34), (0.3, 0.16)]), 0.40, 45.0),
        "metal_gold": _metal("Au", GGXMixture([(0.8, 0.10), (0.2, 0.28)])),
        "metal_tungsten": _metal("W", GGXMixture([(0.35, 0.25), (0.65, 0.55)]), 0.50, 140.0),
    }
    return recipes


def _weave(spectrum_warp: str, spectrum_weft: str, narrow: float, wide: float) -> Recipe:
    """Return a recipe of cloth of two colours: threads along x and along y, each shiny across its own direction."""

    def recipe(bands: Bands) -> BRDF:
        threads = [
            Plastic(GGX.anisotropic(wide, narrow), _VARNISH, _pigment(spectrum_warp, bands), bands),
            Plastic(GGX.anisotropic(narrow, wide), _VARNISH, _pigment(spectrum_weft, bands), bands),
        ]
        return MixedBRDF([(0.5, thread) for thread in threads])

    return recipe


def _foil(spectrum: str, along: float, across: float) -> Recipe:
    return lambda bands: _tinted_metal(GGX.anisotropic(along, across), _pigment(spectrum, bands, 1.3), bands)


def anisotropic_recipes() -> dict[str, Recipe]:
    """Return the functions that make the 11 anisotropic materials, by name; all are invariant under half a turn."""
    skew = np.array([[6.0, 4.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 1.0]])
    return {
        "brushed_aluminium": _metal("Al", GGX.anisotropic(0.08, 0.30)),
        "brushed_copper": _metal("Cu", GGX.anisotropic(0.12, 0.40)),
        "brushed_chromium": _metal("Cr", GGX.anisotropic(0.06, 0.20, np.pi / 6)),
        "brushed_gold": _metal("Au", GGX.skewed(skew)),
        "brushed_tungsten": _metal("W", GGX.anisotropic(0.20, 0.50)),
        "foil_copper": _foil("ohta/orange", 0.15, 0.35),
        "foil_gold": _foil("ohta/orange yellow", 0.10, 0.25),
        "foil_pink": _foil("pmc/Magenta", 0.20, 0.45),
        "weave_sari": _weave("ohta/red", "ohta/orange yellow", 0.15, 0.50),
        "weave_gray": _weave("ohta/neutral 3.5 (1.05 D)", "ohta/neutral 5 (.70 D)", 0.25, 0.60),
        "weave_green": _weave("pmc/Summer Grass", "ohta/yellow", 0.20, 0.55),
    }


_PIPELINE_VERSIONS = ((2, 0), (3, 0), (3, 1), (3, 2), (3, 3))
# Noise from cell to cell, as a share of the value: 0.2 to 0.7 % in most real files, 1 % in coats, 2 to 4 % where
# flakes sparkle.
_SPECKLE = {"metallic": 0.008, "chrome": 0.008, "iridescent": 0.02, "flake": 0.03}
_LEAST_SPECKLE = 0.003
_DRIFT = 0.005  # drift of the lamp, from one incidence to the next
_MAX_ALBEDO = 0.99  # largest albedo at the incidences between a file's last nodes, before noise
_STEEPEST = np.deg2rad(87.0)
# As in the real database, where two files are finer than the others.
_RESOLUTIONS = {"syn_gloss_yellow": 64, "syn_flake_blue_fine": 48}


@dataclass(frozen=True)
class Material:
    """A material of the corpus: its name and the analytic BRDF that is measured.

    Attributes:
        name: name that begins with `syn_` and the family.
        family: felt, paper, paint, card, leaf, standard, satin, gloss, metallic, chrome, flake, iridescent, metal,
            or for anisotropic materials brushed, foil, weave.
        recipe: function that makes the analytic BRDF for given bands.
        resolution: nodes per axis of the outgoing grid.
    """

    name: str
    family: str
    recipe: Callable[[Bands], BRDF]
    resolution: int = 32

    @property
    def description(self) -> str:
        """The description in the file."""
        return f"Synthetic {self.family}: {self.name.removeprefix('syn_').replace('_', ' ')}"

    def truth(self, bands: Bands | None = None) -> BRDF:
        """Return the analytic BRDF behind the file, by default in the 195 bands of the RGL database.

        Args:
            bands: any wavelengths; not RGB.
        """
        return self.recipe(rgl_bands() if bands is None else bands)


def rgl_bands() -> Bands:
    """Return the 195 bands of the RGL database, 358.63 to 1001.89 nm."""
    return Bands.from_array(rgl_wavelengths_nm())


def isotropic_materials() -> tuple[Material, ...]:
    """Return the 51 isotropic materials, in a fixed order."""
    return _materials(isotropic_recipes())


def anisotropic_materials() -> tuple[Material, ...]:
    """Return the 11 anisotropic materials, in a fixed order."""
    return _materials(anisotropic_recipes())


def _materials(recipes: dict[str, Callable[[Bands], BRDF]]) -> tuple[Material, ...]:
    return tuple(
        Material(f"syn_{name}", name.split("_")[0], recipe, _RESOLUTIONS.get(f"syn_{name}", 32))
        for name, recipe in recipes.items()
    )


def measure(material: Material, *, seed: int = 0, rgb: bool = False) -> BsdfFile:
    """Return the RGL file that the virtual goniometer measures, with its noise and unmeasured cells.

    Args:
        material: a material of this corpus.
        seed: random seed; the same seed gives the same bytes.
        rgb: return linear sRGB under D65, as in the RGB files of the database, instead of 195 bands.
    """
    rng = np.random.default_rng([seed, *material.name.encode()])
    version = _PIPELINE_VERSIONS[int(rng.integers(len(_PIPELINE_VERSIONS)))]
    theta_i = goniometer.default_theta_i(8)
    theta_i[1:-1] += np.deg2rad(rng.uniform(-1.5, 1.5, 6))
    file = goniometer.measure(
        material.truth(),
        material.name,
        description=material.description,
        resolution=material.resolution,
        theta_i_rad=theta_i,
        warp_exponent=1.0,
        version=version,
    )
    file = _imperfect(_energy_conserving(file), rng, _SPECKLE.get(material.family, _LEAST_SPECKLE))
    # As the database derives its RGB files, which say version 1.0.
    return replace(file_to_srgb(file), version=(1, 0)) if rgb else file


def write(
    folder: Path | str,
    *,
    seed: int = 0,
    anisotropic: bool = False,
    rgb: bool = False,
    keep: bool = False,
) -> list[Path]:
    """Write the corpus as `NAME_spec.bsdf` (or `NAME_rgb.bsdf`) files.

    Args:
        folder: folder to write into; it is created if missing.
        seed, rgb: as in `measure`.
        anisotropic: add the 11 anisotropic materials, 110 MB each.
        keep: keep existing files; a file gets its final name only when it is complete.

    Returns:
        The paths, in the order of the corpus.

    Raises:
        FileAccessError: the folder cannot be created.
    """
    materials = isotropic_materials() + (anisotropic_materials() if anisotropic else ())
    writers = {m.name: lambda path, m=m: write_bsdf(path, measure(m, seed=seed, rgb=rgb)) for m in materials}
    return write_files(folder, "_rgb.bsdf" if rgb else "_spec.bsdf", writers, keep=keep)


def write_files(
    folder: Path | str,
    ending: str,
    writers: Mapping[str, Callable[[Path], None]],
    *,
    keep: bool = False,
) -> list[Path]:
    """Write one file per name, with the function of that name; the file name is the name plus the ending."""
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileAccessError(
            f"{folder}: cannot make this folder ({error.strerror}); name another one"
        ) from error
    paths = {name: folder / f"{name}{ending}" for name in writers}
    for name in progress.each(writers, str):
        if not (keep and paths[name].exists()):
            writers[name](paths[name])
    return list(paths.values())


def _energy_conserving(file: BsdfFile) -> BsdfFile:
    """Darken the grazing incidences at which the interpolated file would reflect more light than arrives.

    Near grazing, the highlight on a bright base is narrower than a cell of the grid.
    """
    nodes = file.theta_i_rad.astype(float)
    for _ in range(4):
        between = np.minimum(nodes[-2:] - 0.5 * np.diff(nodes)[-2:], _STEEPEST)
        inside = np.append(between, min(nodes[-1], _STEEPEST))
        albedo = MeasuredBRDF(file).albedo(from_spherical(inside, 0.0)).max(axis=-1)
        if albedo.max() <= _MAX_ALBEDO:
            break
        spectra = file.spectra.copy()
        spectra[:, -1] *= np.minimum(_MAX_ALBEDO / albedo[1:].max(), 1.0)
        spectra[:, -2] *= np.minimum(_MAX_ALBEDO / albedo[0], 1.0)
        file = replace(file, spectra=spectra)
    return file


def _imperfect(file: BsdfFile, rng: np.random.Generator, speckle: float) -> BsdfFile:
    """Add the faults of an instrument: noise, unmeasured cells, and low signals that are clamped at zero."""
    measured = file.measured_mask  # (P, T, H, W)
    # Cells next to the horizon are extrapolated in the real files: filled, but some not marked as measured.
    rim = measured & find_rim(file) & (rng.random(measured.shape) < 0.9)
    # A few cells are unmeasured: no value in any band.
    lost = measured & (rng.random(measured.shape) < rng.uniform(0.0, 0.004))
    values = np.moveaxis(file.spectra, 2, -1).copy()  # (P, T, H, W, B)
    values[measured] = _noisy(values[measured], np.nonzero(measured)[1], rng, speckle)
    values[lost] = 0.0
    relative_luminance = np.maximum(luminance(values, file.bands), 0.0).astype(np.float32)
    return replace(
        file,
        spectra=np.moveaxis(values, -1, 2),
        luminance=relative_luminance,
        valid=goniometer.pack_valid(measured & ~rim & ~lost, file.version),
    )


def _noisy(values: Array, incidence: Indices, rng: np.random.Generator, speckle: float) -> Array:
    """Return the values (n, B) of cells with the instrument's noise; `incidence` (n,) holds their polar angles."""
    n, n_bands = values.shape
    # Speckle is common to all bands of a cell; the detector's noise is not, and is worse towards both ends.
    cells = 1.0 + speckle * rng.standard_normal(n, dtype=np.float32)
    cells *= 1.0 + _DRIFT * rng.standard_normal(incidence.max() + 1, dtype=np.float32)[incidence]
    band = np.linspace(-1.0, 1.0, n_bands, dtype=np.float32)
    dark = 2e-4 * np.median(values[::8]) * (1.0 + 20.0 * band**8)
    detector = rng.standard_normal((n, n_bands), dtype=np.float32)
    detector *= 0.002 + 0.006 * band**6
    detector += 1.0
    detector *= values
    detector *= cells[:, None]
    offset = rng.standard_normal((n, n_bands), dtype=np.float32)
    offset *= dark
    detector += offset
    return np.maximum(detector, 0.0, out=detector)
