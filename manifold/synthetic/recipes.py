"""What the synthetic materials of the corpus are made of: one recipe per material, from bands to an analytic BRDF.

Pigments are reflectances that colour-science ships, metals are indices that Mitsuba ships; both are measured
values, see `spectra` for what is done outside their range. Everything else is invented.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from manifold.brdf.measured import BRDF
from manifold.colour.metals import metal_ior
from manifold.colour.reflectances import diffuse_reflectance
from manifold.records import Array, Bands
from manifold.synthetic.analytic import Lambert, Sheen
from manifold.synthetic.ggx import GGX
from manifold.synthetic.layers import Layered, MixedBRDF
from manifold.synthetic.microfacet import Plastic, RoughConductor, RoughDielectric, ThinFilm

Recipe = Callable[[Bands], BRDF]

_VARNISH = np.array(1.5)  # index of refraction of paints, papers and coats


def _pigment(spectrum: str, bands: Bands, scale: float = 1.0) -> Array:
    """A reflectance per band, kept below that of a perfect white."""
    return np.clip(scale * diffuse_reflectance(spectrum, np.array(bands.wavelengths_nm)), 0.0, 0.97)


def _felt(spectrum: str, fuzz: float, scale: float = 1.0) -> Recipe:
    def recipe(bands: Bands) -> BRDF:
        colour = _pigment(spectrum, bands, scale)
        return Layered(Sheen(0.35, fuzz * np.sqrt(colour), bands), Lambert(colour, bands))

    return recipe


def _plastic(spectrum: str, alpha: float, scale: float = 1.0, eta: Array = _VARNISH) -> Recipe:
    return lambda bands: Plastic(GGX.isotropic(alpha), eta, _pigment(spectrum, bands, scale), bands)


def _standard(reflectance: float) -> Recipe:
    return lambda bands: Lambert(np.array(reflectance), bands)


def _tinted_metal(ggx: GGX, colour: Array, bands: Bands) -> BRDF:
    """A reflector with a given reflectance at normal incidence: a real index that has it."""
    root = np.sqrt(np.clip(colour, 0.02, 0.95))
    return RoughConductor(ggx, (1.0 + root) / (1.0 - root), np.zeros_like(root), bands)


def _metallic(spectrum: str, alpha: float, coat: float, scale: float = 1.0) -> Recipe:
    """Vinyl film with metal powder: a tinted rough reflector and some pigment under a smooth coat."""

    def recipe(bands: Bands) -> BRDF:
        colour = _pigment(spectrum, bands, scale)
        metal = _tinted_metal(GGX.isotropic(alpha), colour, bands)
        base = MixedBRDF([(0.75, metal), (0.25, Lambert(0.5 * colour, bands))])
        return Layered(RoughDielectric(GGX.isotropic(coat), _VARNISH, bands), base)

    return recipe


def _chrome(spectrum: str | None, alpha: float) -> Recipe:
    """Chrome vinyl: chromium, or a tinted mirror, with a faint haze around the reflection."""

    def recipe(bands: Bands) -> BRDF:
        lobes: list[BRDF] = []
        for width in (alpha, 4.0 * alpha):
            ggx = GGX.isotropic(width)
            if spectrum is None:
                eta, k = metal_ior("Cr", np.array(bands.wavelengths_nm))
                lobes.append(RoughConductor(ggx, eta, k, bands))
            else:
                lobes.append(_tinted_metal(ggx, _pigment(spectrum, bands, 1.4), bands))
        return MixedBRDF([(0.85, lobes[0]), (0.15, lobes[1])])

    return recipe


def _flake(spectrum: str, flake: float, coat: float) -> Recipe:
    """Car paint: aluminium flakes among pigment under a glossy clear coat."""

    def recipe(bands: Bands) -> BRDF:
        eta, k = metal_ior("Al", np.array(bands.wavelengths_nm))
        colour = _pigment(spectrum, bands)
        flakes = RoughConductor(GGX.isotropic(flake), eta, k, bands)
        tinted = _tinted_metal(GGX.isotropic(1.5 * flake), colour, bands)
        base = MixedBRDF([(0.15, flakes), (0.35, tinted), (0.5, Lambert(0.7 * colour, bands))])
        return Layered(RoughDielectric(GGX.isotropic(coat), _VARNISH, bands), base)

    return recipe


def _iridescent(thickness_nm: float, alpha: float, spectrum: str) -> Recipe:
    """Interference pigment: a thin film of high index on absorbing platelets, over a dark base."""

    def recipe(bands: Bands) -> BRDF:
        eta, k = metal_ior("Cr", np.array(bands.wavelengths_nm))
        film = ThinFilm(GGX.isotropic(alpha), np.array(1.9), thickness_nm, eta, k, bands)
        base = MixedBRDF([(0.6, film), (0.4, Lambert(0.4 * _pigment(spectrum, bands), bands))])
        return Layered(RoughDielectric(GGX.isotropic(0.06), _VARNISH, bands), base)

    return recipe


def _metal(name: str, ggx: GGX) -> Recipe:
    def recipe(bands: Bands) -> BRDF:
        eta, k = metal_ior(name, np.array(bands.wavelengths_nm))
        return RoughConductor(ggx, eta, k, bands)

    return recipe


def isotropic_recipes() -> dict[str, Recipe]:
    """The 51 isotropic recipes by name, family first."""
    return {
        "felt_green": _felt("ohta/green", 0.25),
        "felt_orange": _felt("ohta/orange", 0.30),
        "felt_pink": _felt("ohta/moderate red", 0.35, 1.3),
        "felt_purple": _felt("ohta/purple", 0.20),
        "felt_white": _felt("ohta/white 9.5 (.05 D)", 0.30, 0.9),
        "felt_yellow": _felt("ohta/orange yellow", 0.25),
        "paper_white": _plastic("ohta/white 9.5 (.05 D)", 0.55, 0.98),
        "paper_red": _plastic("ohta/red", 0.50),
        "paper_green": _plastic("pmc/Green Apple", 0.60),
        "paper_blue": _plastic("ohta/blue sky", 0.50, 1.3),
        "paper_yellow": _plastic("ohta/yellow", 0.55),
        "paint_azure": _plastic("pmc/Blue Sky", 0.65),
        "paint_sand": _plastic("ohta/light skin", 0.70, 1.2),
        "paint_olive": _plastic("ohta/foliage", 0.60, 1.5),
        "paint_gray": _plastic("ohta/neutral 5 (.70 D)", 0.75),
        "card_brown": _plastic("ohta/dark skin", 0.45, 1.6),
        "card_black": _plastic("ohta/black 2 (1.5 D)", 0.40, 1.2),
        "leaf_grass": _plastic("pmc/Summer Grass", 0.32, 1.0, np.array(1.45)),
        "standard_white": _standard(0.985),
        "satin_blue": _plastic("ohta/blue", 0.22),
        "satin_gold": _plastic("ohta/orange yellow", 0.25, 0.9),
        "satin_purple": _plastic("ohta/purplish blue", 0.20),
        "satin_rose": _plastic("pmc/Magenta", 0.28),
        "satin_white": _plastic("ohta/white 9.5 (.05 D)", 0.24),
        "satin_lavender": _plastic("pmc/Lavender", 0.18),
        "gloss_red": _plastic("pmc/Unitary red", 0.05),
        "gloss_yellow": _plastic("pmc/Unitary yellow", 0.08),
        "gloss_green": _plastic("pmc/Unitary green", 0.06),
        "gloss_black": _plastic("ohta/black 2 (1.5 D)", 0.04),
        "gloss_white": _plastic("ohta/white 9.5 (.05 D)", 0.07),
        "gloss_cyan": _plastic("ohta/cyan", 0.10),
        "metallic_silver": _metallic("ohta/neutral 6.5 (.44 D)", 0.20, 0.08, 1.5),
        "metallic_gold": _metallic("ohta/orange yellow", 0.25, 0.10, 1.2),
        "metallic_red": _metallic("ohta/red", 0.22, 0.06),
        "metallic_violet": _metallic("ohta/magenta", 0.30, 0.12),
        "metallic_teal": _metallic("ohta/bluish green", 0.18, 0.08),
        "metallic_bronze": _metallic("ohta/dark skin", 0.28, 0.15, 2.5),
        "chrome_plain": _chrome(None, 0.03),
        "chrome_mint": _chrome("pmc/Bluish Green", 0.04),
        "chrome_orange": _chrome("ohta/orange", 0.05),
        "chrome_blue": _chrome("ohta/blue flower", 0.035),
        "flake_blue": _flake("ohta/blue", 0.20, 0.05),
        "flake_blue_fine": _flake("ohta/blue", 0.14, 0.04),
        "flake_graphite": _flake("ohta/neutral 3.5 (1.05 D)", 0.25, 0.06),
        "iridescent_green": _iridescent(230.0, 0.20, "ohta/green"),
        "iridescent_violet": _iridescent(310.0, 0.16, "ohta/purple"),
        "iridescent_amber": _iridescent(400.0, 0.24, "ohta/orange"),
        "metal_aluminium": _metal("Al", GGX.isotropic(0.18)),
        "metal_copper": _metal("Cu", GGX.isotropic(0.30)),
        "metal_gold": _metal("Au", GGX.isotropic(0.12)),
        "metal_tungsten": _metal("W", GGX.isotropic(0.45)),
    }


def _weave(spectrum_warp: str, spectrum_weft: str, narrow: float, wide: float) -> Recipe:
    """Cloth of two colours: threads along x and along y, each shiny across its own direction."""

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
    """The 11 anisotropic recipes by name, family first; all look the same after half a turn."""
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
